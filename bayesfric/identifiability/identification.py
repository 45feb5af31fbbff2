"""What recordings can and cannot determine, before anything is sampled.

The Jacobian of the observed quantity over its noise, in logarithms of the parameters, is taken at
the estimate. A direction is *null* where its singular value is below 1e-7 of the largest, which is
a thousand times what rounding makes of an exact zero (1e-6 for a simulated position); it is *weak*
where the data leave the logarithm of a parameter more than 0.5.

Among the combinations are the base parameters, the motor-side totals of eq. (11), which the data
may determine even where they leave single parameters open.
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
from bayesfric.identifiability.simulated_recording import scaled_jacobian, torque_noise
from bayesfric.inference.priors import KNOWN
from bayesfric.inference.target import Target, units_of
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Measurement
from bayesfric.results.reported import KNOWN_BY, Determined, Status

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Prospect:
    """One parameter or derived quantity and how well it would be known."""

    name: str
    unit: str
    meaning: str
    value: float  # at the estimate; arbitrary where data_sd is infinite
    data_sd: float  # from the data alone, with the noise of a fit
    expected_sd: float  # of data and prior together
    prior_sd: float = float("nan")  # NaN of derived quantities
    status: Status | None = None  # expected of a fit
    # end of its prior that the estimate is on: then only a limit can be reported
    on_bound: str | None = None


@dataclass(frozen=True, eq=False)
class Identification:
    """The identifiability of a model at an estimate."""

    method: str  # of the likelihood
    noise: str  # its model of the noise
    # whether the noise may be autocorrelated: point estimates assume white residuals instead
    memory: bool
    local: LocalInformation
    directions: tuple[OpenDirection, ...]  # null ones, then weak ones, the weakest first
    parameters: tuple[Prospect, ...]  # the free ones, in their order
    combinations: tuple[Prospect, ...]  # derived quantities, best known first
    recordings: tuple[Coverage, ...]
    # share of the moving outputs in which the load drives each element
    back_driving: dict[str, float]
    voltage: SpeedTerm | None  # where a torque comes from a voltage

    @property
    def frame(self) -> pd.DataFrame:
        """One row a parameter: how well it would be known, and what it trades off against."""
        import pandas as pd

        table = pd.DataFrame([vars(prospect) for prospect in self.parameters]).set_index("name")
        sharing = [
            [name for d in self.directions if label in d.exponents for name in d.exponents]
            for label in self.local.labels
        ]
        table["open_with"] = [
            ", ".join(dict.fromkeys(name for name in names if name != label))
            for label, names in zip(self.local.labels, sharing, strict=True)
        ]
        return table

    def __repr__(self) -> str:
        return self.frame.to_string(float_format="{:.4g}".format)

    @property
    def determined(self) -> list[Prospect]:
        """Combinations with a ``data_sd`` below half the value; no limits."""
        return [
            combination
            for combination in self.combinations
            if combination.data_sd < WEAK * abs(combination.value)
            and combination.status != "unidentified"
            and not combination.on_bound
        ]

    @property
    def remarks(self) -> list[str]:
        """Sentences on back-driving and on a voltage."""
        sentences = map(self._back_driving, self.back_driving)
        return [*sentences, self.voltage.meaning] if self.voltage else [*sentences]

    def _back_driving(self, element: str) -> str:
        """Describe how often the load drives an element."""
        share, loss = self.back_driving[element], f"{element}.load_back"
        sentence = f"the load drives {element} in {percent(share)} % of the moving outputs"
        row = next((prospect for prospect in self.parameters if prospect.name == loss), None)
        open_loss = share < HARDLY and row is not None and row.status == "unidentified"
        return f"{sentence}: {loss} rests on its prior" if open_loss else sentence

    def as_json(self) -> dict[str, Any]:
        """Give what ``bayesfric identify --json`` prints; what is infinite is ``None``."""
        voltage = self.voltage
        fields = {
            "method": self.method,
            "noise": self.noise,
            "directions": self.directions,
            "combinations": {p.name: _fields(p, "name", "prior_sd") for p in self.combinations},
            "parameters": {p.name: _fields(p, "name") for p in self.parameters},
            "back_driving": {
                name: {"at_estimate": share, "meaning": self._back_driving(name)}
                for name, share in self.back_driving.items()
            },
            "recordings": self.recordings,
            "voltage": voltage and {**vars(voltage), "meaning": voltage.meaning},
        }
        return dict(jsonable(fields))


def _fields(record: Any, *names: str) -> dict[str, Any]:
    return {name: value for name, value in vars(record).items() if name not in names}


def identify(target: Target, estimate: Array, *, speed: SpeedTerm | None = None) -> Identification:
    """Compute what the recordings determine at an estimate ``(d,)``, before anything is sampled.

    With J the Jacobian over the noise and P the priors' variances, the data's information is
    ``J'J`` and a quantity of gradient g has ``sd² = g' (J'J + P^-1)^-1 g``. The scalings are
    structurally unidentifiable; weak directions are practically so [1]_.

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
        tuple(
            open_directions(local, free, coverage, back, tried, _known_parameters(target, estimate))
        ),
        parameters,
        _combinations(target, estimate, local, parameters, both),
        coverage,
        back,
        speed,
    )


def _bounds_met(target: Target, estimate: Array) -> list[str | None]:
    """Give the end of its prior that the estimate of each free parameter is on, if any."""
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
    """Give the sds of every free parameter from data, data and prior, and prior."""
    described = {p.name: p for p in target.likelihood.chain.parameters}
    rows = []
    for j, (name, prior, bound) in enumerate(zip(target.free, target.priors, bounds, strict=False)):
        p, gradient = described[name], np.eye(len(target.free))[j] * local.units
        data_sd, expected, prior_sd = float(local.data_sd[j]), both.sd(gradient), float(prior.sd())
        sds = data_sd, expected, prior_sd
        status = _status(verdict(expected, prior_sd, data_sd), bound)
        rows.append(Prospect(name, p.unit, p.meaning, float(estimate[j]), *sds, status, bound))
    return tuple(rows)


def _status(determined: Determined, bound: str | None) -> Status:
    return "limit" if bound and determined != "prior" else KNOWN_BY[determined]


def _known_parameters(target: Target, estimate: Array) -> set[str]:
    """Name parameters with an informative prior."""
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
    """Give the derived quantities, best known first; undefined and fixed ones are left out."""
    combinations = []
    for q, value, gradient in derived_gradients(target, estimate, local):
        if not np.isfinite([value, *gradient]).all() or not gradient.any():
            continue
        data_sd, expected = local.data_sd_of(gradient / local.units), both.sd(gradient)
        ends = [p.on_bound for p, x in zip(parameters, gradient, strict=True) if x]
        on_bound = ends[0] if all(ends) else None
        # without its prior
        status = _status(verdict(expected, float("inf"), data_sd), on_bound)
        prospect = Prospect(q.name, q.unit, q.meaning, value, data_sd, expected)
        combinations.append(replace(prospect, status=status, on_bound=on_bound))
    return tuple(sorted(combinations, key=lambda p: p.data_sd / max(abs(p.value), 1e-300)))


# Sine of the angle below which two columns of a Jacobian are collinear.
_COLLINEAR = 1e-6


@dataclass(frozen=True)
class SpeedTerm:
    """What is collinear with a torque proportional to speed, such as a back-EMF's."""

    recordings: tuple[str, ...]  # whose torque comes from a voltage
    nominal: float  # the largest kt²/R, in N m s or N s/m at the motor
    unit: str
    same_as_back_emf: tuple[str, ...]  # parameters whose effect, single or joint, is collinear
    explained: float  # share of the term's square that parameters make up for, 0 to 1

    @property
    def meaning(self) -> str:
        """Describe what is confounded, and what measurement would separate it."""
        names = " and ".join(self.same_as_back_emf)
        premise = (
            f"torque comes from a voltage ({', '.join(self.recordings)}), less the nominal "
            f"back-EMF kt²/R ({self.nominal:.3g} {self.unit}, at the motor) times speed"
        )
        if not names:
            return f"{premise}; parameters explain {100.0 * self.explained:.0f} % of an error in it"
        return (
            f"{premise}; viscous loss and back-EMF are indistinguishable: it has exactly the shape"
            f" of {names}: viscous loss plus the error of the nominal kt²/R. A measured current, or"
            " kt and R measured at a standstill, would distinguish them"
        )


def speed_term(
    target: Target, parameters: Array, recordings: Sequence[Measurement]
) -> SpeedTerm | None:
    """Project a torque proportional to speed on the effects of the parameters.

    With ``V = R I + kt w`` the torque computed from a voltage is ``kt V/R - kt² w/R`` at the
    motor's speed w; an error of the nominal ``kt²/R`` adds a term proportional to speed. That,
    filtered and whitened as the torque is, is projected on the columns of the Jacobian.
    """
    observations = target.likelihood.observations
    nominal = {r.name: r.nominal_back_emf for r in recordings if r.nominal_back_emf}
    names = tuple(o.name for o in observations if o.name in nominal)
    if not names:
        return None
    at, values = units_of(target, parameters), target.chain_values(parameters[None])[0]
    noise = [torque_noise(target, parameters, r) for r in range(len(observations))]
    pairs = list(zip(observations, noise, strict=True))
    blocks = [scaled_jacobian(target, o, values, at, n) for o, n in pairs]
    jacobian = np.concatenate(blocks)
    term = np.concatenate(
        [n.whitened(o.filter.apply(o.qd) * (o.name in names), o) for o, n in pairs]
    )
    term /= np.linalg.norm(term)
    sizes = np.linalg.norm(jacobian, axis=0)
    unit = jacobian / np.where(sizes > 0.0, sizes, 1.0)
    apart = np.linalg.norm(unit - np.outer(term, term @ unit), axis=0)
    same = np.flatnonzero((sizes > 0.0) & (apart < _COLLINEAR))
    coefficients = np.linalg.lstsq(unit, term, rcond=1e-9)[0]
    residual = term - unit @ coefficients
    if not same.size and np.linalg.norm(residual) < _COLLINEAR:  # as of friction by direction
        same = np.flatnonzero(np.abs(coefficients) > _COLLINEAR)
    return SpeedTerm(
        names,
        max(nominal[name] for name in names),
        "N m s" if target.likelihood.chain.motor_motion == "rotary" else "N s/m",
        tuple(target.free[j] for j in same),
        float(1.0 - residual @ residual),
    )
