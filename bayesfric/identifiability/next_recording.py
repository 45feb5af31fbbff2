"""The next experiment: how well one quantity would be known after each candidate.

What a recording adds is its Fisher information, so the sd that a candidate would leave is predicted
from prior, present recordings and candidate without sampling anything: a local Bayesian design
[1]_, at the estimate.

References
----------
.. [1] K. Chaloner, I. Verdinelli, "Bayesian experimental design: a review", Statistical Science 10
   (1995) 273-304.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesfric.base.atomic_write import jsonable
from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.templates import percent
from bayesfric.estimates.assemble import open_directions
from bayesfric.estimates.information import Directions, directions
from bayesfric.identifiability.advice_options import AdviceOptions
from bayesfric.identifiability.coverage import back_driven
from bayesfric.identifiability.local import (
    LocalInformation,
    derived_beside,
    fixed_in,
    joined,
    prior_rows,
)
from bayesfric.identifiability.proposals import (
    Candidate,
    Limits,
    candidates,
    fastest,
    limits_of,
    longest,
    try_out,
)
from bayesfric.identifiability.virtual_recording import TorqueNoise, scaled_jacobian, torque_noise
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

if TYPE_CHECKING:
    import pandas as pd

# Anything that a candidate leaves of the sd above this share is not worth the effort.
WORTH = 0.95
# What all standard deviations here take for granted.
ASSUMPTION = (
    "All sds here hold only if the model is right. Where it misses something, the ± of "
    "'bayesfric fit' is larger: see first what 'bayesfric explain' would add."
)
# Share of what counts as a change of one that is next to zero, but is not.
_OFF_ZERO = 1e-3


@dataclass(frozen=True)
class Uncertainty:
    """How well the quantity is known."""

    # Of recordings and prior together, in the quantity's unit; infinite where neither confines it
    sd: float
    relative_sd: float | None  # The same as a share of the value, if recordings determine that
    data_sd: float  # Of the recordings alone; infinite where they leave it open


@dataclass(frozen=True, eq=False)
class Advice:
    """One recording that could be made next, and what it would do."""

    candidate: Candidate  # What to play, with the torque that keeps the limits
    after: Uncertainty  # How well the quantity would be known then
    # By element with a load loss, share of the moving outputs in which the load drives it
    load_drives: dict[str, float]
    # Fastest that the joint becomes, rad/s or m/s; lowest and highest position, rad or m
    peak_speed: float
    angles: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Ranking:
    """Candidates by the sd that they would leave of one quantity, the best first."""

    quantity: str  # What is to be known
    unit: str
    meaning: str
    value: float  # At the estimate; it means nothing where now.data_sd is infinite
    now: Uncertainty  # How well it is known at present
    advices: tuple[Advice, ...]  # Candidates that keep the limits, the best first
    dropped: tuple[tuple[Candidate, str], ...]  # Candidates that are no use, and why
    limits: Limits  # What they had to keep

    @property
    def determined(self) -> bool:
        """Whether the recordings, there and to come, would determine it without the prior."""
        return any(np.isfinite(one.after.data_sd) for one in self.advices)

    @property
    def worth(self) -> bool:
        """Whether the best candidate leaves less than 95 % of the sd that is left now."""
        best = self.advices[0].after if self.advices else self.now
        if not np.isfinite(best.sd):
            return False
        return best.sd < WORTH * self.now.sd or not np.isfinite(self.now.sd)

    @property
    def verdict(self) -> str:
        """Whether any candidate is worth making, in a sentence."""
        if not self.advices:
            return "Nothing that was tried can be played within the limits."
        if not self.determined:
            mass = "; a known mass (masses in [advice]) may"
            return (
                f"No recording that was tried determines {self.quantity}: whatever is recorded, it "
                f"rests on the priors{mass * (len(self.limits.masses) < 2)}."
            )
        share = self.advices[0].after.sd / self.now.sd
        if not self.worth:
            return (
                "Nothing that was tried is worth the effort: the best leaves "
                f"{100.0 * share:.0f} % of the sd there is."
            )
        if not np.isfinite(self.advices[0].after.data_sd):
            return "The best leaves it to the priors where they are narrower than the data are."
        if not np.isfinite(self.now.data_sd):
            return (
                "The recordings there are leave it open; the best of the next would determine it."
            )
        return f"The best of the next would leave {percent(share)} % of that sd."

    @property
    def left_out(self) -> Counter[str]:
        """Reasons why candidates are no use, with how many there are of each."""
        return Counter(why for _, why in self.dropped)

    def as_json(self) -> dict[str, Any]:
        """Give what ``identify --advise --json`` prints; what is infinite is ``None``."""
        rows = [
            _described(one.candidate)
            | {"rank": rank, "after": one.after, "load_drives": one.load_drives}
            | {"peak_speed": one.peak_speed, "angles": one.angles}
            | {"torque_lowered_to": one.candidate.lowered, "because_of": one.candidate.because_of}
            for rank, one in enumerate(self.advices, start=1)
        ]
        masses = [(m.added_mass, m.radius) for m in self.limits.masses if m.added_mass]
        found = {name: getattr(self, name) for name in ("quantity", "unit", "meaning", "value")}
        found |= {"determined": bool(np.isfinite(self.now.data_sd)), "now": self.now}
        found |= {"limits": {**vars(self.limits), "masses": masses}}
        found |= {"assumption": ASSUMPTION, "verdict": self.verdict, "candidates": rows}
        found["dropped"] = [_described(one) | {"reason": why} for one, why in self.dropped]
        return dict(jsonable(found))

    @property
    def frame(self) -> pd.DataFrame:
        """One row a candidate, the best first, as :meth:`as_json` has them."""
        import pandas as pd

        return pd.json_normalize(self.as_json()["candidates"]).set_index("rank")

    def __repr__(self) -> str:
        return self.frame.to_string(float_format="{:.4g}".format)


def _described(one: Candidate) -> dict[str, Any]:
    found = {"kind": one.kind, "form": one.form, "peak_torque": one.amplitude}
    found |= {"duration": one.duration, "added_mass": one.inputs.added_mass}
    return found | {"radius": one.inputs.radius, "start": one.q0}


def ranking(
    target: Target,
    point: Array,
    local: LocalInformation,
    options: AdviceOptions,
    name: str,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> Ranking:
    """Rank candidates for the next recording by what they would leave of one quantity.

    With the output error, a candidate still adds the information of its torque, at the noise of a
    torque sample.

    With J the Jacobians over the noise, of present recordings (0) and candidate (1), P the priors'
    variances and g the gradient, ``sd² = g' (J0'J0 + J1'J1 + P^-1)^-1 g``, c-optimality's.

    Shapes: point (d,).
    """
    chain, observations = target.likelihood.chain, target.likelihood.observations
    unit, meaning, value, gradient = _asked(target, point, local, name)
    limits = limits_of(options, chain, observations, target.chain_values(point[None])[0])
    values = _movable(target, point, local)
    base, priors = longest(observations), prior_rows(target, local)
    noise = torque_noise(target, point, next(i for i, o in enumerate(observations) if o is base))

    def known(*added: Observation) -> Uncertainty:
        told = _told(target, values, local, noise, added)
        if told is None:
            return Uncertainty(float("inf"), None, float("inf"))
        sd = joined(told.told, priors).sd(gradient)
        data_sd = told.sd(gradient)
        # a share of a value that is not determined would mean nothing
        share = sd / abs(value) if np.isfinite(data_sd) and value != 0.0 else None
        return Uncertainty(sd, share, data_sd)

    advices, dropped = [], []
    at_estimate = target.chain_values(point[None])[0]
    for candidate in candidates(chain, at_estimate, observations, limits):
        progress(f"simulating {candidate.form}")
        tried = try_out(chain, values, base, candidate, limits)
        if isinstance(tried, str):
            dropped.append((candidate, tried))
            continue
        made, o = tried
        shares = back_driven(chain, [o], values[None])
        drives = {element: float(share[0]) for element, share in shares.items()}
        peak = fastest(o) if made.made is not None else float(np.abs(o.qd).max())
        ends = float(o.q.min()), float(o.q.max())
        advices.append(Advice(made, known(o), drives, peak, ends))
    advices.sort(key=lambda one: (one.after.sd, one.after.data_sd))
    return Ranking(name, unit, meaning, value, known(), tuple(advices), tuple(dropped), limits)


def _asked(
    target: Target, point: Array, local: LocalInformation, name: str
) -> tuple[str, str, float, Array]:
    """Give unit, meaning, value and gradient of what is asked.

    The gradient ``(d,)`` is by changes of one in the local units. Raises :class:`BadInput` for what
    is no name, is fixed, or is not defined at the estimate.
    """
    chain, where = target.likelihood.chain, f"--advise {name}"
    parameters = {p.name: p for p in chain.parameters}
    if name in target.free:
        j, p = target.free.index(name), parameters[name]
        return p.unit, p.meaning, float(point[j]), np.eye(local.units.size)[j] * local.units
    if name in parameters:
        fixed = target.chain_values(point[None])[0, chain.names.index(name)]
        what = f"is fixed at {fixed:.6g} by its prior"
        raise BadInput(where, what, f"give priors.{name} a width, or ask for another quantity")
    derived = {q.name: (q, value, x) for q, value, x in derived_beside(target, point, local)}
    if name not in derived:
        known = nearest(name, [*parameters, *derived])
        raise BadInput(where, "no parameter or derived quantity has that name", known)
    q, value, gradient = derived[name]
    if not np.isfinite(gradient).all() or not gradient.any():
        what = "is not defined at the estimate, or made of fixed values only"
        raise BadInput(where, what, "give these priors with a width, or ask for another quantity")
    return q.unit, q.meaning, value, gradient


def _movable(target: Target, parameters: Array, local: LocalInformation) -> Array:
    """Values of the chain ``(n_parameters,)`` that can be simulated, at sampled ones ``(d,)``.

    What shapes others and is zero, as a Stribeck velocity on its bound, gives a term no one value
    at rest: so little more that no sample shows it does.
    """
    chain, moved = target.likelihood.chain, parameters.copy()
    for k, name in enumerate(target.free):
        row = chain.parameters[chain.names.index(name)].row
        if row.role == "form" and row.lower == 0.0 < row.default:
            moved[k] = max(moved[k], _OFF_ZERO * abs(float(local.units[k])))
    return np.asarray(target.chain_values(moved[None])[0])


def _told(
    target: Target,
    values: Array,
    local: LocalInformation,
    noise: TorqueNoise,
    added: Sequence[Observation],
) -> Directions | None:
    """Take what recordings tell, in the local units, with more of them; ``None`` if one cannot be.

    What theory says that no torque tells is taken out first: rounding never makes a finite sd.
    """
    rows, known = local.directions.told, None
    if added:
        more = [scaled_jacobian(target, o, values, local, noise) for o in added]
        rows = np.concatenate([rows, *more])
        # which scalings are open depends on the masses in all recordings together
        together = [*target.likelihood.observations, *added]
        open_ = open_directions(target.likelihood.chain, fixed_in(target, values), together, values)
        known = open_ / local.units
    if not np.isfinite(rows).all():
        return None
    return directions(rows, np.ones(rows.shape[1]), local.directions.tolerance, known_null=known)
