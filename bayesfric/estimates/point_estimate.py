"""What a point estimate is, whichever method made it: numbers, standard deviations, assumptions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

# In the order of every list; those that others start from come before them.
Method = Literal["least-squares", "input-error", "output-error"]
METHODS: tuple[Method, ...] = get_args(Method)
Kind = Literal["total", "derived", "parameter"]
Bound = Literal["lower", "upper"]


# Half a 90 % interval of a normal distribution, in standard deviations.
HALF = 1.645


@dataclass(frozen=True)
class EstimatedValue:
    """One estimated number."""

    name: str  # As for parameters; the symbol is LaTeX without dollar signs
    unit: str
    symbol: str
    meaning: str
    value: float  # In SI units; where sd is infinite it is one of many that fit as well
    # For uncorrelated residuals, as the field quotes it; infinite where the data do not determine
    # the number, NaN where it has none because the estimate stands on a bound or has not converged
    sd: float
    sd_robust: float = math.nan  # Accounts for correlated residuals
    # total seen by the motor, eq. (11); parameter of the chain; derived from parameters
    kind: Kind = "total"
    # Whether scaling leg parameters and alpha together leaves it unchanged (section 4.2)
    gauge_free: bool = True
    at_bound: Bound | None = None  # Bound that it stands on, if any
    # What a passive gearbox allows where a scaling leaves it open
    span: tuple[float, float] | None = None

    @property
    def relative_sd(self) -> float:
        """``sd`` in per cent of the value, the way the field quotes it; infinite for zero."""
        return 100.0 * self.sd / abs(self.value) if self.value else math.inf

    @property
    def larger_sd(self) -> float:
        """The larger of plain and robust standard deviation, of those that are known; else zero."""
        return max((sd for sd in (self.sd, self.sd_robust) if not math.isnan(sd)), default=0.0)

    @property
    def quantity(self) -> str:
        """What it is, without whose: the part of its name behind the last dot."""
        return self.name.rpartition(".")[2]

    @property
    def known(self) -> bool:
        """Whether it stands on no bound and its 90 % interval leaves out zero."""
        return self.at_bound is None and abs(self.value) > HALF * self.larger_sd

    @property
    def determined(self) -> bool:
        """Whether the data, or what is known besides, determine the number."""
        return math.isfinite(self.sd)


@dataclass(frozen=True)
class Estimate:
    """A point estimate; ``estimate[name]`` is one of its numbers."""

    method: Method  # least-squares, input-error or output-error
    values: tuple[EstimatedValue, ...]  # Totals, derived quantities, parameters
    residual_rms: float  # Root mean square of measured minus modelled, in residual_unit
    n_outputs: int  # Number of residuals
    assumption: str  # What the standard deviations take for granted, one sentence
    residual_unit: str = "N m"  # That of torque, or of position for the output error
    notes: tuple[str, ...] = ()  # What a user should know of how it came about, one sentence each
    # Name and value of every chain parameter; empty for least squares
    point: tuple[tuple[str, float], ...] = ()
    # Whether it is a minimum; values have no standard deviations where it is not
    converged: bool = True

    @property
    def parameters(self) -> list[EstimatedValue]:
        """Those of the chain's own."""
        return [v for v in self.values if v.kind == "parameter"]

    def __getitem__(self, name: str) -> EstimatedValue:
        for value in self.values:
            if value.name == name:
                return value
        raise KeyError(name)

    def __contains__(self, name: str) -> bool:
        return any(value.name == name for value in self.values)
