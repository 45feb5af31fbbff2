"""Which parameters make the modelled torque nearest the measured one: the input error, section 4.2.

For any chain. Where the torque has the form of eq. (13), eqs. (18) and (19) give a start; the
search itself knows bounds, several recordings, and values known with a standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle, islice

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from bayesfric.base.errors import BadInput
from bayesfric.estimates import assemble as fitted
from bayesfric.estimates.descent import (
    ROUNDING,
    LocalMinimum,
    Terms,
    TorqueProblem,
    few_threads,
    minimise,
)
from bayesfric.estimates.information import Information
from bayesfric.estimates.knowledge import Estimation, Knowledge
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.estimates.sizes import measured_scales, sizes_at
from bayesfric.estimates.torque import places
from bayesfric.estimates.torque_form import scale_known, torque_form
from bayesfric.estimates.variable_projection import VariableProjection
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.scaling import Scaling, scalings
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

Bounds = NDArray[np.int_]

# Splits of the totals to start from: load loss, and the share the motor gets.
_SPLITS = ((0.05, 0.5), (0.2, 0.2), (0.2, 0.5), (0.2, 0.8), (0.5, 0.3), (0.5, 0.7))
# A minimum this many residual variances higher is another one.
_SAME = 0.01
# Minima of the first pass that the second looks at again.
_MINIMA = 3
# Steps downhill by the whole of long recordings before the lowest of an excerpt's minima is taken.
_STEPS = 3
# Of the starts at shapes to try, so many of the lowest are followed; sums of squares that differ
# by a smaller share than the second number are the same.
_FOLLOWED, _SAME_SHAPE = 4, 1e-6
# Share of the lowest criterion of all by which what is known may raise it, and none is lower.
_REACHED = 1e-6
# Share of the torque that counts as a change of one, at least.
_SHOWN = 1e-3
# Standard deviations between a prior and what the data say alone that are no chance.
CONTRADICTED = 3.0
# How often the sds behind weights are taken anew, and when they stand still.
_ROUNDS = 8
_SETTLED = 1e-3


def input_error(
    chain: Joint,
    observations: Sequence[Observation],
    knowledge: Knowledge,
    options: Estimation,
    start: Mapping[str, float] | None = None,
) -> Estimate:
    """Estimate the chain's parameters from the error of the modelled torque, eq. (12).

    The search starts from the variable projection of eqs. (18) and (19) where the chain
    has that form, from splits of the least-squares totals, from random vectors, and at the shapes
    that the table of quantities gives to try; limits are kept exactly.

    Parameters
    ----------
    chain
        The mechanism.
    observations
        Its recordings, prepared; each is weighed by its own residuals' standard deviation.
    knowledge
        Fixed values, bounds, and values with a standard deviation, one more residual each.
    options
        Number and seed of the random starts.
    start
        Values of all parameters to begin at, and nowhere else.

    Returns
    -------
    Estimate
        With a value for every parameter. What the data leave open has an infinite standard
        deviation; what stands on a limit has none.

    Raises
    ------
    BadInput
        If nothing is free, limits exclude each other, or there are not more outputs than
        free parameters.

    Notes
    -----
    Minimises ``sum_r |y_r - f_r(theta)|²/s_r² + sum_k ((theta_k - m_k)/s_k)²`` with the filtered
    torque ``y_r`` of each recording; ``s_r`` is taken from the residuals and the fit repeated until
    it settles. Where no scale between leg and alpha is known, the estimate is moved to the middle
    of what a passive gearbox allows (section 4.2), and says so in its notes.
    """
    _check(chain, observations, knowledge)
    with few_threads(observations):
        return _estimate(TorqueProblem(chain, observations, knowledge), options, start)


def contradicted(
    chain: Joint,
    observations: Sequence[Observation],
    knowledge: Knowledge,
    options: Estimation,
    start: Mapping[str, float],
) -> dict[str, tuple[float, float]]:
    """Compare priors with an estimate that only has the support and what is fixed."""
    support = {p.name: (p.lower, p.upper) for p in chain.parameters}
    # how wide those of a column's coefficient must be, an arm asks all its joints together
    columns = {p.name for p in chain.parameters if p.row.option == "signals"}
    priors = {
        name: (*knowledge.bounds.get(name, support[name]), *knowledge.priors.get(name, (None, 0.0)))
        for name in knowledge.free(chain)
        if name not in columns
    }
    if all(known[:2] == support[n] and known[2] is None for n, known in priors.items()):
        return {}
    kept = {name: told for name, told in knowledge.priors.items() if name in columns}
    alone = replace(knowledge, bounds={}, priors=kept)
    estimate = input_error(chain, observations, alone, options, start)
    circular = {p.name: p.circular for p in chain.parameters}
    far = {}
    for name, (low, high, mean, sd) in priors.items():
        value = estimate[name]
        nearest = float(np.clip(value.value, low, high)) if mean is None else mean
        away = value.value - nearest
        if circular[name]:
            away -= 2.0 * np.pi * round(away / (2.0 * np.pi))
        scale = math.hypot(value.larger_sd, sd)
        if value.determined and scale > 0.0 and abs(away) > CONTRADICTED * scale:
            far[name] = (value.value, abs(away) / scale)
    return far


def _estimate(
    problem: TorqueProblem, options: Estimation, start: Mapping[str, float] | None
) -> Estimate:
    """Search from all starts, weigh recordings and known values, and state what was found."""
    chain, observations = problem.chain, problem.observations
    some = problem.excerpt() if start is None else problem
    plain = Terms(np.ones(some.measured.size))
    if start is None:
        inside, lowest, searched = _starts(some, plain, options)
    else:
        inside, lowest, searched = [problem.inside(chain.vector(start))], -math.inf, ""
    found = []
    for x in inside:
        found.append(minimise(some, plain, x))
        if found[-1].squares <= lowest:
            break
    found.sort(key=lambda one: one.squares)
    agreement = _agreement(some, found)
    if some is not problem:
        plain = Terms(np.ones(problem.measured.size))
        # a few steps tell which of them is the lowest of the whole
        begun = [minimise(problem, plain, x.x, iterations=_STEPS) for x in _distinct(some, found)]
        found = [minimise(problem, plain, min(begun, key=lambda one: one.squares).x)]
    terms, x = _refined(problem, found)
    values = fitted.centred(chain, problem.knowledge, observations, problem.vector(x))
    x = problem.inside(values)
    values = problem.vector(x)
    at_bound = fitted.bounds_met(x, problem.lower, problem.upper, problem.typical[problem.columns])
    information = _information(problem, terms, x)
    residual = problem.residual(x)
    notes = [
        agreement + searched,
        *_scale_notes(problem, information),
    ]
    return Estimate(
        method="input-error",
        values=fitted.assemble(
            chain, observations, problem.knowledge, values, information, at_bound
        ),
        residual_rms=float(np.sqrt(np.mean(residual**2))),
        n_outputs=residual.size,
        assumption=_assumption(problem, terms, at_bound),
        residual_unit="N m" if chain.motor_motion == "rotary" else "N",
        notes=tuple(notes),
        point=tuple(zip(chain.names, values.tolist(), strict=True)),
    )


def _starts(
    problem: TorqueProblem, plain: Terms, options: Estimation
) -> tuple[list[Array], float, str]:
    """Make starts of the variable projection, splits of the totals, random vectors, and shapes.

    Gives free parameters ``(d,)`` each within the limits, a height below which no other start can
    come, and a note of how they were found.
    """
    lowest = -math.inf
    vectors = [problem.split(mu, share) for mu, share in _SPLITS]
    rng = np.random.default_rng(options.seed)
    for _ in range(options.starts):
        vector = problem.split(rng.uniform(0.02, 0.7), rng.uniform(0.1, 0.9))
        vectors.append(vector * np.exp(0.5 * rng.standard_normal(vector.size)))
    fixed = problem.knowledge.fixed
    form = torque_form(problem.chain, problem.observations)
    vectors = [scale_known(problem.chain, vector, fixed) for vector in vectors]
    searched = ""
    if form is not None:
        projection = VariableProjection(form, problem.observations)
        found = projection.minimise([form.thetas(vector)[1] for vector in vectors])
        # the projection has looked everywhere; the splits look for minima that limits make
        vectors = vectors[: len(_SPLITS)]
        vectors.insert(0, form.parameters(found.theta1, found.theta2, fixed))
        if _alone(problem):  # where nothing known is in the way, the projection has the lowest
            lowest = (1.0 + _REACHED) * projection.criterion(found.theta2) + problem.rounding
        if found.theta2.size:
            searched = f"; of eqs. (18) and (19), {found.starts_agreeing} of {found.starts}"
    inside = [problem.inside(vector) for vector in vectors]
    inside, tried = at_tried_shapes(problem, plain, inside, rng)
    if tried:
        searched = f", those that fitted best of {tried} with shapes held at values to try"
    return inside, lowest, searched


def _alone(problem: TorqueProblem) -> bool:
    """Whether the plain sum of squares is all that is minimised: there is no second pass."""
    told = problem.knowledge.rows(problem.chain)[0].size
    return not told and len(problem.observations) == 1


def _refined(problem: TorqueProblem, found: Sequence[LocalMinimum]) -> tuple[Terms, Array]:
    """Second pass: recordings by their own sd, and known values; none if there is neither.

    Gives the terms that were minimised, and free parameters ``(d,)``.
    """
    n = problem.measured.size
    floor = ROUNDING * _rms(problem.measured)
    several = len(problem.observations) > 1
    rows, targets = problem.knowledge.rows(problem.chain)
    terms = Terms(np.ones(n))
    best = found[0]
    if _alone(problem):
        return terms, best.x
    # sds from a fit that a noisy recording has bent are taken again
    for again in range(_ROUNDS if several else 1):
        residual = problem.residual(best.x)
        weights = _recording_weights(problem, terms, best.x, residual) if several else np.ones(n)
        sd = _rms(weights * residual) * float(np.sqrt(n / max(n - len(problem.free), 1)))
        sd = max(sd, floor)
        previous, terms = terms, Terms(weights)
        if rows.size:
            terms = replace(terms, rows=sd * rows, targets=sd * targets)
        # another minimum of the first pass may be the lower one now
        begin = [best.x] if again else _apart(problem, found)
        best = min((minimise(problem, terms, x) for x in begin), key=lambda one: one.squares)
        if np.allclose(weights, previous.weights, rtol=_SETTLED, atol=0.0):
            break
    return terms, best.x


def _rms(residual: Array) -> float:
    return float(np.sqrt(np.mean(residual**2)))


def _recording_weights(problem: TorqueProblem, terms: Terms, x: Array, residual: Array) -> Array:
    """Give each output ``(n_outputs,)`` one over its recording's residual standard deviation.

    Times their geometric mean, so that N m stay N m. Degrees of freedom are shared out by leverage.
    """
    counts = np.array([o.measured.size for o in problem.observations])
    borders = np.cumsum(counts)[:-1]
    # a fit takes from each recording as many degrees of freedom as it leans on it
    left, singular, _ = np.linalg.svd(
        terms.weights[:, None] * problem.jacobian(x) * problem.typical[problem.columns],
        full_matrices=False,
    )
    leaning = (left[:, singular > 1e-9 * singular.max(initial=0.0)] ** 2).sum(axis=1)
    leant = np.array([part.sum() for part in np.split(leaning, borders)])
    sds = np.array([_rms(part) for part in np.split(residual, borders)])
    sds *= np.sqrt(counts / np.maximum(counts - leant, 1e-3 * counts))
    # a recording without noise has rounding for residuals, not a thousandfold say
    sds = np.maximum(sds, max(1e-3 * sds.max(), ROUNDING * _rms(problem.measured)))
    return np.repeat(np.exp(np.mean(np.log(sds))) / sds, counts)


def _toward_told(problem: TorqueProblem, values: Array) -> Array:
    """Move along the scalings, where these are free, to where values with an sd fit best."""
    if any(o.inputs.known_load for o in problem.observations):
        return values
    told, fixed = problem.knowledge.priors, problem.knowledge.fixed
    for scaling in scalings(problem.chain):
        names = set(scaling.names)
        if names & set(told) and not names & set(fixed):
            values = scaling.scaled(values, _told_factor(scaling, values, told))
    return values


def _told_factor(scaling: Scaling, values: Array, told: Mapping[str, tuple[float, float]]) -> float:
    """Factor that a passive gearbox allows at which values with an sd fit best."""
    shown = [name for name in scaling.names if name in told]
    columns = [scaling.chain.names.index(name) for name in shown]
    means, sds = np.array([told[name] for name in shown]).T

    def misfit(log_k: float) -> float:
        return float(np.sum(((scaling.scaled(values, np.exp(log_k))[columns] - means) / sds) ** 2))

    low, high = scaling.bounds(values)
    low = max(low, 1e-3 * high)
    if not low < high:
        return 1.0
    ends = (float(np.log(low)), float(np.log(high)))
    return float(np.exp(minimize_scalar(misfit, bounds=ends, method="bounded").x))


def _information(problem: TorqueProblem, terms: Terms, x: Array) -> Information:
    """Say what determines the free parameters.

    Those on a limit are among them: taking such a value for known would leave what it
    trades off against with a standard deviation far too small.
    """
    residual = terms.weights * problem.residual(x)
    rows, _ = problem.knowledge.rows(problem.chain)
    jacobian = terms.weights[:, None] * problem.jacobian(x)
    # of what is zero, as on a bound: what shows in the torque
    shown = np.linalg.norm(jacobian, axis=0)
    least = _SHOWN * np.linalg.norm(problem.measured) / np.where(shown > 0.0, shown, np.inf)
    units = fitted.units_of(problem.chain, problem.free, problem.vector(x))
    return Information(
        jacobian,
        residual,
        np.maximum(units, least),
        places=places(problem.observations),
        known=rows,
        known_null=fitted.open_directions(
            problem.chain, problem.knowledge, problem.observations, problem.vector(x)
        ),
    )


def _width(problem: TorqueProblem, found: Sequence[LocalMinimum]) -> float:
    """By how much two minima have to differ to be two."""
    variance = found[0].squares / max(problem.measured.size - len(problem.free), 1)
    return _SAME * variance + problem.rounding


def _distinct(problem: TorqueProblem, found: Sequence[LocalMinimum]) -> list[LocalMinimum]:
    """One of each of the lowest minima, of those ``found``, lowest first."""
    width = _width(problem, found)
    apart: list[LocalMinimum] = []
    for one in found:
        if not apart or one.squares > apart[-1].squares + width:
            apart.append(one)
    return apart[:_MINIMA]


def _apart(problem: TorqueProblem, found: Sequence[LocalMinimum]) -> list[Array]:
    """One vector of each of the lowest minima, moved to where values with an sd fit best."""
    apart = _distinct(problem, found)
    vectors = [_toward_told(problem, problem.vector(one.x)) for one in apart]
    return [problem.inside(vector) for vector in vectors]


def _agreement(problem: TorqueProblem, found: Sequence[LocalMinimum]) -> str:
    limit = found[0].squares + _width(problem, found)
    return (
        f"{sum(one.squares <= limit for one in found)} of {len(found)} starts reached the minimum"
    )


def _scale_notes(problem: TorqueProblem, information: Information) -> list[str]:
    """Say what fixes the scale between leg and alpha, or that nothing does."""
    notes = []
    knowledge, free = problem.knowledge, np.array(problem.free)
    still_open = fitted.open_scalings(problem.chain, knowledge, problem.observations)
    for scaling in scalings(problem.chain):
        what = f"the scale between {scaling.element}.alpha and what is behind it"
        gradients = [(free == name).astype(np.float64) for name in scaling.names if name in free]
        unseen = all(np.isinf(information.sds(g)[0]) for g in gradients)
        if unseen or scaling.element in {one.element for one in still_open}:
            notes.append(f"{what} is open: the estimate is one of a family that fits as well")
            continue
        by = [f"known {name}" for name in scaling.names if name in knowledge.fixed]
        by += [f"told {name}" for name in scaling.names if name in knowledge.priors]
        loaded = any(o.inputs.known_load for o in problem.observations)
        by += ["the known load"] if loaded else []
        if by:
            notes.append(f"{what} is fixed by {', '.join(by)}")
    return notes


def _assumption(problem: TorqueProblem, terms: Terms, at_bound: Bounds) -> str:
    """Say in one sentence what the standard deviations take for granted."""
    text = "sd: uncorrelated residuals of equal variance"
    text += " within each recording" if np.ptp(terms.weights) else ""
    text += "; sd_robust: correlated ones (HAC)"
    text += "; told values are independent of the data" if terms.rows is not None else ""
    on = [name for name, bound in zip(problem.free, at_bound, strict=True) if bound]
    if on:
        text += f"; {', '.join(on)} on a bound: the sds of the others are those without it"
    return text


def _check(chain: Joint, observations: Sequence[Observation], knowledge: Knowledge) -> None:
    """Refuse what cannot be estimated: nothing free, no room between limits, too few outputs."""
    free = knowledge.free(chain)
    where = ", ".join(o.name for o in observations)
    if not free:
        raise BadInput(where, "every parameter is fixed", "leave at least one free")
    lower, upper = knowledge.limits(chain)
    for name, low, high in zip(free, lower, upper, strict=True):
        if not low < high:
            raise BadInput(name, f"has no room between {low:g} and {high:g}", "widen its bounds")
    outputs = sum(o.measured.size for o in observations)
    if outputs <= len(free):
        raise BadInput(
            where,
            f"{outputs} outputs cannot determine {len(free)} parameters",
            "use a longer recording, or decimate less",
        )


def at_tried_shapes(
    problem: TorqueProblem, terms: Terms, starts: Sequence[Array], rng: np.random.Generator
) -> tuple[list[Array], int]:
    """Move starts to a shape that is tried, and all else to what fits best there.

    With shapes held the torque is linear but for products such as rise times friction, so three
    steps downhill are enough to tell them apart.

    Shapes: starts (d,).
    """
    shapes = _tried(problem)
    if not shapes:
        return list(starts), 0
    count = max(len(starts), *(len(tried) for tried in shapes.values()))
    moved = np.stack(list(islice(cycle(starts), count)))
    for column, tried in shapes.items():
        moved[:, column] = np.resize(rng.permutation(tried), count)
    held = list(shapes)
    ends: list[LocalMinimum] = []
    for x in moved:
        lower, upper = problem.lower.copy(), problem.upper.copy()
        lower[held] = upper[held] = x[held]
        ends.append(minimise(problem, terms, x, lower=lower, upper=upper, iterations=_STEPS))
    apart: list[LocalMinimum] = []
    for one in sorted(ends, key=lambda one: one.squares):
        if not apart or one.squares > (1.0 + _SAME_SHAPE) * apart[-1].squares + problem.rounding:
            apart.append(one)
    return [one.x for one in apart[:_FOLLOWED]], count


def _tried(problem: TorqueProblem) -> dict[int, Array]:
    """Values within the limits for each free shape, by its column."""
    chain = problem.chain
    free = [(k, chain.parameters[chain.names.index(name)]) for k, name in enumerate(problem.free)]
    shaping = [(k, p, p.row.tries) for k, p in free if p.row.tries is not None]
    if not shaping:
        return {}
    scales = measured_scales(chain, problem.observations)
    found = {}
    for k, p, tries in shaping:
        values = np.array(tries(sizes_at(chain, p.owner, scales)))
        found[k] = np.unique(np.clip(values, problem.lower[k], problem.upper[k]))
    return found
