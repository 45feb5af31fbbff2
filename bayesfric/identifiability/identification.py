"""What recordings can and cannot tell, before anything is sampled.

The Jacobian of the observed quantity over its noise, in logarithms of the parameters, is taken at
the estimate. A direction is *null* where its singular value is below 1e-7 of the largest, which is
a thousand times what rounding makes of an exact zero (1e-6 for a simulated position); it is *weak*
where the data leave the logarithm of a parameter more than 0.5.

Among the combinations are the base parameters, the motor-side totals of eq. (11), which the data
may determine whatever else they leave open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesfric.base.atomic_write import jsonable
from bayesfric.base.templates import percent
from bayesfric.estimates.assemble import bounds_met
from bayesfric.estimates.information import Directions
from bayesfric.identifiability.coverage import Coverage, back_driving_shares, coverage_of
from bayesfric.identifiability.local import (
    WEAK,
    LocalInformation,
    derived_gradients,
    in_natural_units,
    joined,
    local_information,
    prior_rows,
    verdict,
)
from bayesfric.identifiability.open_directions import (
    HARDLY,
    OpenDirection,
    open_directions,
    open_rows,
    trials,
)
from bayesfric.identifiability.virtual_recording import scaled_jacobian, torque_noise
from bayesfric.inference.local_units import units_of
from bayesfric.inference.prior.priors import KNOWN
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Measurement
from bayesfric.results.reported import KNOWN_BY, Determined, Status

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Prospect:
    """One parameter or derived quantity and how well it would be known."""

    name: str  # As in :class:`bayesfric.mechanism.parameter.Parameter`
    unit: str
    meaning: str
    value: float  # At the estimate; it means nothing where data_sd is infinite
    # Standard deviation that the data alone would leave, the noise being what a fit takes it for
    data_sd: float
    expected_sd: float  # Of data and prior together
    prior_sd: float = float("nan")  # Of a parameter's prior; NaN of what is derived
    status: Status | None = None  # To be expected of a fit
    # lower or upper end of its prior where the estimate is on it: then only a limit can be reported
    on_bound: str | None = None


@dataclass(frozen=True, eq=False)
class Identification:
    """Everything that the local picture says."""

    method: str  # Of the likelihood, and what it takes the noise for
    noise: str
    # Whether the noise may be autocorrelated: point estimates weigh all residuals alike, and have
    # other standard deviations then
    memory: bool
    local: LocalInformation  # Fisher information at the estimate
    directions: tuple[OpenDirection, ...]  # Null ones first, then weak ones, the weakest first
    parameters: tuple[Prospect, ...]  # The free ones, in their order
    combinations: tuple[Prospect, ...]  # What they amount to, best known first
    recordings: tuple[Coverage, ...]  # What each went through
    # By element with a load loss, share of the moving outputs in which the load drives it
    back_driving: dict[str, float]
    # What a back-EMF cannot be told from, where a torque comes from a voltage
    voltage: SpeedTerm | None

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

    def __repr__(self) -> str:
        return self.frame.to_string(float_format="{:.4g}".format)

    @property
    def determined(self) -> list[Prospect]:
        """Combinations that the data determine, whatever else they do not; no limits.

        Those whose ``data_sd`` is less than half the value. A bound may narrow them further, as it
        does what a value on it can be traded for.
        """
        return [
            one
            for one in self.combinations
            if one.data_sd < WEAK * abs(one.value)
            and one.status != "unidentified"
            and not one.on_bound
        ]

    @property
    def remarks(self) -> list[str]:
        """What is to be said of back-driving and of a voltage, a sentence each."""
        found = map(self._seen, self.back_driving)
        return [*found, self.voltage.meaning] if self.voltage else [*found]

    def _seen(self, element: str) -> str:
        """Say how often the load drives an element."""
        share, loss = self.back_driving[element], f"{element}.load_back"
        said = f"the load drives {element} in {percent(share)} % of the moving outputs"
        row = next((one for one in self.parameters if one.name == loss), None)
        open_ = share < HARDLY and row is not None and row.status == "unidentified"
        return f"{said}: {loss} rests on its prior" if open_ else said

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
            "voltage": voltage and {**vars(voltage), "meaning": voltage.meaning},
        }
        return dict(jsonable(found))


def _without(record: Any, *names: str) -> dict[str, Any]:
    return {name: value for name, value in vars(record).items() if name not in names}


def identify(target: Target, estimate: Array, *, speed: SpeedTerm | None = None) -> Identification:
    """Find out what the recordings can tell, before anything is sampled.

    With J the Jacobian over the noise and P the priors' variances, the data's information is
    ``J'J`` and a quantity of gradient g has ``sd² = g' (J'J + P^-1)^-1 g``. The scalings are
    structurally unidentifiable; weak directions are practically so [1]_.

    Shapes: estimate (d,).

    .. [1] A. Raue et al., "Structural and practical identifiability analysis of partially observed
    dynamical models by exploiting the profile likelihood", Bioinformatics 25 (2009) 1923-1929.
    """
    chain, observations = target.likelihood.chain, target.likelihood.observations
    local = in_natural_units(target, estimate, local_information(target, estimate))
    values = target.chain_values(estimate[None])
    coverage = coverage_of(chain, observations, values[0])
    shares = back_driving_shares(chain, observations, values)
    back = {name: float(share[0]) for name, share in shares.items()}
    rare = any(share < HARDLY for share in back.values())
    open_ = any(open_rows(local))
    tried = trials(target, estimate, local, rare=rare) if open_ else []
    free = [p for p in chain.parameters if p.name in target.free]
    bounds = _bounds_met(target, estimate)
    both = joined(local.directions.identified, prior_rows(target, local))
    parameters = _parameters(target, estimate, local, bounds, both)
    return Identification(
        target.likelihood.method,
        target.likelihood.noise.description,
        target.likelihood.noise.accounts_for_correlation,
        local,
        tuple(open_directions(local, free, coverage, back, tried, _told(target, estimate))),
        parameters,
        _combinations(target, estimate, local, parameters, both),
        coverage,
        back,
        speed,
    )


def _bounds_met(target: Target, estimate: Array) -> list[str | None]:
    """Say of every free parameter on which end of its prior the estimate stands."""
    k = len(target.free)
    low, high = np.array([p.limits for p in target.priors[:k]]).T
    sds = np.array([p.sd() for p in target.priors[:k]])
    met = bounds_met(estimate[:k], low, high, np.where(np.isfinite(sds), sds, 0.0))
    return [{-1: "lower", 1: "upper"}.get(int(end)) for end in met]


def _parameters(
    target: Target,
    estimate: Array,
    local: LocalInformation,
    bounds: Sequence[str | None],
    both: Directions,
) -> tuple[Prospect, ...]:
    """Say of every free parameter what data alone, data and prior, and the prior leave of it."""
    described = {p.name: p for p in target.likelihood.chain.parameters}
    rows = []
    for j, (name, prior, bound) in enumerate(zip(target.free, target.priors, bounds, strict=False)):
        p, gradient = described[name], np.eye(len(target.free))[j] * local.units
        data_sd, expected, prior_sd = float(local.data_sd[j]), both.sd(gradient), float(prior.sd())
        sds = data_sd, expected, prior_sd
        status = _status(verdict(expected, prior_sd, data_sd), bound)
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
    parameters: Sequence[Prospect],
    both: Directions,
) -> tuple[Prospect, ...]:
    """Derive what the parameters amount to, best known first; on a bound where all of them are.

    What is undefined at the estimate, or made of fixed values only, is left out.
    """
    found = []
    for q, value, gradient in derived_gradients(target, estimate, local):
        if not np.isfinite([value, *gradient]).all() or not gradient.any():
            continue
        data_sd, expected = local.data_sd_of(gradient / local.units), both.sd(gradient)
        ends = [p.on_bound for p, x in zip(parameters, gradient, strict=True) if x]
        on_bound = ends[0] if all(ends) else None
        # its prior is not looked at here
        status = _status(verdict(expected, float("inf"), data_sd), on_bound)
        one = Prospect(q.name, q.unit, q.meaning, value, data_sd, expected)
        found.append(replace(one, status=status, on_bound=on_bound))
    return tuple(sorted(found, key=lambda one: one.data_sd / max(abs(one.value), 1e-300)))


# Sine of the angle below which two columns of a Jacobian are one.
_SAME = 1e-6


@dataclass(frozen=True)
class SpeedTerm:
    """What a torque proportional to speed, such as a back-EMF's, cannot be told from."""

    recordings: tuple[str, ...]  # Those whose torque comes from a voltage
    # kt²/R as given, the largest: what the speed takes off, in N m s or N s/m at the motor
    nominal: float
    unit: str
    # Parameters whose effect, each one's or all together, has the same shape exactly
    same_as_back_emf: tuple[str, ...]
    # Share of the term's square that some change of parameters makes up for, 0 to 1
    explained: float

    @property
    def meaning(self) -> str:
        """Say what is confounded, and what measurement would tell it apart."""
        names = " and ".join(self.same_as_back_emf)
        told = (
            f"torque comes from a voltage ({', '.join(self.recordings)}), less the nominal "
            f"back-EMF kt²/R ({self.nominal:.3g} {self.unit}, at the motor) times speed"
        )
        if not names:
            return (
                f"{told}; parameters make up for {100.0 * self.explained:.0f} % of an error in it"
            )
        return (
            f"{told}; viscous loss and back-EMF cannot be told apart, as that has exactly the shape"
            f" of {names}: viscous loss plus the error of the nominal kt²/R. A measured current, or"
            " kt and R measured at a standstill, would tell them apart"
        )


def speed_term(
    target: Target, parameters: Array, recordings: Sequence[Measurement]
) -> SpeedTerm | None:
    """Compare a torque proportional to speed with what the parameters can do.

    With ``V = R I + kt w`` the torque computed from a voltage is ``kt V/R - kt² w/R`` at the
    motor's speed w; an error of the nominal ``kt²/R`` adds a term proportional to speed. That,
    filtered and whitened as the torque is, is projected on the columns of the Jacobian.

    Shapes: parameters (d,).
    """
    observations = target.likelihood.observations
    nominal = {r.name: r.nominal_back_emf for r in recordings if r.nominal_back_emf}
    told = tuple(o.name for o in observations if o.name in nominal)
    if not told:
        return None
    at, values = units_of(target, parameters), target.chain_values(parameters[None])[0]
    noise = [torque_noise(target, parameters, r) for r in range(len(observations))]
    pairs = list(zip(observations, noise, strict=True))
    blocks = [scaled_jacobian(target, o, values, at, one) for o, one in pairs]
    jacobian = np.concatenate(blocks)
    term = np.concatenate(
        [one.whitened(o.filter.apply(o.qd) * (o.name in told), o) for o, one in pairs]
    )
    term /= np.linalg.norm(term)
    sizes = np.linalg.norm(jacobian, axis=0)
    unit = jacobian / np.where(sizes > 0.0, sizes, 1.0)
    apart = np.linalg.norm(unit - np.outer(term, term @ unit), axis=0)
    same = np.flatnonzero((sizes > 0.0) & (apart < _SAME))
    parts = np.linalg.lstsq(unit, term, rcond=1e-9)[0]
    rest = term - unit @ parts
    if not same.size and np.linalg.norm(rest) < _SAME:  # as of a loss by direction
        same = np.flatnonzero(np.abs(parts) > _SAME)
    return SpeedTerm(
        told,
        max(nominal[name] for name in told),
        "N m s" if target.likelihood.chain.motor_motion == "rotary" else "N s/m",
        tuple(target.free[j] for j in same),
        float(1.0 - rest @ rest),
    )
