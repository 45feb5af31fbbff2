"""The next experiment: how well one quantity would be known after each candidate.

What a recording adds is its Fisher information, so the sd that a candidate would leave is
predicted from prior, present recordings and candidate without sampling anything. That is
done at the estimate and at other vectors that may be true as well; variances are averaged
over these points, as the expected variance is what a Bayesian design minimises
(Chaloner and Verdinelli, Statistical Science 10, 1995).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput, nearest
from bayesfric.estimates.assemble import open_directions
from bayesfric.estimates.information import directions
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.torque import typical_load
from bayesfric.identifiability.advice_options import AdviceOptions
from bayesfric.identifiability.candidates import (
    Candidate,
    Limits,
    TriedOut,
    candidates,
    limits_of,
    longest,
    try_out,
)
from bayesfric.identifiability.coverage import back_driven
from bayesfric.identifiability.local import LocalInformation, local_information
from bayesfric.identifiability.plausible import Point
from bayesfric.identifiability.virtual_recording import TorqueNoise, scaled_jacobian, torque_noise
from bayesfric.inference.target import Target
from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.experiment import Simulation, measure
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]

# Singular values below this share of the largest are rounding once null directions are out.
_ROUNDING = 1e-13
# Anything that a candidate leaves of the sd above this share is not worth the effort.
WORTH = 0.95


@dataclass(frozen=True)
class Uncertainty:
    """How well the quantity is known, root mean square over the points.

    Attributes
    ----------
    sd
        Of the posterior: recordings and prior together; infinite where neither confines it.
    data_sd
        That the recordings alone leave; infinite where they leave it open at any point.
    least, most
        Of the posterior sd over the points.
    """

    sd: float
    data_sd: float
    least: float
    most: float


@dataclass(frozen=True, eq=False)
class Advice:
    """One recording that could be made next, and what it would do.

    Attributes
    ----------
    candidate
        What to play, and with which mass.
    after
        How well the quantity would be known then.
    back_driven
        Element with a load loss, and the mean, least and largest share of moving outputs
        in which the load drives it.
    speed
        Fastest at any point, rad/s or m/s.
    angles
        Lowest and highest position at any point, rad or m.
    lowered
        Factor on the torque that it took to keep the limits; one where none.
    reason
        Which limit that was.
    """

    candidate: Candidate
    after: Uncertainty
    back_driven: dict[str, tuple[float, float, float]]
    speed: float
    angles: tuple[float, float]
    lowered: float
    reason: str

    def recording(
        self, chain: Chain, values: Array, options: Simulation, seed: int
    ) -> dict[str, Array]:
        """Simulate what a bench would record.

        Parameters
        ----------
        chain, values
            The mechanism and its true parameters, ``(n_parameters,)``.
        options
            Encoder and noise are used; sample rate, current loop and mass are the candidate's.
        seed
            Of the noise.

        Returns
        -------
        dict
            ``time`` s, ``position`` rad or m on the encoder's side, ``torque`` N m or N.

        Raises
        ------
        ValueError
            If the joint runs away.
        """
        one = self.candidate
        told = {"rate": 1.0 / one.period, "lag": one.lag}
        told |= {"added_mass": one.added_mass, "radius": one.radius}
        columns, _ = measure(
            chain,
            values,
            one.command,
            options.model_copy(update=told),
            np.random.default_rng(seed),
            q0=one.q0,
            qd0=one.qd0,
        )
        return columns


@dataclass(frozen=True, eq=False)
class Ranking:
    """Candidates by the sd that they would leave of one quantity, the best first.

    Attributes
    ----------
    name, unit, meaning
        Of the quantity.
    value
        At the estimate; it means nothing where ``now.data_sd`` is infinite.
    now
        How well it is known at present.
    advices
        The best first.
    dropped
        Candidates that are no use, and why.
    limits
        What they had to keep.
    points
        Number of parameter vectors that all was simulated at.
    """

    name: str
    unit: str
    meaning: str
    value: float
    now: Uncertainty
    advices: tuple[Advice, ...]
    dropped: tuple[tuple[Candidate, str], ...]
    limits: Limits
    points: int

    @property
    def determined(self) -> bool:
        """Whether the recordings, there and to come, would determine it without the prior."""
        return any(np.isfinite(one.after.data_sd) for one in self.advices)

    @property
    def worth(self) -> bool:
        """Whether the best candidate leaves noticeably less than is left now."""
        best = self.advices[0].after if self.advices else self.now
        if not np.isfinite(best.sd):
            return False
        return best.sd < WORTH * self.now.sd or not np.isfinite(self.now.sd)


@dataclass(frozen=True, eq=False)
class _At:
    """One point: what is known there, in logarithms of the parameters.

    Attributes
    ----------
    values
        ``(n_parameters,)``.
    local
        Of the target.
    rows
        ``(rank, d)`` with ``rows' rows`` the Fisher information of what was recorded.
    prior
        ``(d, d)`` the same of the priors.
    gradient
        ``(d,)`` of the quantity, by changes of one in the local units.
    """

    values: Array
    local: LocalInformation
    rows: Array
    prior: Array
    gradient: Array


def advise(
    target: Target,
    points: Sequence[Point],
    local: LocalInformation,
    options: AdviceOptions,
    name: str,
) -> tuple[Advice, ...]:
    """Rank candidates for the next recording, the best first; see :func:`ranking`."""
    return ranking(target, points, local, options, name).advices


def ranking(
    target: Target,
    points: Sequence[Point],
    local: LocalInformation,
    options: AdviceOptions,
    name: str,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> Ranking:
    """Rank candidates for the next recording by what they would leave of one quantity.

    Parameters
    ----------
    target
        Likelihood, priors and noise. With the output error, a candidate still adds the
        information of its torque, at the noise of a torque sample.
    points
        The estimate first, then others that may be true; see
        :func:`bayesfric.identifiability.plausible.points_around`.
    local
        Of the target at the estimate.
    options
        The ``[advice]`` table.
    name
        A free parameter or a derived quantity.
    progress
        Called with the name of each stage before it begins.

    Raises
    ------
    BadInput
        If there is no such quantity, if it is fixed, or if a limit cannot be.
    """
    chain, observations = target.likelihood.chain, target.likelihood.observations
    first = points[0].parameters
    at_estimate = target.chain_values(first[None])[0]
    load = typical_load(chain, observations, at_estimate)
    unit, meaning = check_quantity(target, name, first, load)
    value = _values(target, name, first[None], load)[0]
    sds = np.array([p.sd() for p in target.priors[: len(target.free)]])
    there = []
    for p in points:
        try:
            found = local if p is points[0] else local_information(target, p.parameters)
            there.append(_at(target, p, found, sds, name, load))
        except BadInput:
            if p is points[0]:
                raise
    limits = limits_of(options, chain, observations, at_estimate)
    base = longest(observations)
    number = next(i for i, o in enumerate(target.likelihood.observations) if o is base)
    noise = torque_noise(target, first, number)
    vectors = np.stack([one.values for one in there])
    advices, dropped = [], []
    least: dict[tuple[str, float, float], float] = {}
    for candidate in candidates(observations, limits):
        same = candidate.form, candidate.added_mass, candidate.radius
        if candidate.amplitude >= least.get(same, np.inf):
            continue  # more than this breaks a limit, as was found; or this does not move
        progress(f"simulating {candidate.form}")
        tried = try_out(chain, vectors, base, candidate, limits)
        if isinstance(tried, str):
            dropped.append((candidate, tried))
            least[same] = 0.0
            continue
        if tried.reason:
            least[same] = tried.candidate.amplitude
        advices.append(_advice(target, there, tried, noise))
    advices.sort(key=lambda one: (one.after.sd, one.after.data_sd))
    now = _averaged([_sds(target, one) for one in there])
    return Ranking(
        name, unit, meaning, value, now, tuple(advices), tuple(dropped), limits, len(there)
    )


def check_quantity(target: Target, name: str, parameters: Array, load: float) -> tuple[str, str]:
    """Give unit and meaning of a quantity that can be advised on.

    Parameters
    ----------
    target
        Likelihood, priors and noise.
    name
        What the user asked for.
    parameters
        ``(d,)`` any possible vector.
    load
        Joint torque at which efficiencies are stated, N m or N.

    Raises
    ------
    BadInput
        If nothing has that name, or it is known already.
    """
    chain = target.likelihood.chain
    where = f"--advise {name}"
    described = {p.name: (p.unit, p.meaning) for p in chain.parameters}
    made = {q.name: q for q in derive(chain, target.chain_values(parameters[None]), load)}
    described |= {q.name: (q.unit, q.meaning) for q in made.values()}
    if name not in described:
        raise BadInput(
            where, "no parameter or derived quantity has that name", nearest(name, described)
        )
    if name in chain.names and name not in target.free:
        known = target.chain_values(parameters[None])[0, chain.names.index(name)]
        raise BadInput(
            where,
            f"is fixed at {known:.6g} by its prior, so no experiment changes it",
            f"give priors.{name} a width, or ask for another quantity",
        )
    if name in made and not np.isfinite(made[name].values).all():
        raise BadInput(where, "is not defined at the estimate", "ask for another quantity")
    return described[name]


def _values(target: Target, name: str, parameters: Array, load: float) -> Array:
    """Values of the quantity at sampled parameters ``(n, d)``, ``(n,)``."""
    if name in target.free:
        return np.asarray(parameters[:, target.free.index(name)])
    made = derive(target.likelihood.chain, target.chain_values(parameters), load)
    return next(q.values for q in made if q.name == name)


def _at(
    target: Target, point: Point, local: LocalInformation, sds: Array, name: str, load: float
) -> _At:
    """Look at one point; ``sds`` ``(d,)`` are the priors'."""
    k = len(target.free)
    d = local.directions
    rows = d.rows[~d.null] * d.singular_values[~d.null, None]
    # central differences, exact up to rounding for what is next to linear
    steps = 1e-5 * np.abs(local.units)
    moved = np.tile(point.parameters, (2 * k, 1))
    index = np.arange(k)
    moved[index, index] += steps
    moved[k + index, index] -= steps
    values = _values(target, name, moved, load)
    gradient = (values[:k] - values[k:]) / (2.0 * steps) * local.units
    if not np.isfinite(gradient).all():
        raise BadInput(
            f"--advise {name}", "cannot be differentiated here", "ask for another quantity"
        )
    if not gradient.any():
        raise BadInput(
            f"--advise {name}",
            "is made of fixed values only, so no experiment changes it",
            "give them priors with a width, or ask for another quantity",
        )
    ratio = np.abs(local.units) / sds
    prior = np.diag(np.where(np.isfinite(ratio), ratio, 0.0))
    return _At(target.chain_values(point.parameters[None])[0], local, rows, prior, gradient)


def _advice(
    target: Target,
    there: Sequence[_At],
    tried: TriedOut,
    noise: TorqueNoise,
) -> Advice:
    chain = target.likelihood.chain
    sds, shares = [], []
    for one, recording in zip(there, tried.recordings, strict=True):
        sds.append(_sds(target, one, recording, noise))
        shares.append(back_driven(chain, [recording], one.values[None]))
    back = {
        name: (float(x.mean()), float(x.min()), float(x.max()))
        for name in shares[0]
        if (x := np.concatenate([share[name] for share in shares])).size
    }
    return Advice(
        tried.candidate,
        _averaged(sds),
        back,
        tried.speed,
        tried.angles,
        tried.lowered,
        tried.reason,
    )


def _sds(
    target: Target, at: _At, added: Observation | None = None, noise: TorqueNoise | None = None
) -> tuple[float, float]:
    """Posterior sd and the sd that recordings alone leave, with one more recording or none.

    Both come from singular values, not from squares of them, and what theory says that no
    torque tells is taken out first: rounding never makes a finite sd.
    """
    chain, observations = target.likelihood.chain, list(target.likelihood.observations)
    k = len(target.free)
    rows, known = at.rows, None
    if added is not None and noise is not None:
        more = scaled_jacobian(target, added, at.values, at.local.units, noise)
        rows = np.concatenate([rows, more])
        fixed = {
            n: float(x) for n, x in zip(chain.names, at.values, strict=True) if n not in target.free
        }
        # which scalings are open depends on the masses in all recordings together
        open_ = open_directions(chain, Knowledge(fixed), [*observations, added], at.values)
        known = open_ / at.local.units
        if not np.isfinite(rows).all():
            return float("inf"), float("inf")
    tolerance = at.local.directions.tolerance
    told = directions(rows, np.ones(k), tolerance, known_null=known)
    kept = told.rows[~told.null] * told.singular_values[~told.null, None]
    both = directions(np.concatenate([kept, at.prior]), np.ones(k), _ROUNDING)

    def left(weight: Array | None) -> float:
        return float("inf") if weight is None else float(np.sqrt(at.gradient @ weight))

    return left(both.solve(at.gradient)), left(told.solve(at.gradient))


def _averaged(sds: Sequence[tuple[float, float]]) -> Uncertainty:
    both = np.array(sds)
    sd, data_sd = np.sqrt(np.mean(both**2, axis=0))
    return Uncertainty(float(sd), float(data_sd), float(both[:, 0].min()), float(both[:, 0].max()))
