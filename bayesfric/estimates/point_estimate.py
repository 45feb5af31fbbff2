"""A point estimate of any method: numbers, standard deviations, assumptions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

# In the order of results; a method comes after the one that it starts from.
Method = Literal["least-squares", "input-error", "output-error"]
METHODS: tuple[Method, ...] = get_args(Method)
Kind = Literal["total", "derived", "parameter"]
Bound = Literal["lower", "upper"]

# Half a 90 % interval of a normal distribution, in standard deviations.
HALF = 1.645


@dataclass(frozen=True)
class EstimatedValue:
    """One estimated number."""

    name: str
    unit: str
    symbol: str  # LaTeX without dollar signs
    meaning: str
    value: float  # in SI units; where sd is infinite one of many that fit as well
    # for uncorrelated residuals; infinite where the data leave the number open, NaN on a bound and
    # without convergence
    sd: float
    sd_robust: float = math.nan  # for correlated residuals
    kind: Kind = "total"
    gauge_free: bool = True  # unchanged by scaling leg parameters and alpha (section 4.2)
    at_bound: Bound | None = None
    span: tuple[float, float] | None = None  # what a passive gearbox allows, if open

    @property
    def relative_sd(self) -> float:
        """``sd`` in per cent of the value; infinite for zero."""
        return 100.0 * self.sd / abs(self.value) if self.value else math.inf

    @property
    def larger_sd(self) -> float:
        """The larger of the plain and robust sds that are not NaN; else zero."""
        return max((sd for sd in (self.sd, self.sd_robust) if not math.isnan(sd)), default=0.0)

    @property
    def quantity(self) -> str:
        """Its name without the owner."""
        return self.name.rpartition(".")[2]

    @property
    def known(self) -> bool:
        """Whether it is on no bound and its 90 % interval excludes zero."""
        return self.at_bound is None and abs(self.value) > HALF * self.larger_sd

    @property
    def determined(self) -> bool:
        """Whether data and priors determine the number."""
        return math.isfinite(self.sd)


@dataclass(frozen=True)
class Estimate:
    """A point estimate; ``estimate[name]`` is one of its numbers."""

    method: Method
    values: tuple[EstimatedValue, ...]  # totals, derived quantities, parameters
    residual_rms: float  # of measured minus modelled, in residual_unit
    n_outputs: int
    assumption: str  # of the standard deviations, in a sentence
    residual_unit: str = "N m"  # of torque, or of position for the output error
    notes: tuple[str, ...] = ()  # remarks on the search, a sentence each
    point: tuple[tuple[str, float], ...] = ()  # of every chain parameter; empty for least squares
    converged: bool = True

    @property
    def parameters(self) -> list[EstimatedValue]:
        """Values of the chain's parameters."""
        return [v for v in self.values if v.kind == "parameter"]

    def __getitem__(self, name: str) -> EstimatedValue:
        for value in self.values:
            if value.name == name:
                return value
        raise KeyError(name)

    def __contains__(self, name: str) -> bool:
        return any(value.name == name for value in self.values)
