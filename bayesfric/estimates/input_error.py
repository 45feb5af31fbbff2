"""Every parameter from the error of the modelled torque: the input error, section 4.2.

For any chain, with bounds, priors and several recordings. Where the torque has the form of
eq. (13), eqs. (18) and (19) give a start.
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
from bayesfric.estimates.sizes import sizes_at, typical_sizes
from bayesfric.estimates.torque import places
from bayesfric.estimates.torque_form import scale_known, torque_form
from bayesfric.estimates.variable_projection import VariableProjection
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.scaling import Scaling, scalings
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

Bounds = NDArray[np.int_]

# Splits of the totals to start from: load-dependent friction, and the motor's share.
_SPLITS = ((0.05, 0.5), (0.2, 0.2), (0.2, 0.5), (0.2, 0.8), (0.5, 0.3), (0.5, 0.7))
# Residual variances between the sums of squares of two minima that differ.
_SAME = 0.01
# Minima of the first pass that the second starts from.
_MINIMA = 3
# Steps with the whole of long recordings before the lowest of a subsample's minima is taken; and
# with shapes held, where the torque is linear but for products such as rise times friction.
_STEPS = 3
# Of the starts at shapes to try, so many of the lowest are followed; sums of squares that differ
# by a smaller share than the second number are the same.
_FOLLOWED, _SAME_SHAPE = 4, 1e-6
# A search this close, relatively, to the unbounded minimum ends the searches.
_CLOSE = 1e-6
# Least effect on the torque of a unit change, as a share of it.
_LEAST_EFFECT = 1e-3
# Standard deviations between a prior and the data that are a contradiction.
CONTRADICTED = 3.0
# Rounds of reweighting, and the relative change of weights at which they are settled.
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
    """List parameters whose prior contradicts an estimate from the support and fixed values alone.

    By name, that estimate's value and the distance in standard deviations of both.
    """
    support = {p.name: (p.lower, p.upper) for p in chain.parameters}
    # coefficients of signals keep theirs: an arm compares those of all joints together
    columns = {p.name for p in chain.parameters if p.row.option == "signals"}
    priors = {
        name: (*knowledge.bounds.get(name, support[name]), *knowledge.priors.get(name, (None, 0.0)))
        for name in knowledge.free(chain)
        if name not in columns
    }
    if all(bounds[:2] == support[n] and bounds[2] is None for n, bounds in priors.items()):
        return {}
    column_priors = {name: prior for name, prior in knowledge.priors.items() if name in columns}
    support_only = replace(knowledge, bounds={}, priors=column_priors)
    estimate = input_error(chain, observations, support_only, options, start)
    circular = {p.name: p.circular for p in chain.parameters}
    far = {}
    for name, (low, high, mean, sd) in priors.items():
        value = estimate[name]
        nearest = float(np.clip(value.value, low, high)) if mean is None else mean
        distance = value.value - nearest
        if circular[name]:
            distance -= 2.0 * np.pi * round(distance / (2.0 * np.pi))
        scale = math.hypot(value.larger_sd, sd)
        if value.determined and scale > 0.0 and abs(distance) > CONTRADICTED * scale:
            far[name] = (value.value, abs(distance) / scale)
    return far


def _estimate(
    problem: TorqueProblem, options: Estimation, start: Mapping[str, float] | None
) -> Estimate:
    """Search from all starts, weigh recordings and priors, and make the estimate."""
    chain, observations = problem.chain, problem.observations
    subsample = problem.excerpt() if start is None else problem
    plain = Terms(np.ones(subsample.measured.size))
    if start is None:
        starts, lowest, note = _starts(subsample, plain, options)
    else:
        starts, lowest, note = [problem.inside(chain.vector(start))], -math.inf, ""
    minima = []
    for x in starts:
        minima.append(minimise(subsample, plain, x))
        if minima[-1].squares <= lowest:
            break
    minima.sort(key=lambda minimum: minimum.squares)
    agreement = _agreement(subsample, minima)
    if subsample is not problem:
        plain = Terms(np.ones(problem.measured.size))
        # a few steps decide which of them is the lowest of the whole
        refits = [
            minimise(problem, plain, x.x, iterations=_STEPS) for x in _distinct(subsample, minima)
        ]
        minima = [minimise(problem, plain, min(refits, key=lambda minimum: minimum.squares).x)]
    terms, x = _refined(problem, minima)
    values = fitted.centred(chain, problem.knowledge, observations, problem.vector(x))
    x = problem.inside(values)
    values = problem.vector(x)
    at_bound = fitted.bounds_met(x, problem.lower, problem.upper, problem.typical[problem.columns])
    information = _information(problem, terms, x)
    residual = problem.residual(x)
    notes = [
        agreement + note,
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
    """Make starts from variable projection, splits of the totals, random vectors, and shapes.

    Gives free parameters ``(d,)`` within the limits, the sum of squares that ends the search, and a
    note on the starts.
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
    note = ""
    if form is not None:
        projection = VariableProjection(form, problem.observations)
        projected = projection.minimise([form.thetas(vector)[1] for vector in vectors])
        # the projection covers random starts; the splits search minima that limits make
        vectors = vectors[: len(_SPLITS)]
        vectors.insert(0, form.parameters(projected.theta1, projected.theta2, fixed))
        if _single_pass(problem):  # without priors the projection has the lowest
            lowest = (1.0 + _CLOSE) * projection.criterion(projected.theta2) + problem.rounding
        if projected.theta2.size:
            note = f"; of eqs. (18) and (19), {projected.starts_agreeing} of {projected.starts}"
    starts = [problem.inside(vector) for vector in vectors]
    starts, count = _at_trial_shapes(problem, plain, starts, rng)
    if count:
        note = f", those that fitted best of {count} with shapes held at values to try"
    return starts, lowest, note


def _single_pass(problem: TorqueProblem) -> bool:
    """Whether the plain sum of squares is all that is minimised: there is no second pass."""
    prior_terms = problem.knowledge.rows(problem.chain)[0].size
    return not prior_terms and len(problem.observations) == 1


def _refined(problem: TorqueProblem, minima: Sequence[LocalMinimum]) -> tuple[Terms, Array]:
    """Second pass, if needed: recordings weighted by their own sd, and priors.

    Gives the minimised terms and free parameters ``(d,)``.
    """
    n = problem.measured.size
    floor = ROUNDING * _rms(problem.measured)
    several = len(problem.observations) > 1
    rows, targets = problem.knowledge.rows(problem.chain)
    terms = Terms(np.ones(n))
    best = minima[0]
    if _single_pass(problem):
        return terms, best.x
    # sds from a fit that a noisy recording dominates are estimated again
    for k in range(_ROUNDS if several else 1):
        residual = problem.residual(best.x)
        weights = _recording_weights(problem, terms, best.x, residual) if several else np.ones(n)
        sd = _rms(weights * residual) * float(np.sqrt(n / max(n - len(problem.free), 1)))
        sd = max(sd, floor)
        previous, terms = terms, Terms(weights)
        if rows.size:
            terms = replace(terms, rows=sd * rows, targets=sd * targets)
        # another minimum of the first pass may be lower now
        starts = [best.x] if k else _second_starts(problem, minima)
        best = min(
            (minimise(problem, terms, x) for x in starts), key=lambda minimum: minimum.squares
        )
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
    # a fit takes from each recording as many degrees of freedom as its leverage
    left, singular, _ = np.linalg.svd(
        terms.weights[:, None] * problem.jacobian(x) * problem.typical[problem.columns],
        full_matrices=False,
    )
    leverage = (left[:, singular > 1e-9 * singular.max(initial=0.0)] ** 2).sum(axis=1)
    leverages = np.array([part.sum() for part in np.split(leverage, borders)])
    sds = np.array([_rms(part) for part in np.split(residual, borders)])
    sds *= np.sqrt(counts / np.maximum(counts - leverages, 1e-3 * counts))
    # residuals of a recording without noise are rounding, and must not dominate
    sds = np.maximum(sds, max(1e-3 * sds.max(), ROUNDING * _rms(problem.measured)))
    return np.repeat(np.exp(np.mean(np.log(sds))) / sds, counts)


def _toward_priors(problem: TorqueProblem, values: Array) -> Array:
    """Move along the scalings, where these are free, to where the priors fit best."""
    if any(o.inputs.known_load for o in problem.observations):
        return values
    priors, fixed = problem.knowledge.priors, problem.knowledge.fixed
    for scaling in scalings(problem.chain):
        names = set(scaling.names)
        if names & set(priors) and not names & set(fixed):
            values = scaling.scaled(values, _prior_factor(scaling, values, priors))
    return values


def _prior_factor(
    scaling: Scaling, values: Array, priors: Mapping[str, tuple[float, float]]
) -> float:
    """Factor that a passive gearbox allows at which the priors fit best."""
    names = [name for name in scaling.names if name in priors]
    columns = [scaling.chain.names.index(name) for name in names]
    means, sds = np.array([priors[name] for name in names]).T

    def misfit(log_k: float) -> float:
        return float(np.sum(((scaling.scaled(values, np.exp(log_k))[columns] - means) / sds) ** 2))

    low, high = scaling.bounds(values)
    low = max(low, 1e-3 * high)
    if not low < high:
        return 1.0
    ends = (float(np.log(low)), float(np.log(high)))
    return float(np.exp(minimize_scalar(misfit, bounds=ends, method="bounded").x))


def _information(problem: TorqueProblem, terms: Terms, x: Array) -> Information:
    """Give the information on the free parameters.

    Those on a limit are among them: held, they would leave those they trade off against with
    standard deviations far too small.
    """
    residual = terms.weights * problem.residual(x)
    rows, _ = problem.knowledge.rows(problem.chain)
    jacobian = terms.weights[:, None] * problem.jacobian(x)
    # the unit of a value of zero, as on a bound, is one with an effect on the torque
    effect = np.linalg.norm(jacobian, axis=0)
    least_unit = (
        _LEAST_EFFECT * np.linalg.norm(problem.measured) / np.where(effect > 0.0, effect, np.inf)
    )
    units = fitted.units_of(problem.chain, problem.free, problem.vector(x))
    return Information(
        jacobian,
        residual,
        np.maximum(units, least_unit),
        places=places(problem.observations),
        known=rows,
        known_null=fitted.open_directions(
            problem.chain, problem.knowledge, problem.observations, problem.vector(x)
        ),
    )


def _least_difference(problem: TorqueProblem, minima: Sequence[LocalMinimum]) -> float:
    """Least difference of the sums of squares of two distinct minima."""
    variance = minima[0].squares / max(problem.measured.size - len(problem.free), 1)
    return _SAME * variance + problem.rounding


def _distinct(problem: TorqueProblem, minima: Sequence[LocalMinimum]) -> list[LocalMinimum]:
    """List the lowest distinct minima, lowest first."""
    difference = _least_difference(problem, minima)
    distinct: list[LocalMinimum] = []
    for minimum in minima:
        if not distinct or minimum.squares > distinct[-1].squares + difference:
            distinct.append(minimum)
    return distinct[:_MINIMA]


def _second_starts(problem: TorqueProblem, minima: Sequence[LocalMinimum]) -> list[Array]:
    """Give the lowest distinct minima, moved to where the priors fit best."""
    distinct = _distinct(problem, minima)
    vectors = [_toward_priors(problem, problem.vector(minimum.x)) for minimum in distinct]
    return [problem.inside(vector) for vector in vectors]


def _agreement(problem: TorqueProblem, minima: Sequence[LocalMinimum]) -> str:
    limit = minima[0].squares + _least_difference(problem, minima)
    return (
        f"{sum(one.squares <= limit for one in minima)} of {len(minima)} starts reached the minimum"
    )


def _scale_notes(problem: TorqueProblem, information: Information) -> list[str]:
    """State what fixes the scale between leg and alpha, or that nothing does."""
    notes = []
    knowledge, free = problem.knowledge, np.array(problem.free)
    still_open = fitted.open_scalings(problem.chain, knowledge, problem.observations)
    for scaling in scalings(problem.chain):
        scale = f"the scale between {scaling.element}.alpha and what is behind it"
        gradients = [(free == name).astype(np.float64) for name in scaling.names if name in free]
        null = all(np.isinf(information.sds(g)[0]) for g in gradients)
        if null or scaling.element in {open_scaling.element for open_scaling in still_open}:
            notes.append(f"{scale} is open: the estimate is one of a family that fits as well")
            continue
        by = [f"known {name}" for name in scaling.names if name in knowledge.fixed]
        by += [f"the prior of {name}" for name in scaling.names if name in knowledge.priors]
        loaded = any(o.inputs.known_load for o in problem.observations)
        by += ["the known load"] if loaded else []
        if by:
            notes.append(f"{scale} is fixed by {', '.join(by)}")
    return notes


def _assumption(problem: TorqueProblem, terms: Terms, at_bound: Bounds) -> str:
    """State in one sentence what the standard deviations assume."""
    text = "sd: uncorrelated residuals of equal variance"
    text += " within each recording" if np.ptp(terms.weights) else ""
    text += "; sd_robust: correlated ones (HAC)"
    text += "; priors are independent of the data" if terms.rows is not None else ""
    names = [name for name, bound in zip(problem.free, at_bound, strict=True) if bound]
    if names:
        text += f"; {', '.join(names)} on a bound: the sds of the others are those without it"
    return text


def _check(chain: Joint, observations: Sequence[Observation], knowledge: Knowledge) -> None:
    """Refuse a fit with nothing free, equal limits, or too few outputs."""
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


def _at_trial_shapes(
    problem: TorqueProblem, terms: Terms, starts: Sequence[Array], rng: np.random.Generator
) -> tuple[list[Array], int]:
    """Move starts ``(d,)`` to trial values of the shapes, all else to what fits best there.

    Far from its own, a shape (exponent, Stribeck velocity, time constant) has no effect at any
    value, and a search ends at a limit. Gives the lowest of these, and their number; no shape, 0.
    """
    shapes = _trial_shapes(problem)
    if not shapes:
        return list(starts), 0
    count = max(len(starts), *(len(values) for values in shapes.values()))
    shifted = np.stack(list(islice(cycle(starts), count)))
    for column, values in shapes.items():
        shifted[:, column] = np.resize(rng.permutation(values), count)
    held = list(shapes)
    ends: list[LocalMinimum] = []
    for x in shifted:
        lower, upper = problem.lower.copy(), problem.upper.copy()
        lower[held] = upper[held] = x[held]
        ends.append(minimise(problem, terms, x, lower=lower, upper=upper, iterations=_STEPS))
    distinct: list[LocalMinimum] = []
    for end in sorted(ends, key=lambda end: end.squares):
        if (
            not distinct
            or end.squares > (1.0 + _SAME_SHAPE) * distinct[-1].squares + problem.rounding
        ):
            distinct.append(end)
    return [end.x for end in distinct[:_FOLLOWED]], count


def _trial_shapes(problem: TorqueProblem) -> dict[int, Array]:
    """List the trial values of each free shape within its limits, by column."""
    chain = problem.chain
    free = [(k, chain.parameters[chain.names.index(name)]) for k, name in enumerate(problem.free)]
    shaping = [(k, p, p.row.tries) for k, p in free if p.row.tries is not None]
    if not shaping:
        return {}
    scales = typical_sizes(chain, problem.observations)
    trials = {}
    for k, p, tries in shaping:
        values = np.array(tries(sizes_at(chain, p.owner, scales)))
        trials[k] = np.unique(np.clip(values, problem.lower[k], problem.upper[k]))
    return trials
