"""How the input error is minimised: bounded nonlinear least squares of the torque."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numba
import numpy as np
from scipy.optimize import lsq_linear
from threadpoolctl import threadpool_limits

from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.least_squares import least_squares, starting_values
from bayesfric.estimates.torque import filtered_torque, torque_jacobian
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

# Residuals below this share of the torque are rounding.
ROUNDING = 1e-9
# A search ends where it can lower the criterion by no larger share than this.
_NO_GAIN = 1e-10
_ITERATIONS = 100
# Recordings longer than this are worth a second thread.
_SAMPLES = 200_000


class TorqueProblem:
    """Modelled torque as a function of the free parameters, and what is known of them.

    @@ATTR chain, observations: The mechanism and its recordings, prepared. | knowledge: Fixed
    values, bounds, values with a standard deviation. | free, columns: Names of the ``d`` free
    parameters, and their indices among the chain's. | lower, upper: ``(d,)`` limits. | measured:
    ``(n_outputs,)`` filtered motor torque of all recordings, N m or N. | totals: Their least
    squares. | base: ``(n_parameters,)`` fixed values, zero elsewhere. | typical:
    ``(n_parameters,)`` sizes of the parameters, for steps and units. | rounding: Sum of squares
    that is rounding.
    """

    def __init__(
        self, chain: Joint, observations: Sequence[Observation], knowledge: Knowledge
    ) -> None:
        self.chain, self.observations, self.knowledge = chain, observations, knowledge
        self.free = knowledge.free(chain)
        self.columns = np.array([chain.names.index(name) for name in self.free], dtype=np.int64)
        self.lower, self.upper = knowledge.limits(chain)
        self.measured = np.concatenate([o.measured for o in observations])
        self.totals = least_squares(chain, observations)
        self.base = np.zeros(len(chain.names))
        for name, value in knowledge.fixed.items():
            self.base[chain.names.index(name)] = value
        # what to step by where a value is zero: the torque is linear, any size will do
        self.typical = np.abs(self.split(0.2, 0.5))
        self.typical[self.typical == 0.0] = 0.1
        self.rounding = (ROUNDING**2) * float(self.measured @ self.measured)

    def excerpt(self) -> TorqueProblem:
        """Give the problem of excerpts of long recordings; the same where none is long."""
        some = [o.excerpt() for o in self.observations]
        if sum(o.filter.n_outputs for o in some) == self.measured.size:
            return self
        return TorqueProblem(self.chain, some, self.knowledge)

    def split(self, mu: float, share: float) -> Array:
        """Split the totals of least squares into parameters, to start from.

        Shapes: returns (n_parameters,).
        """
        return self.chain.vector(starting_values(self.chain, self.totals, mu, share))

    def vector(self, x: Array) -> Array:
        """Give the parameters ``(n_parameters,)`` that free ones ``(d,)`` and fixed ones make."""
        values = self.base.copy()
        values[self.columns] = x
        return values

    def inside(self, values: Array) -> Array:
        """Free parameters ``(d,)`` of a vector ``(n_parameters,)``, put within their limits."""
        return self.knowledge.inside(self.chain, values[self.columns])

    def residual(self, x: Array) -> Array:
        """Measured minus modelled torque of free parameters ``(d,)``: ``(n_outputs,)``, N m or N.

        Not finite where the model has no torque.
        """
        values = self.vector(x)[None]
        # a trial step may lead to where the torque is no number, and is not taken then
        with np.errstate(invalid="ignore", over="ignore"):
            model = [filtered_torque(self.chain, o, values)[0] for o in self.observations]
        return np.asarray(self.measured - np.concatenate(model))

    def jacobian(self, x: Array) -> Array:
        """Differentiate the modelled torque by the free parameters ``(d,)``: ``(n_outputs, d)``.

        Central differences, exact up to rounding in what the torque is linear in.
        """
        steps = np.zeros(self.base.size)
        steps[self.columns] = 1e-6 * np.maximum(np.abs(x), self.typical[self.columns])
        full = torque_jacobian(self.chain, self.observations, self.vector(x), steps)
        return full[:, self.columns]


@dataclass(frozen=True, eq=False)
class Terms:
    """What is squared and summed up: weighted residuals, and values that are known besides."""

    weights: Array  # (n_outputs,) factors on the residuals
    # (k, d) and (k,): targets - rows @ x are further residuals; none if left out
    rows: Array | None = None
    targets: Array | None = None

    def residual(self, problem: TorqueProblem, x: Array) -> Array:
        """Weighted residuals ``(n_outputs + k,)`` at free parameters ``(d,)``, those known last."""
        residual = self.weights * problem.residual(x)
        if self.rows is None or self.targets is None:
            return residual
        return np.concatenate([residual, self.targets - self.rows @ x])

    def jacobian(self, problem: TorqueProblem, x: Array) -> Array:
        """Jacobian ``(n_outputs + k, d)`` of the model: minus that of :meth:`residual`."""
        jacobian = self.weights[:, None] * problem.jacobian(x)
        return jacobian if self.rows is None else np.concatenate([jacobian, self.rows])


@dataclass(frozen=True, eq=False)
class Found:
    """Where a search ended."""

    x: Array  # (d,) free parameters
    height: float  # Sum of squares there


def descend(
    problem: TorqueProblem,
    terms: Terms,
    x: Array,
    *,
    lower: Array | None = None,
    upper: Array | None = None,
    iterations: int = _ITERATIONS,
) -> Found:
    """Search downhill (Levenberg-Marquardt with exact limits).

    Every step solves the linear problem within the limits, so what a limit stops stands on it to
    the last digit. Damping follows the gain over the predicted one (Nielsen's rule). The search
    ends where neither the last step nor the linear problem lowers the sum of squares by a share of
    1e-10.

    Shapes: x (d,); lower, upper (d,) each.
    """
    lower = problem.lower if lower is None else lower
    upper = problem.upper if upper is None else upper
    residual = terms.residual(problem, x)
    height = float(np.sum(residual**2))
    damping, raised = 1e-3, 2.0
    for _ in range(iterations):
        triangle, target, size = _packed(terms.jacobian(problem, x), residual)
        size = np.where(np.isfinite(size), size, problem.typical[problem.columns])
        while True:
            step = bounded_step(
                np.concatenate([triangle, np.sqrt(damping) * np.eye(x.size)]),
                np.concatenate([target, np.zeros(x.size)]),
                (lower - x) / size,
                (upper - x) / size,
            )
            moved = np.clip(x + size * step, lower, upper)
            # what ends at a limit up to rounding is put exactly there
            moved = np.where(size * step <= lower - x, lower, moved)
            moved = np.where(size * step >= upper - x, upper, moved)
            after = terms.residual(problem, moved)
            lowered = float(np.sum(after**2))
            expected = float(target @ target - np.sum((target - triangle @ step) ** 2))
            if lowered < height:
                break
            if expected <= _NO_GAIN * height or damping > 1e12:
                return Found(x, height)
            damping, raised = damping * raised, 2.0 * raised
        gain = height - lowered
        # Nielsen's rule: the better the linear picture held, the less damping
        damping *= max(1.0 / 10.0, 1.0 - (2.0 * gain / max(expected, gain / 2.0) - 1.0) ** 3)
        damping, raised = max(damping, 1e-15), 2.0
        x, residual, height = moved, after, lowered
        if max(gain, expected) <= _NO_GAIN * height or height <= 1e-12 * problem.rounding:
            break
    return Found(x, height)


def _packed(jacobian: Array, residual: Array) -> tuple[Array, Array, Array]:
    """Shrink a linear problem to ``(d, d)``, in units ``(d,)`` that change the residual by one.

    From the eigenvectors of ``J'J``: the QR of many rows is more exact, but its threads wait for
    each other on a busy machine, and a search only needs a direction. The unit of what does not
    show is infinite.
    """
    norms = np.linalg.norm(jacobian, axis=0)
    with np.errstate(divide="ignore"):
        size = 1.0 / norms
    size = np.where(norms > 1e-14 * norms.max(initial=1e-300), size, np.inf)
    unit = jacobian * np.where(np.isfinite(size), size, 0.0)
    values, vectors = np.linalg.eigh(unit.T @ unit)
    told = values > 1e-14 * values.max(initial=0.0)
    roots = np.where(told, np.sqrt(np.where(told, values, 1.0)), 0.0)
    slope = vectors.T @ (unit.T @ residual)
    target = np.where(told, slope / np.where(told, roots, 1.0), 0.0)
    return roots[:, None] * vectors.T, target, size


def bounded_step(
    matrix: Array,
    target: Array,
    lower: Array,
    upper: Array,
    *,
    room: float = 1e-300,
    tol: float = 1e-14,
) -> Array:
    """Solve a linear least-squares problem within limits.

    Shapes: matrix, target (n, d) each; lower, upper (d,) each; returns (d,). Stark and Parker,
    Bounded-variable least squares, Computational Statistics 10, 1995.
    """
    step = np.linalg.lstsq(matrix, target, rcond=None)[0]
    if np.all(step >= lower) and np.all(step <= upper):
        return np.asarray(step)
    # a limit met twice (lower = upper) would be refused
    wide = np.maximum(upper, lower + room)
    found = lsq_linear(matrix, target, (lower, wide), method="bvls", tol=tol)
    return np.asarray(found.x)


@contextmanager
def few_threads(observations: Sequence[Observation]) -> Iterator[None]:
    """Keep linear algebra to one thread, and compiled kernels while recordings are short.

    Between many short calls the threads of the kernels and those of linear algebra wait for each
    other: on two busy cores that was measured to cost thirty times the work.
    """
    before = numba.get_num_threads()
    if sum(o.q.size for o in observations) < _SAMPLES:
        numba.set_num_threads(1)
    try:
        with threadpool_limits(1, "blas"):
            yield
    finally:
        numba.set_num_threads(before)
