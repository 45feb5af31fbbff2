"""The one value, interval and status of a number that every view prints, and a run's verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, FiniteFloat

Status = Literal["identified", "limit", "prior", "unidentified", "doubtful"]
# Share of the posterior that every reported interval holds.
LEVEL = 0.9
# What determined a number: the data, data and prior, or the prior; and what it is reported as.
Determined = Literal["data", "weak", "prior"]
KNOWN_BY: dict[Determined, Status] = {
    "data": "identified",
    "weak": "prior",
    "prior": "unidentified",
}
# Statuses in the order in which tables have them.
ORDER: tuple[Status, ...] = ("identified", "doubtful", "limit", "prior", "unidentified")


class Spread(NamedTuple):
    """Value, ends of the interval and standard deviation."""

    value: float
    low: float
    high: float
    sd: float


class How(BaseModel):
    """How a reported number was made: the posterior's own, and what was changed of it."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    posterior: list[FiniteFloat]  # value, low, high and sd, were the model right
    widened: bool = False  # whether the interval allows for model discrepancy
    findings: list[str] = []  # kinds that move it by more than its interval
    converged: bool = True  # whether the sampling of this number converged


class Reported(BaseModel):
    """One value, one interval, one status.

    ``identified`` by the data; a ``limit``, which with a chance of half of one less the level lies
    beyond ``bound`` (``at_most`` or at least); ``prior``: by data and prior together;
    ``unidentified``: value and interval are those of prior and bounds, or the sampling has not
    converged; ``doubtful``: a finding moves it by more than its interval.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    value: FiniteFloat
    sd: FiniteFloat
    interval: list[FiniteFloat]
    status: Status
    bound: FiniteFloat | None = None
    at_most: bool | None = None
    how: How


def concluded(
    posterior: Spread,
    *,
    verdict: Determined,
    own_prior: bool = False,
    converged: bool = True,
    widened: Spread | None = None,
    limit: Literal["lower", "upper"] | None = None,
    findings: Sequence[str] = (),
) -> Reported:
    """Join the parts of one number into what is reported.

    ``own_prior`` is whether the user gave its prior, ``widened`` its spread with model discrepancy,
    ``limit`` the bound that the data push it against, ``findings`` the kinds that make it doubtful.
    """
    printed = widened or posterior
    status: Status = KNOWN_BY[verdict]
    if verdict == "prior" and own_prior:
        status = "prior"
    if limit is not None:
        status = "limit"
    if findings and status != "unidentified":
        status = "doubtful"
    if not converged:
        status, limit = "unidentified", None
    bound = None if limit is None else printed.high if limit == "lower" else printed.low
    return Reported(
        value=printed.value,
        sd=printed.sd,
        interval=[printed.low, printed.high],
        status=status,
        bound=bound,
        at_most=None if limit is None else limit == "lower",
        how=How(
            posterior=list(posterior),
            widened=widened is not None,
            findings=list(findings),
            converged=converged,
        ),
    )


Outcome = Literal["good", "usable", "unchecked", "doubtful", "not converged"]


@dataclass(frozen=True)
class Verdict:
    """Whether a run can be used.

    ``usable`` where the model lacks something that intervals allow for, ``unchecked`` where missing
    effects could not be tested, ``doubtful`` where a finding moves numbers by more than their
    intervals.
    """

    outcome: Outcome
    explained: float | None  # share of the torque's variance that the model explains
    asked: int  # number of candidate effects that were tested
    doubtful: int  # number of quantities that a finding moves


def verdict(
    *,
    converged: bool,
    doubts: int,
    doubtful: int,
    asked: int | None,
    explained: float | None,
    lacking: bool = False,
) -> Verdict:
    """Give the verdict on a run; ``asked`` is ``None`` where no candidate could be tested."""
    outcome: Outcome = "good" if asked is not None else "unchecked"
    if lacking:
        outcome = "usable"
    if doubts:
        outcome = "doubtful"
    if not converged:
        outcome = "not converged"
    return Verdict(outcome, explained, asked or 0, doubtful)
