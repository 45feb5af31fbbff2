"""The minimisation of the output error: bounded Gauss-Newton, initial states eliminated."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from bayesfric.estimates.shooting import Elimination, Shooting
from bayesfric.mechanism.scaling import Scaling
from bayesfric.recordings.arrays import Array

# Relative steps of finite differences: measured, truncation and rounding are below 1e-7.
STEP = 1e-5
# Restarts of segments from their measured states.
_RESTARTS = 3
_MAX_ITERATIONS = 60
# Damping tried side by side, as factors on the last one that worked.
_DAMPINGS = (0.03, 1.0)
# Shares of the states' step tried side by side; each segment takes its best.
_SHARES = (1.0, 0.2, 0.0)
# Converged: a further step would lower the cost by less than the first, in residual variances; or
# than the second, where kinks and rounding stop the descent.
_GAIN, _SMALL = 1e-4, 1e-2


@dataclass(frozen=True, eq=False)
class Frame:
    """What a descent keeps fixed."""

    shooting: Shooting  # K segments with n samples
    columns: NDArray[np.int64]  # (d,) the free parameters among the chain's
    units: Array  # (d,) changes of them that change the torque by all of itself
    limits: tuple[Array, Array]  # Lower and upper, (d,) each
    scalings: tuple[Scaling, ...]  # those left open (section 4.2)
    prior_rows: Array  # (k, d) 1/sd of the priors
    targets: Array  # (k,) their mean/sd
    # typical speed and range of the position, for steps of states
    speed: float
    span: float
    # (n,) weights of residuals, and the sd of the weighted ones
    rows: Array
    sigma: float
    deadline: float = math.inf  # CPU time of the process, s, that ends a descent

    def tangents(self, values: Array) -> Array:
        """Directions along the scalings at a vector, orthonormal in units, ``(d, g)``."""
        tangents = np.zeros((self.columns.size, len(self.scalings)))
        for i, scaling in enumerate(self.scalings):
            tangents[:, i] = scaling.tangent(values)[self.columns] / self.units
        return np.asarray(np.linalg.qr(tangents)[0])


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a descent ended."""

    values: Array  # (n_parameters,) and (K, 2)
    states: Array
    residual: Array  # (n,) measured minus simulated position, not weighted, rad or m
    cost: float  # weighted squares, priors included
    gain: float  # By how much a further step would lower it, in residual variances
    converged: bool


def residual_of(frame: Frame, values: Array, states: Array) -> Array:
    """Measured minus simulated position, ``(n,)``."""
    return np.asarray(frame.shooting.measured - frame.shooting.positions(values[None], states)[0])


class Linearised:
    """The problem linearised at a point, states eliminated.

    Derivatives along :meth:`Frame.tangents` are zero. The columns of ``elimination`` are the
    weighted residual ``(n,)`` and its derivatives ``(n, d)``; ``target`` ``(d + k,)`` is the
    right-hand side of the linear problem for a step, priors last.
    """

    def __init__(self, frame: Frame, values: Array, states: Array, *, central: bool = True) -> None:
        self._frame = frame
        columns, units, d = frame.columns, frame.units, frame.columns.size
        steps = np.zeros(values.size)
        steps[columns] = STEP * units
        # differences by initial position and speed
        widths = STEP * frame.span, STEP * frame.speed
        lower, upper = np.full((2, values.size), [[-np.inf], [np.inf]])
        lower[columns], upper[columns] = frame.limits
        simulated = frame.shooting.sensitivities(
            values, states, steps, widths, (lower, upper), central=central
        )
        jacobian = np.where(np.isfinite(simulated.parameters), simulated.parameters, 0.0)
        tangents = frame.tangents(values)
        jacobian -= (jacobian * units) @ tangents @ tangents.T / units
        by_state = (
            np.where(np.isfinite(simulated.states), simulated.states, 0.0) * frame.rows[:, None]
        )
        residual = frame.shooting.measured - simulated.positions
        weighted = np.column_stack([residual, jacobian]) * frame.rows[:, None]
        self._squares = float(np.sum(weighted[:, 0] ** 2))
        self.elimination = Elimination(frame.shooting, by_state, weighted)
        projected = self.elimination.projected
        triangle = np.asarray(
            np.linalg.qr(np.column_stack([projected[:, 1:] * units, projected[:, 0]]), mode="r")
        )
        prior_rows = frame.sigma * frame.prior_rows * units
        prior_residual = frame.sigma * (frame.targets - frame.prior_rows @ values[columns])
        # the last row of the triangle is the part that no step lowers
        self._matrix = np.concatenate([triangle[:d, :d], prior_rows])
        self.target = np.concatenate([triangle[:d, d], prior_residual])
        self._size = np.maximum(np.linalg.norm(self._matrix, axis=0), 1e-300)
        point = values[columns]
        self._box = ((frame.limits[0] - point) / units, (frame.limits[1] - point) / units)

    @property
    def gain(self) -> float:
        """Decrease of the sum of squares by the full step, states included."""
        rest = self.target - self._matrix @ self.step(0.0)
        states = self._squares - np.sum(self.elimination.projected[:, 0] ** 2)
        return float(self.target @ self.target - rest @ rest + states)

    def step(self, damping: float) -> Array:
        """Damped step ``(d,)`` of the free parameters within their limits, in units."""
        d = self._size.size
        if d == 0:
            return np.zeros(0)
        # never quite undamped: null directions must not move
        least = 1e-9 * float(np.abs(self._matrix).max())
        extra = np.diag(np.maximum(np.sqrt(damping) * self._size, least))
        a = np.concatenate([self._matrix, extra])
        b = np.concatenate([self.target, np.zeros(d)])
        low, high = self._box
        return bounded_step(a, b, np.minimum(low, 0.0), high)

    def states(self, step: Array) -> Array:
        """Change of the states ``(K, 2)`` for a step ``(d,)`` in units of the parameters."""
        onto = self.elimination.onto
        return np.asarray(onto[:, :, 0] - onto[:, :, 1:] @ (step * self._frame.units))

    def positions_only(self, change: Array) -> Array:
        """Change of the states ``(K, 2)`` with the speeds held."""
        back = self.elimination.back
        by_speed = np.divide(
            back[:, 0, 1], back[:, 1, 1], out=np.zeros(len(back)), where=back[:, 1, 1] != 0.0
        )
        return np.column_stack([change[:, 0] - by_speed * change[:, 1], 0.0 * change[:, 1]])


def bounded_step(matrix: Array, target: Array, lower: Array, upper: Array) -> Array:
    """Solve a linear least-squares problem ``(n, d)`` within limits ``(d,)``.

    By bounded-variable least squares (Stark and Parker, Computational Statistics 10, 1995).
    """
    step = np.linalg.lstsq(matrix, target, rcond=None)[0]
    if np.all(step >= lower) and np.all(step <= upper):
        return np.asarray(step)
    # SciPy refuses equal limits
    limits = lower, np.maximum(upper, lower + 1e-12)
    return np.asarray(lsq_linear(matrix, target, limits, method="bvls", tol=1e-10).x)


def descend(frame: Frame, values: Array, states: Array) -> Solution:
    """Minimise the cost over free parameters, within limits, and initial states.

    Levenberg-Marquardt on the problem with states eliminated. Several dampings are simulated side
    by side; segments are independent given the parameters, so each takes the share of its states'
    step that suits it best.
    """
    columns = frame.columns
    residual = residual_of(frame, values, states)
    cost = float(_segment_costs(frame, residual[None])[0].sum())
    cost += _prior_cost(frame, values[columns])
    if not np.isfinite(cost):
        return Solution(values, states, residual, np.inf, np.inf, False)
    solution = Solution(values, states, residual, cost, np.inf, False)
    damping = 1e-3
    for _ in range(_MAX_ITERATIONS):
        if time.process_time() >= frame.deadline:
            return solution
        linear = Linearised(frame, solution.values, solution.states, central=False)
        freedom = max(solution.residual.size - linear.elimination.lost - columns.size, 1)
        gain = linear.gain * freedom / solution.cost if solution.cost > 0 else 0.0
        solution = replace(solution, gain=gain)
        if gain < _GAIN:
            return replace(solution, converged=True)
        better = None
        while better is None and damping < 1e12:
            dampings = [damping * f for f in _DAMPINGS]
            for stuck in (False, True):
                trial, worked = _try(frame, solution, linear, dampings, stuck=stuck)
                if trial.cost < solution.cost:
                    better, damping = trial, worked
                    break
            else:
                damping *= 1e3
        if better is None:
            return replace(solution, converged=gain < _SMALL)
        decrease = solution.cost - better.cost
        solution, damping = better, max(damping, 1e-12)
        if decrease < 1e-9 * solution.cost:
            return replace(solution, converged=gain < _SMALL)
    return solution


def settle_states(frame: Frame, values: Array, states: Array) -> Array:
    """Fit the initial states ``(K, 2)`` alone."""
    low, high = frame.limits
    held = replace(
        frame,
        columns=frame.columns[:0],
        units=frame.units[:0],
        limits=(low[:0], high[:0]),
        scalings=(),
        prior_rows=frame.prior_rows[:, :0],
    )
    return descend(held, values, states).states


def descend_afresh(frame: Frame, values: Array, states: Array) -> Solution:
    """Descend, and again while a segment has a lower minimum from its measured state.

    A bad start can drive a state into a separate minimum (a joint that stops where the measured one
    passes) that no small step leaves.
    """
    solution = descend(frame, values, states)
    for _ in range(_RESTARTS):
        if not np.isfinite(solution.cost):
            break
        settled = settle_states(frame, solution.values, frame.shooting.initial)
        residual = residual_of(frame, solution.values, settled)
        before = _segment_costs(frame, solution.residual[None])[0]
        after = _segment_costs(frame, residual[None])[0]
        better = after < before * (1.0 - 1e-6)
        if before[better].sum() - after[better].sum() <= 1e-6 * solution.cost:
            break
        mixed = np.where(better[:, None], settled, solution.states)
        solution = descend(frame, solution.values, mixed)
    return solution


def _try(
    frame: Frame,
    solution: Solution,
    linear: Linearised,
    dampings: list[float],
    *,
    stuck: bool = False,
) -> tuple[Solution, float]:
    """Simulate the steps of several dampings; give the best, and its damping.

    If none helps (``stuck``), positions alone move: a joint that starts next to standstill and soon
    sticks hardly depends on its speed, so the full step in that is far off.
    """
    columns = frame.columns
    moves = []
    for damping in dampings:
        step = linear.step(damping)
        moves.append((damping, _stepped(frame, solution.values, step), linear.states(step)))
    shares = len(_SHARES) + 1
    vectors = np.repeat(np.array([vector for _, vector, _ in moves]), shares, axis=0)
    starts = np.empty((len(moves), shares, *solution.states.shape))
    for i, (_, _, full_step) in enumerate(moves):
        change = linear.positions_only(full_step) if stuck else full_step
        for j, share in enumerate(_SHARES):
            starts[i, j] = solution.states + share * change
        # where a segment starts at standstill, Newton's steps only ever halve its speed
        starts[i, -1] = (solution.states + change) * (1.0, 0.0)
    starts = starts.reshape(-1, *solution.states.shape)
    residuals = frame.shooting.measured - frame.shooting.positions(vectors, starts)
    costs = _segment_costs(frame, residuals).reshape(len(moves), shares, -1)
    costs = np.where(np.isfinite(costs), costs, np.inf)
    choice = np.argmin(costs, axis=1)
    totals = np.take_along_axis(costs, choice[:, None], axis=1)[:, 0].sum(axis=1)
    totals += [_prior_cost(frame, vector[columns]) for _, vector, _ in moves]
    best = int(np.argmin(totals))
    picks = best * shares + choice[best]
    better = replace(
        solution,
        values=moves[best][1],
        states=starts[picks, np.arange(picks.size)],
        residual=residuals[picks[frame.shooting.segment_of], np.arange(residuals.shape[1])],
        cost=float(totals[best]),
    )
    return better, moves[best][0]


def _stepped(frame: Frame, values: Array, step: Array) -> Array:
    vector = values.copy()
    vector[frame.columns] = np.clip(values[frame.columns] + step * frame.units, *frame.limits)
    return vector


def _segment_costs(frame: Frame, residuals: Array) -> Array:
    """Cost of every segment, ``(m, K)``; NaN where it cannot be simulated."""
    squares = (residuals * frame.rows) ** 2
    return np.asarray(np.add.reduceat(squares, frame.shooting.borders[:-1], axis=1))


def _prior_cost(frame: Frame, x: Array) -> float:
    if not frame.targets.size:
        return 0.0
    return float(frame.sigma**2 * np.sum((frame.targets - frame.prior_rows @ x) ** 2))
