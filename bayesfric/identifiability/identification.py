"""What recordings can and cannot tell, before anything is sampled.

The Jacobian of the observed quantity over its noise, in logarithms of the parameters, is taken at
the estimate. A direction is *null* where its singular value is below 1e-7 of the largest, which is
a thousand times what rounding makes of an exact zero (1e-6 for a simulated position); it is *weak*
where the data leave the logarithm of a parameter more than 0.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesfric.estimates.assemble import bounds_met
from bayesfric.estimates.torque import typical_load
from bayesfric.identifiability.back_emf import SpeedTerm
from bayesfric.identifiability.coverage import Coverage, back_driven, coverage_of
from bayesfric.identifiability.local import (
    WEAK,
    LocalInformation,
    in_natural_units,
    local_information,
    verdict,
)
from bayesfric.identifiability.open_directions import OpenDirection, open_directions, open_rows
from bayesfric.identifiability.remedies import HARDLY, trials
from bayesfric.identifiability.sentences import Statement, plain, stated
from bayesfric.inference.prior.priors import KNOWN
from bayesfric.inference.target import Target
from bayesfric.mechanism.derived import derive
from bayesfric.recordings.arrays import Array
from bayesfric.results.reported import KNOWN_BY, Determined, Status

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Prospect:
    """One parameter or derived quantity and how well it would be known."""

    name: str
    unit: str
    meaning: str
    value: float  # at the estimate; it means nothing where data_sd is infinite
    data_sd: float  # what the data alone would leave, the noise being what fit takes it for
    expected_sd: float  # data and prior together
    prior_sd: float = float("nan")  # and these two of parameters alone
    status: Status | None = None  # to be expected of a fit
    on_bound: str | None = None  # lower or upper: a limit is what can be told


@dataclass(frozen=True, eq=False)
class Identification:
    """Everything that the local picture says."""

    method: str  # of the likelihood
    noise: str  # what it takes the noise for
    # whether it may be correlated: estimates weigh all residuals alike, and have other sds then
    memory: bool
    local: LocalInformation  # the local picture at the estimate
    directions: tuple[OpenDirection, ...]  # null ones first, then weak ones, the weakest first
    parameters: tuple[Prospect, ...]  # the free ones
    combinations: tuple[Prospect, ...]  # what they amount to, best known first
    recordings: tuple[Coverage, ...]  # what the recordings went through
    # element with a load loss: share of the moving outputs in which the load drives it
    back_driving: dict[str, float]
    voltage: SpeedTerm | None  # what a back-EMF cannot be told from

    @property
    def frame(self) -> pd.DataFrame:
        """One row a parameter: how well it would be known, by what, and with what it is open."""
        import pandas as pd

        found = pd.DataFrame([vars(one) for one in self.parameters]).set_index("name")
        sharing = [
            [name for one in self.directions if label in one.exponents for name in one.exponents]
            for label in self.local.labels
        ]
        found["open_with"] = [
            ", ".join(dict.fromkeys(name for name in names if name != label))
            for label, names in zip(self.local.labels, sharing, strict=True)
        ]
        return found

    def _repr_html_(self) -> str:
        """Show the table in a notebook."""
        return str(self.frame.to_html(float_format="{:.4g}".format))

    @property
    def determined(self) -> list[Prospect]:
        """Combinations that the data tell, whatever else they do not; limits and priors do not.

        A bound may narrow them further, as it does what a value on it can be traded for.
        """
        return [
            one
            for one in self.combinations
            if one.data_sd < WEAK * abs(one.value)
            and one.status != "unidentified"
            and not one.on_bound
        ]

    @property
    def remarks(self) -> list[Statement]:
        """What is to be said of back-driving and of a voltage."""
        found = [*map(self._seen, self.back_driving), self._voltage_meaning]
        return [one for one in found if one]

    def _seen(self, element: str) -> Statement:
        """Say how often the load drives an element."""
        loss, share = f"{element}.load_back", self.back_driving[element]
        prior = any(row.name == loss and row.status == "unidentified" for row in self.parameters)
        kind = "never" if share == 0.0 else "hardly" if share < HARDLY else "seen"
        return stated("back_driving", kind, prior=prior, element=element, share=share)

    @property
    def _voltage_meaning(self) -> Statement | None:
        return self.voltage.meaning(len(self.recordings)) if self.voltage else None

    def as_json(self) -> dict[str, Any]:
        """Give what ``bayesfric identify --json`` prints; what is infinite is ``None``."""
        voltage = self.voltage
        found = {
            "method": self.method,
            "noise": self.noise,
            "directions": self.directions,
            "combinations": {p.name: _without(p, "name", "prior_sd") for p in self.combinations},
            "parameters": {p.name: _without(p, "name") for p in self.parameters},
            "back_driving": {
                name: {"at_estimate": share, "meaning": self._seen(name)}
                for name, share in self.back_driving.items()
            },
            "recordings": self.recordings,
            "voltage": voltage and {**vars(voltage), "meaning": self._voltage_meaning},
        }
        return {name: plain(value) for name, value in found.items()}


def _without(record: Any, *names: str) -> dict[str, Any]:
    return {name: value for name, value in vars(record).items() if name not in names}


def identify(target: Target, estimate: Array, *, speed: SpeedTerm | None = None) -> Identification:
    """Find out what the recordings can tell, at an estimate ``(d,)``, noise scales last.

    ``speed`` is what a back-EMF is confounded with, where the torque comes from a voltage.

    Raises
    ------
    BadInput
        If a simulation fails beside the estimate.
    """
    chain, observations = target.likelihood.chain, target.likelihood.observations
    local = in_natural_units(target, estimate, local_information(target, estimate))
    values = target.chain_values(estimate[None])
    coverage = coverage_of(chain, observations, values[0])
    shares = back_driven(chain, observations, values)
    back = {name: float(share[0]) for name, share in shares.items()}
    rare = any(share < HARDLY for share in back.values())
    open_ = any(open_rows(local))
    tried = trials(target, estimate, local, rare=rare) if open_ else []
    free = [p for p in chain.parameters if p.name in target.free]
    bounds = _bounds_met(target, estimate)
    covariance = expected_covariance(target, local)
    parameters = _parameters(target, estimate, local, bounds, covariance)
    load = typical_load(chain, observations, values[0])
    return Identification(
        target.likelihood.method,
        target.likelihood.noise.description,
        target.likelihood.noise.accounts_for_correlation,
        local,
        tuple(open_directions(local, free, coverage, back, tried, _told(target, estimate))),
        parameters,
        _combinations(target, estimate, local, load, parameters, covariance),
        coverage,
        back,
        speed,
    )


def prior_rows(target: Target, local: LocalInformation) -> Array:
    """Jacobian ``(k, k)`` with the information of the priors, in the local units."""
    sds = np.array([p.sd() for p in target.priors[: len(target.free)]])
    ratio = np.abs(local.units) / sds
    return np.diag(np.where(np.isfinite(ratio), ratio, 0.0))


def expected_covariance(target: Target, local: LocalInformation) -> Array:
    """Covariance of the free parameters that data and priors would leave, ``(k, k)``.

    The inverse of the Fisher information plus the priors' ``1/sd²``, in the local units.
    A parameter that neither confines makes all of it infinite along its direction.
    """
    values, vectors = np.linalg.eigh(local.information + prior_rows(target, local) ** 2)
    open_ = values <= 1e-15 * values[-1]
    inverse = np.where(open_, 0.0, 1.0 / np.where(open_, 1.0, values))
    covariance = (vectors * inverse) @ vectors.T
    for row in vectors.T[open_]:
        touched = np.abs(row) > 1e-6
        covariance[np.ix_(touched, touched)] = np.inf
    return np.asarray(covariance)


def _bounds_met(target: Target, estimate: Array) -> list[str | None]:
    """Say of every free parameter on which end of its prior the estimate stands."""
    k = len(target.free)
    low, high = np.array([p.limits for p in target.priors[:k]]).T
    sds = np.array([p.sd() for p in target.priors[:k]])
    met = bounds_met(estimate[:k], low, high, np.where(np.isfinite(sds), sds, 0.0))
    return [{-1: "lower", 1: "upper"}.get(int(end)) for end in met]


def moved_beside(local: LocalInformation, parameters: Array) -> tuple[Array, Array]:
    """Move each free parameter of ``(d,)`` up, then down: ``(2 k, d)``, and the widths ``(k,)``."""
    steps = 1e-5 * np.abs(local.units)
    beside = np.eye(steps.size, parameters.size) * steps[:, None]
    return parameters + np.concatenate([beside, -beside]), 2.0 * steps


def _parameters(
    target: Target,
    estimate: Array,
    local: LocalInformation,
    bounds: Sequence[str | None],
    covariance: Array,
) -> tuple[Prospect, ...]:
    described = {p.name: p for p in target.likelihood.chain.parameters}
    expected = np.sqrt(np.diag(covariance)) * np.abs(local.units)
    rows = []
    for j, (name, prior, bound) in enumerate(zip(target.free, target.priors, bounds, strict=False)):
        prior_sd, data_sd = float(prior.sd()), float(local.data_sd[j])
        p, sds = described[name], (data_sd, float(expected[j]), prior_sd)
        status = _status(verdict(float(expected[j]), prior_sd, data_sd), bound)
        rows.append(Prospect(name, p.unit, p.meaning, float(estimate[j]), *sds, status, bound))
    return tuple(rows)


def _status(found: Determined, bound: str | None) -> Status:
    return "limit" if bound and found != "prior" else KNOWN_BY[found]


def _told(target: Target, estimate: Array) -> set[str]:
    """Name parameters that somebody knows, as their priors say."""
    return {
        name
        for name, prior, value in zip(target.names, target.priors, estimate, strict=True)
        if not prior.default and prior.sd() < KNOWN * abs(value)
    }


def _combinations(
    target: Target,
    estimate: Array,
    local: LocalInformation,
    load: float,
    parameters: Sequence[Prospect],
    covariance: Array,
) -> tuple[Prospect, ...]:
    """Derive what the parameters amount to, best known first; on a bound where all of them are."""
    bounds = np.array([p.on_bound is not None for p in parameters])
    moved, widths = moved_beside(local, estimate)
    found = []
    vectors = target.chain_values(np.concatenate([moved, estimate[None]]))
    for q in derive(target.likelihood.chain, vectors, load):
        up, down = q.values[:-1].reshape(2, -1)
        value, gradient = float(q.values[-1]), (up - down) / widths
        if not np.isfinite(value) or not np.isfinite(gradient).all() or not gradient.any():
            continue
        scaled = gradient * local.units
        used = scaled != 0.0
        expected = float(scaled[used] @ covariance[np.ix_(used, used)] @ scaled[used])
        expected_sd = float(np.sqrt(expected)) if expected >= 0.0 else float("inf")
        data_sd = local.data_sd_of(gradient)
        ends = [p.on_bound for p, some in zip(parameters, used, strict=True) if some]
        on_bound = ends[0] if bounds[used].all() else None
        found.append(
            Prospect(
                q.name,
                q.unit,
                q.meaning,
                value,
                data_sd,
                expected_sd,
                # its prior is not looked at here
                status=_status(verdict(expected_sd, float("inf"), data_sd), on_bound),
                on_bound=on_bound,
            )
        )
    return tuple(sorted(found, key=lambda one: one.data_sd / max(abs(one.value), 1e-300)))
