"""Every parameter from the error of the modelled torque: the input error, section 4.2.

Bounded nonlinear least squares for any joint, with bounds, priors and several recordings. Where the
torque has the form of eq. (13), eqs. (18) and (19) give a start.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import replace
from itertools import cycle, islice
from operator import itemgetter

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import optimize
from threadpoolctl import threadpool_limits

from bayesfric.base.errors import BadInput
from bayesfric.estimates.assemble import (
    assemble,
    bounds_met,
    centred,
    open_directions,
    open_scalings,
    units_of,
)
from bayesfric.estimates.information import Information
from bayesfric.estimates.least_squares import (
    least_squares,
    sizes_at,
    starting_values,
    typical_sizes,
)
from bayesfric.estimates.point_estimate import Estimate, Estimation, Knowledge
from bayesfric.estimates.torque import (
    VariableProjection,
    filtered_torque,
    places,
    scale_known,
    torque_form,
    torque_jacobian,
)
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.scaling import Scaling, scalings
from bayesfric.recordings.arrays import Array, rms
from bayesfric.recordings.signals import Signals

# Splits of the totals to start from: load-dependent friction, and the motor's share.
_SPLITS = ((0.05, 0.5), (0.2, 0.2), (0.2, 0.5), (0.2, 0.8), (0.5, 0.3), (0.5, 0.7))
# Residuals below this share of the torque are rounding.
_ROUNDING = 1e-9
# Steps with the whole of long recordings before the lowest of a subsample's minima is taken; and
# with shapes held, where the torque is linear but for products such as rise times friction.
_FEW_STEPS = 3
# Standard deviations between a prior and the data that are a contradiction.
CONTRADICTED = 3.0


def input_error(
    joint: Joint,
    observations: Sequence[Signals],
    knowledge: Knowledge,
    options: Estimation,
    start: Mapping[str, float] | None = None,
) -> Estimate:
    """Estimate the joint's parameters from the error of the modelled torque, eq. (12).

    The search starts from the variable projection of eqs. (18) and (19) where the joint
    has that form, from splits of the least-squares totals, from random vectors, and at the shapes
    that the table of quantities gives to try; limits are kept exactly.

    Parameters
    ----------
    joint
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
    _check(joint, observations, knowledge)
    with few_threads(observations):
        problem = TorqueProblem(joint, observations, knowledge)
        minima, note = _minima(problem, options, start)
        return _estimate(*_refined(problem, minima), note)


def contradicted(
    joint: Joint,
    observations: Sequence[Signals],
    knowledge: Knowledge,
    options: Estimation,
    start: Mapping[str, float],
) -> dict[str, tuple[float, float]]:
    """List parameters whose prior contradicts an estimate from the support and fixed values alone.

    By name, that estimate's value and the distance in standard deviations of both.
    """
    support = {p.name: (p.lower, p.upper) for p in joint.parameters}
    # coefficients of signals keep theirs: an arm compares those of all joints together
    columns = {p.name for p in joint.parameters if p.row.option == "signals"}
    priors = {
        name: (*knowledge.bounds.get(name, support[name]), *knowledge.priors.get(name, (None, 0.0)))
        for name in knowledge.free(joint)
        if name not in columns
    }
    if all(bounds[:2] == support[n] and bounds[2] is None for n, bounds in priors.items()):
        return {}
    column_priors = {name: prior for name, prior in knowledge.priors.items() if name in columns}
    support_only = replace(knowledge, bounds={}, priors=column_priors)
    estimate = input_error(joint, observations, support_only, options, start)
    circular = {p.name: p.circular for p in joint.parameters}
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


# Where a search ended: half the sum of squares, and free parameters (d,).
Minimum = tuple[float, Array]


class TorqueProblem:
    """Weighted residuals of the torque, and of priors, as a function of the free parameters."""

    def __init__(self, joint: Joint, observations: Sequence[Signals], knowledge: Knowledge) -> None:
        self.chain, self.observations, self.knowledge = joint, observations, knowledge
        # names of the d free parameters, and their indices among the joint's
        self.free = knowledge.free(joint)
        self.columns = np.array([joint.names.index(name) for name in self.free], dtype=np.int64)
        self.lower, self.upper = knowledge.limits(joint)
        self.measured = np.concatenate([o.measured for o in observations])
        self.weights = np.ones(self.measured.size)
        # factor on the priors' residuals over their sds: the torque's sd; zero without priors
        self.prior_weight = 0.0
        self.totals = least_squares(joint, observations)
        # (n_parameters,) fixed values, zero elsewhere
        self.base = np.zeros(len(joint.names))
        for name, value in knowledge.fixed.items():
            self.base[joint.names.index(name)] = value
        # (n_parameters,) sizes for steps and units; any will do at zero, the torque is linear
        self.typical = np.abs(self.split(0.2, 0.5))
        self.typical[self.typical == 0.0] = 0.1
        # sum of squares that is rounding
        self.rounding = (_ROUNDING**2) * float(self.measured @ self.measured)

    def weighted(self, weights: Array, prior_weight: float = 0.0) -> TorqueProblem:
        """Give the same problem with other weights ``(n_outputs,)``, and with priors."""
        other = copy(self)
        other.weights, other.prior_weight = weights, prior_weight
        return other

    def excerpt(self) -> TorqueProblem:
        """Give the problem of subsamples of long recordings; itself where none is long."""
        subsamples = [o.excerpt() for o in self.observations]
        if sum(o.filter.n_outputs for o in subsamples) == self.measured.size:
            return self
        return TorqueProblem(self.chain, subsamples, self.knowledge)

    def split(self, mu: float, share: float) -> Array:
        """Split the totals of least squares into parameters ``(n_parameters,)``, to start from."""
        return self.chain.vector(starting_values(self.chain, self.totals, mu, share))

    def vector(self, x: Array) -> Array:
        """Give the parameters ``(n_parameters,)`` that free ones ``(d,)`` and fixed ones make."""
        values = self.base.copy()
        values[self.columns] = x
        return values

    def inside(self, values: Array) -> Array:
        """Free parameters ``(d,)`` of a vector ``(n_parameters,)``, put within their limits."""
        return self.knowledge.inside(self.chain, values[self.columns])

    def torque_error(self, x: Array) -> Array:
        """Measured minus modelled torque ``(n_outputs,)`` at free parameters ``(d,)``."""
        values = self.vector(x)[None]
        # a trial step to where the torque is not finite is not taken
        with np.errstate(invalid="ignore", over="ignore"):
            model = [filtered_torque(self.chain, o, values)[0] for o in self.observations]
        return np.asarray(self.measured - np.concatenate(model))

    def weighted_jacobian(self, x: Array) -> Array:
        """Differentiate the weighted modelled torque by the free parameters: ``(n_outputs, d)``."""
        steps = np.zeros(self.base.size)
        steps[self.columns] = 1e-6 * np.maximum(np.abs(x), self.typical[self.columns])
        full = torque_jacobian(self.chain, self.observations, self.vector(x), steps)
        return self.weights[:, None] * full[:, self.columns]

    def residual(self, x: Array) -> Array:
        """Weighted residuals ``(n_outputs + k,)`` at free parameters ``(d,)``, priors last."""
        rows, targets = self.knowledge.rows(self.chain)
        by_priors = self.prior_weight * (targets - rows @ x)
        return np.concatenate([self.weights * self.torque_error(x), by_priors])

    def jacobian(self, x: Array) -> Array:
        """Differentiate :meth:`residual`: ``(n_outputs + k, d)``."""
        rows, _ = self.knowledge.rows(self.chain)
        return -np.concatenate([self.weighted_jacobian(x), self.prior_weight * rows])

    def minimise(self, x: Array, *, held: Sequence[int] = (), steps: int = 100) -> Minimum:
        """Minimise the sum of squares from a start ``(d,)`` within the limits.

        SciPy's trust region reflects steps off the limits and ends a little inside them: what ends
        there is put exactly on its limit, unless that raises the sum of squares by more than
        rounding. ``held`` are the indices of free parameters that stay as they are.
        """
        moving = np.setdiff1d(np.arange(x.size), held)

        def point(part: Array) -> Array:
            full = x.copy()
            full[moving] = part
            return full

        def residual(part: Array) -> Array:
            return self.residual(point(part))

        def jacobian(part: Array) -> Array:
            return self.jacobian(point(part))[:, moving]

        cost = 0.5 * float(np.sum(self.residual(x) ** 2))
        if not moving.size or not np.isfinite(cost):
            return cost, x
        result = optimize.least_squares(
            residual,
            x[moving],
            jacobian,
            (self.lower[moving], self.upper[moving]),
            x_scale="jac",
            ftol=1e-12,
            xtol=1e-12,
            gtol=1e-12,
            max_nfev=steps + 1,
        )
        cost, x = float(result.cost), point(result.x)
        met = self.bounds_met(x)
        met[list(held)] = 0
        on_limits = np.where(met < 0, self.lower, np.where(met > 0, self.upper, x))
        limited = 0.5 * float(np.sum(self.residual(on_limits) ** 2))
        rise = 1e-9 * cost + 0.5 * self.rounding
        return (limited, on_limits) if limited <= cost + rise else (cost, x)

    def bounds_met(self, x: Array) -> NDArray[np.int_]:
        """Give -1 for each free parameter on its lower limit, 1 on its upper one, else 0."""
        return bounds_met(x, self.lower, self.upper, self.typical[self.columns])


@contextmanager
def few_threads(observations: Sequence[Signals], long: int = 200_000) -> Iterator[None]:
    """Keep linear algebra to one thread, and compiled kernels below ``long`` samples.

    Between many short calls the threads of the kernels and those of linear algebra wait for each
    other: on two busy cores that was measured to cost thirty times the work.
    """
    threads = numba.get_num_threads()
    if sum(o.q.size for o in observations) < long:
        numba.set_num_threads(1)
    try:
        with threadpool_limits(1, "blas"):
            yield
    finally:
        numba.set_num_threads(threads)


def _minima(
    problem: TorqueProblem, options: Estimation, start: Mapping[str, float] | None
) -> tuple[list[Minimum], str]:
    """Search from all starts without weights and priors: distinct minima, and a note on them."""
    subsample = problem.excerpt() if start is None else problem
    if start is None:
        starts, lowest, note = _starts(subsample, options)
    else:
        starts, lowest, note = [problem.inside(problem.chain.vector(start))], -math.inf, ""
    minima = []
    for x in starts:
        minima.append(subsample.minimise(x))
        if 2.0 * minima[-1][0] <= lowest:
            break
    minima.sort(key=itemgetter(0))
    least = minima[0][0]
    # sums of squares of two minima differ by more than a share of the residual variance
    variance = 2.0 * least / max(subsample.measured.size - len(subsample.free), 1)
    difference = 0.5 * (0.01 * variance + subsample.rounding)
    agreeing = sum(cost <= least + difference for cost, _ in minima)
    note = f"{agreeing} of {len(minima)} starts reached the minimum{note}"
    minima = _distinct(minima, lambda cost: cost + difference)[:3]
    if subsample is not problem:
        # a few steps decide which of them is the lowest of the whole
        refits = [problem.minimise(x, steps=_FEW_STEPS) for _, x in minima]
        minima = [problem.minimise(min(refits, key=itemgetter(0))[1])]
    return minima, note


def _distinct(minima: Sequence[Minimum], limit: Callable[[float], float]) -> list[Minimum]:
    """List minima, lowest first, whose costs are above the ``limit`` of the next lower one."""
    distinct: list[Minimum] = []
    for minimum in sorted(minima, key=itemgetter(0)):
        if not distinct or minimum[0] > limit(distinct[-1][0]):
            distinct.append(minimum)
    return distinct


def _starts(problem: TorqueProblem, options: Estimation) -> tuple[list[Array], float, str]:
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
        thetas = [form.thetas(vector)[1] for vector in vectors]
        theta1, theta2, agreeing = projection.minimise(thetas)
        # the projection covers random starts; the splits search minima that limits make
        vectors = vectors[: len(_SPLITS)]
        vectors.insert(0, form.parameters(theta1, theta2, fixed))
        if _single_pass(problem):  # without priors the projection has the lowest
            lowest = (1.0 + 1e-6) * projection.criterion(theta2) + problem.rounding
        if theta2.size:
            note = f"; of eqs. (18) and (19), {agreeing} of {len(thetas)}"
    starts = [problem.inside(vector) for vector in vectors]
    if shapes := _trial_shapes(problem):
        starts, count = _at_trial_shapes(problem, shapes, starts, rng)
        note = f", those that fitted best of {count} with shapes held at values to try"
    return starts, lowest, note


def _trial_shapes(problem: TorqueProblem) -> dict[int, Array]:
    """List the trial values of each free shape within its limits, by column."""
    joint = problem.chain
    free = [(k, joint.parameters[joint.names.index(name)]) for k, name in enumerate(problem.free)]
    shaping = [(k, p, p.row.tries) for k, p in free if p.row.tries is not None]
    if not shaping:
        return {}
    scales = typical_sizes(joint, problem.observations, problem.knowledge.fixed)
    trials = {}
    for k, p, tries in shaping:
        values = np.array(tries(sizes_at(joint, p.owner, scales)))
        trials[k] = np.unique(np.clip(values, problem.lower[k], problem.upper[k]))
    return trials


def _at_trial_shapes(
    problem: TorqueProblem,
    shapes: Mapping[int, Array],
    starts: Sequence[Array],
    rng: np.random.Generator,
    *,
    followed: int = 4,
) -> tuple[list[Array], int]:
    """Move starts ``(d,)`` to trial values of the shapes, all else to what fits best there.

    Far from its own, a shape (exponent, Stribeck velocity, time constant) has no effect at any
    value, and a search ends at a limit. Gives the lowest of these, and their number.
    """
    count = max(len(starts), *(len(values) for values in shapes.values()))
    shifted = np.stack(list(islice(cycle(starts), count)))
    for column, values in shapes.items():
        shifted[:, column] = np.resize(rng.permutation(values), count)
    ends = [problem.minimise(x, held=list(shapes), steps=_FEW_STEPS) for x in shifted]
    rounding = 0.5 * problem.rounding
    distinct = _distinct(ends, lambda cost: (1.0 + 1e-6) * cost + rounding)
    return [x for _, x in distinct[:followed]], count


def _single_pass(problem: TorqueProblem) -> bool:
    """Whether the plain sum of squares is all that is minimised: there is no second pass."""
    prior_terms = problem.knowledge.rows(problem.chain)[0].size
    return not prior_terms and len(problem.observations) == 1


def _refined(
    problem: TorqueProblem, minima: Sequence[Minimum], *, rounds: int = 8
) -> tuple[TorqueProblem, Array]:
    """Second pass, if needed: recordings weighted by their own sd, and priors.

    Gives the weighted problem and its minimum ``(d,)``.
    """
    if _single_pass(problem):
        return problem, minima[0][1]
    n, best = problem.measured.size, minima[0][1]
    several = len(problem.observations) > 1
    knows = bool(problem.knowledge.rows(problem.chain)[0].size)
    # another minimum of the first pass may be lower now
    vectors = [_toward_priors(problem, problem.vector(x)) for _, x in minima]
    starts = [problem.inside(vector) for vector in vectors]
    # sds from a fit that a noisy recording dominates are estimated again
    for _ in range(rounds if several else 1):
        error = problem.torque_error(best)
        weights = _recording_weights(problem, best, error) if several else np.ones(n)
        sd = rms(weights * error) * float(np.sqrt(n / max(n - len(problem.free), 1)))
        sd = max(sd, _ROUNDING * rms(problem.measured))
        previous, problem = problem.weights, problem.weighted(weights, sd if knows else 0.0)
        _, best = min((problem.minimise(x) for x in starts), key=itemgetter(0))
        starts = [best]
        if np.allclose(weights, previous, rtol=1e-3, atol=0.0):
            break
    return problem, best


def _recording_weights(problem: TorqueProblem, x: Array, error: Array) -> Array:
    """Give each output ``(n_outputs,)`` one over its recording's residual standard deviation.

    Times their geometric mean, so that N m stay N m. A fit takes from each recording as many
    degrees of freedom as its leverage.
    """
    counts = np.array([o.measured.size for o in problem.observations])
    borders = np.cumsum(counts)[:-1]
    scaled = problem.weighted_jacobian(x) * problem.typical[problem.columns]
    left, singular, _ = np.linalg.svd(scaled, full_matrices=False)
    leverage = (left[:, singular > 1e-9 * singular.max(initial=0.0)] ** 2).sum(axis=1)
    leverages = np.array([part.sum() for part in np.split(leverage, borders)])
    sds = np.array([rms(part) for part in np.split(error, borders)])
    sds *= np.sqrt(counts / np.maximum(counts - leverages, 1e-3 * counts))
    # residuals of a recording without noise are rounding, and must not dominate
    sds = np.maximum(sds, max(1e-3 * sds.max(), _ROUNDING * rms(problem.measured)))
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
    return float(np.exp(optimize.minimize_scalar(misfit, bounds=ends, method="bounded").x))


def _estimate(problem: TorqueProblem, x: Array, note: str) -> Estimate:
    """Make the estimate of a minimum ``(d,)``; ``note`` is on the search."""
    joint, observations, knowledge = problem.chain, problem.observations, problem.knowledge
    values = centred(joint, knowledge, observations, problem.vector(x))
    x = problem.inside(values)
    values = problem.vector(x)
    at_bound = problem.bounds_met(x)
    error, jacobian = problem.torque_error(x), problem.weighted_jacobian(x)
    # the unit of a value of zero, as on a bound, is one with an effect on the torque
    effect = np.linalg.norm(jacobian, axis=0)
    least_unit = 1e-3 * np.linalg.norm(problem.measured) / np.where(effect > 0.0, effect, np.inf)
    # parameters on a limit are among the free ones: held, they would leave those they trade off
    # against with standard deviations far too small
    information = Information(
        jacobian,
        problem.weights * error,
        np.maximum(units_of(joint, problem.free, values), least_unit),
        places=places(observations),
        known=knowledge.rows(joint)[0],
        known_null=open_directions(joint, knowledge, observations, values),
    )
    assumption = "sd: uncorrelated residuals of equal variance"
    assumption += " within each recording" if np.ptp(problem.weights) else ""
    assumption += "; sd_robust: correlated ones (HAC)"
    assumption += "; priors are independent of the data" if problem.prior_weight else ""
    if names := [name for name, bound in zip(problem.free, at_bound, strict=True) if bound]:
        assumption += f"; {', '.join(names)} on a bound: the sds of the others are those without it"
    return Estimate(
        method="input-error",
        values=assemble(joint, observations, knowledge, values, information, at_bound),
        residual_rms=rms(error),
        n_outputs=error.size,
        assumption=assumption,
        residual_unit=joint.torque_unit,
        notes=(note, *_scale_notes(problem, information)),
        point=tuple(zip(joint.names, values.tolist(), strict=True)),
    )


def _scale_notes(problem: TorqueProblem, information: Information) -> list[str]:
    """State what fixes the scale between leg and alpha, or that nothing does."""
    notes = []
    knowledge, free = problem.knowledge, np.array(problem.free)
    still_open = open_scalings(problem.chain, knowledge, problem.observations)
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


def _check(joint: Joint, observations: Sequence[Signals], knowledge: Knowledge) -> None:
    """Refuse a fit with nothing free, equal limits, or too few outputs."""
    free = knowledge.free(joint)
    where = ", ".join(o.name for o in observations)
    if not free:
        raise BadInput(where, "every parameter is fixed", "leave at least one free")
    lower, upper = knowledge.limits(joint)
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
