"""Into and out of an estimate: prior knowledge and options; numbers, sds and assumptions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from pydantic import Field

from bayesfric.base.options import Options
from bayesfric.estimates import Method
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import turned
from bayesfric.recordings.arrays import Array

# In the order of results; a method comes after the one that it starts from.
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
    point: tuple[tuple[str, float], ...] = ()  # of every parameter; empty for least squares
    converged: bool = True

    @property
    def parameters(self) -> list[EstimatedValue]:
        """Values of the joint's parameters."""
        return [v for v in self.values if v.kind == "parameter"]

    def __getitem__(self, name: str) -> EstimatedValue:
        for value in self.values:
            if value.name == name:
                return value
        raise KeyError(name)

    def __contains__(self, name: str) -> bool:
        return any(value.name == name for value in self.values)


@dataclass(frozen=True)
class Knowledge:
    """Known values, bounds and data-sheet values of a joint's parameters, by name, in SI units."""

    # values of parameters that are not estimated
    fixed: Mapping[str, float] = field(default_factory=dict)
    # limits of others; the support where left out
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    # mean and standard deviation of others, one more residual each
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def free(self, joint: Joint) -> tuple[str, ...]:
        """Names of the parameters to estimate, in the joint's order."""
        return tuple(name for name in joint.names if name not in self.fixed)

    def limits(self, joint: Joint) -> tuple[Array, Array]:
        """Lower and upper limits ``(d,)`` of the free parameters."""
        support = {p.name: (p.lower, p.upper) for p in joint.parameters}
        pairs = [self.bounds.get(name, support[name]) for name in self.free(joint)]
        return np.array([low for low, _ in pairs]), np.array([high for _, high in pairs])

    def on_turn(self, joint: Joint, values: Array) -> Array:
        """Bring angles of free parameters ``(d,)`` to the turn of their limits."""
        described = {p.name: p for p in joint.parameters}
        out = values.copy()
        for j, (name, low, high) in enumerate(
            zip(self.free(joint), *self.limits(joint), strict=True)
        ):
            if described[name].circular:
                middle = (low + high) / 2.0 if np.isfinite(high - low) else 0.0
                out[j] = turned(float(values[j]), middle)
        return out

    def inside(self, joint: Joint, values: Array) -> Array:
        """Put free parameters ``(d,)`` within their limits."""
        return np.clip(self.on_turn(joint, values), *self.limits(joint))

    def rows(self, joint: Joint) -> tuple[Array, Array]:
        """Write priors as rows ``1/sd`` ``(k, d)`` and targets ``mean/sd`` ``(k,)``."""
        free = self.free(joint)
        known = [name for name in free if name in self.priors]
        means, sds = np.array([self.priors[name] for name in known]).reshape(-1, 2).T
        rows = np.eye(len(free))[[free.index(name) for name in known]]
        return rows / sds[:, None], means / sds


class Estimation(Options):
    """How point estimates are made."""

    starts: int = Field(8, ge=1, le=1000, description="random starts beside the derived ones")
    seed: int = Field(1, ge=0, lt=2**63, description="of the random starts")
    output_error: bool = Field(
        False,
        description="whether 'fit' makes the output-error estimate beside the posterior, as with "
        "--output-error; it simulates, and may take many times as long as the posterior",
    )
    max_seconds: float = Field(
        60.0,
        gt=0,
        le=1e9,
        description="CPU time that the output-error estimate may take, s; what it has by then is "
        "marked as not converged, and is another one on another machine. An output-error "
        "likelihood starts from that estimate, and allows it all it needs",
    )
    segment: float | None = Field(
        None,
        gt=0,
        le=1e5,
        description="s after which the output-error simulation starts anew; chosen if left out",
    )
    substeps: int | None = Field(
        None, ge=1, le=64, description="integration steps a sample; chosen if left out"
    )


class Reference(Options):
    """A value from elsewhere to compare results with; it enters no fit."""

    value: float = Field(
        allow_inf_nan=False,
        description="in SI units, as results are shown",
    )
    sd: float | None = Field(
        None,
        gt=0,
        allow_inf_nan=False,
        description="its standard deviation, if it is known",
    )
    source: str = Field("reference", description="where it is from, such as CAD")
