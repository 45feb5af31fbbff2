"""What a point estimate is, whichever method made it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from bayesfric.estimates.methods import ESTIMATORS

METHODS = tuple(ESTIMATORS)
if TYPE_CHECKING:
    Method = str
else:
    Method = Literal[METHODS]

Kind = Literal["total", "derived", "parameter"]


@dataclass(frozen=True)
class EstimatedValue:
    """One estimated number.

    Attributes
    ----------
    name, unit, symbol, meaning
        As for parameters; the symbol is LaTeX without dollar signs.
    value
        The estimate. Where ``sd`` is infinite it is one of many that fit as well.
    sd
        Standard deviation for uncorrelated residuals, as the field quotes it; infinite
        where the data do not determine the number, ``nan`` where it has none because
        the estimate stands on a bound.
    sd_robust
        Standard deviation that accounts for correlated residuals.
    kind
        ``total``: seen by the motor, eq. (11). ``parameter``: of the chain.
        ``derived``: from parameters.
    gauge_free
        Whether scaling leg parameters and alpha together leaves it unchanged.
    at_bound
        ``lower`` or ``upper`` where the estimate stands on a bound.
    span
        Where a scaling leaves the number open: the values that a passive gearbox allows.
    """

    name: str
    unit: str
    symbol: str
    meaning: str
    value: float
    sd: float
    sd_robust: float = math.nan
    kind: Kind = "total"
    gauge_free: bool = True
    at_bound: Literal["lower", "upper"] | None = None
    span: tuple[float, float] | None = None

    @property
    def relative_sd(self) -> float:
        """``sd`` in per cent of the value, the way the field quotes it."""
        return 100.0 * self.sd / abs(self.value) if self.value else math.inf

    @property
    def determined(self) -> bool:
        """Whether the data, or what is known besides, determine the number."""
        return math.isfinite(self.sd)


@dataclass(frozen=True)
class Estimate:
    """A point estimate.

    Attributes
    ----------
    method
        One of :data:`METHODS`.
    values
        In a fixed order: totals, derived quantities, parameters.
    residual_rms
        Root mean square of measured minus modelled.
    residual_unit
        Its unit: that of torque, or of position for the output error.
    n_outputs
        Number of residuals.
    assumption
        What the standard deviations take for granted, one sentence.
    notes
        What a user should know of how it came about, one sentence each.
    point
        Value of every chain parameter, known ones included; empty for least squares.
    converged
        Whether the search ended at a minimum; ``values`` have no sds where it did not.
    """

    method: Method
    values: tuple[EstimatedValue, ...]
    residual_rms: float
    n_outputs: int
    assumption: str
    residual_unit: str = "N m"
    notes: tuple[str, ...] = ()
    point: tuple[tuple[str, float], ...] = ()
    converged: bool = True

    def __getitem__(self, name: str) -> EstimatedValue:
        for value in self.values:
            if value.name == name:
                return value
        raise KeyError(name)

    def __contains__(self, name: str) -> bool:
        return any(value.name == name for value in self.values)
