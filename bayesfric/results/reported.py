"""The one value, interval and status of a number that every view prints, and a run's verdict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

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


class Reported(BaseModel):
    """One value, one interval, one status.

    ``identified`` by the data; a ``limit``, which with a chance of half of one less the level lies
    beyond ``bound`` (``at_most`` or at least); ``prior``: by data and prior together;
    ``unidentified``: value and interval are those of prior and bounds, or the sampling has not
    converged; ``doubtful``: a doubt concerns it (``find_doubts``).
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    value: FiniteFloat
    sd: FiniteFloat
    interval: list[FiniteFloat]
    status: Status
    bound: FiniteFloat | None = None
    at_most: bool | None = None

    @property
    def low(self) -> float:
        """Lower end of the interval."""
        return self.interval[0]

    @property
    def high(self) -> float:
        """Upper end of the interval."""
        return self.interval[1]


Outcome = Literal["good", "usable", "unchecked", "doubtful", "not converged"]


@dataclass(frozen=True)
class Verdict:
    """Whether a run can be used."""

    outcome: Outcome
    left: float | None  # rms that the model leaves, as a share of the torque's
    asked: int  # number of candidate effects that were tested
    doubtful: int  # number of quantities that a doubt concerns


def outcome_of(*, converged: bool, doubted: bool, lacking: bool, tested: bool) -> Outcome:
    """Say whether a run can be used.

    ``usable`` where the model lacks something that intervals allow for, ``unchecked`` where missing
    effects could not be tested, ``doubtful`` where doubts concern numbers.
    """
    if not converged:
        return "not converged"
    if doubted:
        return "doubtful"
    if lacking:
        return "usable"
    return "good" if tested else "unchecked"
