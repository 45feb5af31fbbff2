"""What a run comes to, in one word and what it rests on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Outcome = Literal["good", "usable", "unchecked", "doubtful", "not converged"]


@dataclass(frozen=True)
class Verdict:
    """Whether a run can be used.

    Attributes
    ----------
    outcome
        ``good``; ``usable`` where the model lacks something and intervals have room for it;
        ``unchecked`` where nobody asked what the model lacks; ``doubtful`` where a
        finding moves numbers by more than their intervals; ``not converged``.
    explained
        Share of the torque's variance that the model explains, where that says anything.
    asked
        How many candidates were asked whether they explain more.
    doubtful
        How many numbers a finding moves.
    """

    outcome: Outcome
    explained: float | None
    asked: int
    doubtful: int


def verdict(
    *,
    converged: bool,
    doubts: int,
    doubtful: int,
    asked: int | None,
    explained: float | None,
    lacking: bool = False,
) -> Verdict:
    """Conclude; ``asked`` is ``None`` where the question could not be put.

    ``lacking`` says whether the model lacks anything that intervals have room for.
    """
    outcome: Outcome = "good" if asked is not None else "unchecked"
    if lacking:
        outcome = "usable"
    if doubts:
        outcome = "doubtful"
    if not converged:
        outcome = "not converged"
    return Verdict(outcome, explained, asked or 0, doubtful)
