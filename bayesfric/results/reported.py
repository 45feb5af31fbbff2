"""One number as every view prints it, and how it came about.

The value is the posterior's median; room for a model that is not exactly right widens its
interval. Nothing else prints one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from pydantic import BaseModel, ConfigDict, FiniteFloat

Status = Literal["identified", "limit", "prior", "unidentified", "doubtful"]
# Share of the posterior that every reported interval holds.
LEVEL = 0.9
# Who determined a number: the data, data and prior, or the prior; and what it is reported as.
Determined = Literal["data", "weak", "prior"]
KNOWN_BY: dict[Determined, Status] = {
    "data": "identified",
    "weak": "prior",
    "prior": "unidentified",
}
# Statuses in the order in which tables have them.
ORDER: tuple[Status, ...] = ("identified", "doubtful", "limit", "prior", "unidentified")


@dataclass(frozen=True)
class Spread:
    """Value, ends of the interval and standard deviation of one step on the way."""

    value: float
    low: float
    high: float
    sd: float


class How(BaseModel):
    """What made the number: the posterior's own, and what was changed of it."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    posterior: list[FiniteFloat]  # value, low, high and sd, were the model right
    widened: bool = False  # whether the interval has room for a model that is not exactly right
    findings: list[str] = []  # kinds that move it by more than its interval
    converged: bool = True  # or the sampling of this number has not


class Reported(BaseModel):
    """One value, one interval, one status.

    ``identified`` by the data; a ``limit``, which with a chance of half of one less the level lies
    beyond ``bound`` (``at_most`` or at least); ``prior``: by data and prior together;
    ``unidentified``: the data say nothing, and value and interval are those of prior and bounds, or
    the sampling has not converged; ``doubtful``: a finding moves it by more than its interval.
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
    verdict: Literal["data", "weak", "prior"],
    own_prior: bool = False,
    converged: bool = True,
    widened: Spread | None = None,
    limit: Literal["lower", "upper"] | None = None,
    findings: Sequence[str] = (),
) -> Reported:
    """Join the parts of one number.

    Parameters
    ----------
    posterior
        What the sampling gave, were the model right.
    verdict
        By what it is determined: the ``data``, data and prior (``weak``), or the ``prior``.
    own_prior
        Whether that prior was given by the user.
    converged
        Whether the sampling of this number has.
    widened
        With room for the model's error, where there is any.
    limit
        Bound that the data push it against.
    findings
        Kinds that make it doubtful.
    """
    told = widened or posterior
    how = How(
        posterior=[posterior.value, posterior.low, posterior.high, posterior.sd],
        widened=widened is not None,
        findings=list(findings),
        converged=converged,
    )
    status: Status = KNOWN_BY[verdict]
    if verdict == "prior" and own_prior:
        status = "prior"
    ends = {"lower": told.high, "upper": told.low}
    if limit is not None:
        status = "limit"
    if findings and status != "unidentified":
        status = "doubtful"
    if not converged:
        status, limit = "unidentified", None
    return Reported(
        value=told.value,
        sd=told.sd,
        interval=[told.low, told.high],
        status=status,
        bound=None if limit is None else ends[limit],
        at_most=None if limit is None else limit == "lower",
        how=how,
    )
