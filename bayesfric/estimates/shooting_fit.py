"""How the output error is minimised: bounded Gauss-Newton, initial states taken out."""

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

# Widths of finite differences, in units that change the torque (the position, the speed) by
# all of itself: measured truncation and rounding are both below 1e-7 of the derivative.
STEP = 1e-5
# How often segments are tried from their measured states again.
_AFRESH = 3
_MAX_ITERATIONS = 60
# Damping tried side by side, as factors on the last one that worked.
_DAMPINGS = (0.03, 1.0)
# Shares of the states' step tried side by side; each segment takes its best.
_SHARES = (1.0, 0.2, 0.0)
# Converged: a further step would lower the cost by less than this many variances.
_GAIN = 1e-4
# ... or can be taken for it where kinks and rounding stop the descent.
_SMALL = 1e-2


@dataclass(frozen=True, eq=False)
class Frame:
    """What stays the same while one fit descends."""

    shooting: Shooting  # The simulation, K segments with n samples
    columns: NDArray[np.int64]  # (d,) the free parameters among the chain's
    units: Array  # (d,) changes of them that change the torque by all of itself
    limits: tuple[Array, Array]  # Lower and upper, (d,) each
    scalings: tuple[Scaling, ...]  # Those that nothing known takes away (section 4.2)
    told: Array  # (k, d) rows 1/sd of what is known besides, and (k,) mean/sd of it
    targets: Array
    # Typical speed and range of the position, for the size of state steps, rad or m, SI
    speed: float
    span: float
    # How residuals count: (n,) a factor on each, and their standard deviation times that
    rows: Array
    sigma: float
    deadline: float = math.inf  # CPU time of the process, s, at which a descent ends where it is

    def tangents(self, values: Array) -> Array:
        """Directions along the scalings, orthonormal in units, ``(d, g)`` for g scalings.

        ``values`` is ``(n_parameters,)``. No simulated position changes along them, to first order.
        """
        found = np.zeros((self.columns.size, len(self.scalings)))
        for i, scaling in enumerate(self.scalings):
            found[:, i] = scaling.tangent(values)[self.columns] / self.units
        return np.asarray(np.linalg.qr(found)[0])


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a descent ended."""

    values: Array  # (n_parameters,) and (K, 2)
    states: Array
    residual: Array  # (n,) measured minus simulated position, not weighted, rad or m
    cost: float  # Sum of the weighted squares, of what is known besides too
    gain: float  # By how much a further step would lower it, in residual variances
    # Whether the last step was as small as wanted, or nothing smaller was found; not where time ran
    # out
    converged: bool


def residual_of(frame: Frame, values: Array, states: Array) -> Array:
    """Measured minus simulated position, ``(n,)``."""
    return np.asarray(frame.shooting.measured - frame.shooting.positions(values[None], states)[0])


class Linearised:
    """The problem around one point: derivatives, states taken out.

    The derivatives are blind along :meth:`Frame.tangents`.

    @@ATTR frame, values, states: What is held, ``(n_parameters,)`` and ``(K, 2)``. | central:
    Whether to take the more exact of the two kinds of differences. | elimination: Of the weighted
    residual ``(n,)``, its first column, and its derivatives ``(n, d)``. | target: ``(d + k,)``
    right-hand side of the linear problem for the parameters' step, known values last.
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
        found = frame.shooting.sensitivities(
            values, states, steps, widths, (lower, upper), central=central
        )
        jacobian = np.where(np.isfinite(found.parameters), found.parameters, 0.0)
        tangents = frame.tangents(values)
        jacobian -= (jacobian * units) @ tangents @ tangents.T / units
        by_state = np.where(np.isfinite(found.states), found.states, 0.0) * frame.rows[:, None]
        residual = frame.shooting.measured - found.positions
        weighted = np.column_stack([residual, jacobian]) * frame.rows[:, None]
        self._squares = float(np.sum(weighted[:, 0] ** 2))
        self.elimination = Elimination(frame.shooting, by_state, weighted)
        projected = self.elimination.projected
        triangle = np.asarray(
            np.linalg.qr(np.column_stack([projected[:, 1:] * units, projected[:, 0]]), mode="r")
        )
        told = frame.sigma * frame.told * units
        rest = frame.sigma * (frame.targets - frame.told @ values[columns])
        # the last row of the triangle is what no step can lower
        self._matrix = np.concatenate([triangle[:d, :d], told])
        self.target = np.concatenate([triangle[:d, d], rest])
        self._size = np.maximum(np.linalg.norm(self._matrix, axis=0), 1e-300)
        at = values[columns]
        self._box = ((frame.limits[0] - at) / units, (frame.limits[1] - at) / units)

    @property
    def gain(self) -> float:
        """By how much the full step would lower the sum of squares, states included."""
        left = self.target - self._matrix @ self.step(0.0)
        states = self._squares - np.sum(self.elimination.projected[:, 0] ** 2)
        return float(self.target @ self.target - left @ left + states)

    def step(self, damping: float) -> Array:
        """Damped step of the free parameters within their limits, ``(d,)`` in units."""
        d = self._size.size
        if d == 0:
            return np.zeros(0)
        # never quite undamped: directions that no output sees must not move
        least = 1e-9 * float(np.abs(self._matrix).max())
        extra = np.diag(np.maximum(np.sqrt(damping) * self._size, least))
        a = np.concatenate([self._matrix, extra])
        b = np.concatenate([self.target, np.zeros(d)])
        low, high = self._box
        return bounded_step(a, b, np.minimum(low, 0.0), high)

    def states(self, step: Array) -> Array:
        """Change of the states ``(K, 2)`` that goes with a step of the parameters.

        ``step`` is ``(d,)`` in units; a step of zero fits the states alone.
        """
        onto = self.elimination.onto
        return np.asarray(onto[:, :, 0] - onto[:, :, 1:] @ (step * self._frame.units))

    def positions_only(self, change: Array) -> Array:
        """Give what a change of the states ``(K, 2)`` would be if speeds stayed, ``(K, 2)``."""
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
    """Find the least cost over free parameters, within limits, and initial states.

    Levenberg and Marquardt's steps on the problem without its states. Several dampings are
    simulated side by side. Given the parameters, segments do not depend on each other, so each
    takes the share of its own states' step that suits it best. Converged where a further step would
    lower the cost by less than 1e-4 residual variances, or by less than 1e-2 where kinks and
    rounding stop it.

    Shapes: values, states (n_parameters,) each.
    """
    columns = frame.columns
    residual = residual_of(frame, values, states)
    cost = float(_segment_costs(frame, residual[None])[0].sum())
    cost += _told_cost(frame, values[columns])
    if not np.isfinite(cost):
        return Solution(values, states, residual, np.inf, np.inf, False)
    at = Solution(values, states, residual, cost, np.inf, False)
    damping = 1e-3
    for _ in range(_MAX_ITERATIONS):
        if time.process_time() >= frame.deadline:
            return at
        linear = Linearised(frame, at.values, at.states, central=False)
        freedom = max(at.residual.size - linear.elimination.lost - columns.size, 1)
        gain = linear.gain * freedom / at.cost if at.cost > 0 else 0.0
        at = replace(at, gain=gain)
        if gain < _GAIN:
            return replace(at, converged=True)
        found = None
        while found is None and damping < 1e12:
            dampings = [damping * f for f in _DAMPINGS]
            for stuck in (False, True):
                trial, worked = _try(frame, at, linear, dampings, stuck=stuck)
                if trial.cost < at.cost:
                    found, damping = trial, worked
                    break
            else:
                damping *= 1e3
        if found is None:
            return replace(at, converged=gain < _SMALL)
        fall = at.cost - found.cost
        at, damping = found, max(damping, 1e-12)
        if fall < 1e-9 * at.cost:
            return replace(at, converged=gain < _SMALL)
    return at


def settle_states(frame: Frame, values: Array, states: Array) -> Array:
    """Fit the initial states alone, the parameters held. Shapes: returns (K, 2)."""
    low, high = frame.limits
    held = replace(
        frame,
        columns=frame.columns[:0],
        units=frame.units[:0],
        limits=(low[:0], high[:0]),
        scalings=(),
        told=frame.told[:, :0],
    )
    return descend(held, values, states).states


def descend_afresh(frame: Frame, values: Array, states: Array) -> Solution:
    """Descend as :func:`descend`, and again while a segment's state has a better minimum.

    A bad start of the parameters can drive a segment's state into a minimum of its own (a
    joint that stops where the measured one passes) that no small step leaves. At the end
    each segment is tried from its measured state once more, up to three times over.
    """
    at = descend(frame, values, states)
    for _ in range(_AFRESH):
        if not np.isfinite(at.cost):
            break
        tried = settle_states(frame, at.values, frame.shooting.initial)
        residual = residual_of(frame, at.values, tried)
        old = _segment_costs(frame, at.residual[None])[0]
        new = _segment_costs(frame, residual[None])[0]
        better = new < old * (1.0 - 1e-6)
        if old[better].sum() - new[better].sum() <= 1e-6 * at.cost:
            break
        mixed = np.where(better[:, None], tried, at.states)
        at = descend(frame, at.values, mixed)
    return at


def _try(
    frame: Frame,
    solution: Solution,
    linear: Linearised,
    dampings: list[float],
    *,
    stuck: bool = False,
) -> tuple[Solution, float]:
    """Simulate the steps of several dampings; give the best, and its damping.

    Where nothing helps, ``stuck``, only positions are changed: a joint that starts next to
    rest and soon sticks hardly moves with its speed, so the full step of that is far off.
    """
    columns = frame.columns
    moves = []
    for damping in dampings:
        step = linear.step(damping)
        moves.append((damping, _moved(frame, solution.values, step), linear.states(step)))
    shares = len(_SHARES) + 1
    vectors = np.repeat(np.array([moved for _, moved, _ in moves]), shares, axis=0)
    starts = np.empty((len(moves), shares, *solution.states.shape))
    for i, (_, _, whole) in enumerate(moves):
        change = linear.positions_only(whole) if stuck else whole
        for j, share in enumerate(_SHARES):
            starts[i, j] = solution.states + share * change
        # Where a segment starts at rest, Newton's steps on its speed only ever halve it.
        starts[i, -1] = (solution.states + change) * (1.0, 0.0)
    starts = starts.reshape(-1, *solution.states.shape)
    residuals = frame.shooting.measured - frame.shooting.positions(vectors, starts)
    costs = _segment_costs(frame, residuals).reshape(len(moves), shares, -1)
    costs = np.where(np.isfinite(costs), costs, np.inf)
    choice = np.argmin(costs, axis=1)
    totals = np.take_along_axis(costs, choice[:, None], axis=1)[:, 0].sum(axis=1)
    totals += [_told_cost(frame, moved[columns]) for _, moved, _ in moves]
    best = int(np.argmin(totals))
    pick = best * shares + choice[best]
    better = replace(
        solution,
        values=moves[best][1],
        states=starts[pick, np.arange(pick.size)],
        residual=residuals[pick[frame.shooting.segment_of], np.arange(residuals.shape[1])],
        cost=float(totals[best]),
    )
    return better, moves[best][0]


def _moved(frame: Frame, values: Array, step: Array) -> Array:
    out = values.copy()
    out[frame.columns] = np.clip(values[frame.columns] + step * frame.units, *frame.limits)
    return out


def _segment_costs(frame: Frame, residuals: Array) -> Array:
    """Cost of every segment, ``(m, K)``; NaN where it cannot be simulated."""
    squares = (residuals * frame.rows) ** 2
    return np.asarray(np.add.reduceat(squares, frame.shooting.borders[:-1], axis=1))


def _told_cost(frame: Frame, at: Array) -> float:
    if not frame.targets.size:
        return 0.0
    return float(frame.sigma**2 * np.sum((frame.targets - frame.told @ at) ** 2))
