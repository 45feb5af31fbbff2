"""The minimisation of the input error: bounded nonlinear least squares of the torque."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from scipy import optimize
from threadpoolctl import threadpool_limits

from bayesfric.estimates.assemble import bounds_met
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.least_squares import least_squares, starting_values
from bayesfric.estimates.torque import filtered_torque, torque_jacobian
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

# Residuals below this share of the torque are rounding.
ROUNDING = 1e-9
# Relative tolerances of SciPy's search, and its most steps.
_TOLERANCE, _ITERATIONS = 1e-12, 100
# Relative rise of the sum of squares that is rounding.
_NO_RISE = 1e-9
# Samples from which on a second thread pays.
_SAMPLES = 200_000


class TorqueProblem:
    """Modelled torque as a function of the free parameters, and what is known of them."""

    def __init__(
        self, chain: Joint, observations: Sequence[Observation], knowledge: Knowledge
    ) -> None:
        self.chain, self.observations, self.knowledge = chain, observations, knowledge
        # names of the d free parameters, and their indices among the chain's
        self.free = knowledge.free(chain)
        self.columns = np.array([chain.names.index(name) for name in self.free], dtype=np.int64)
        self.lower, self.upper = knowledge.limits(chain)
        self.measured = np.concatenate([o.measured for o in observations])
        self.totals = least_squares(chain, observations)
        # (n_parameters,) fixed values, zero elsewhere
        self.base = np.zeros(len(chain.names))
        for name, value in knowledge.fixed.items():
            self.base[chain.names.index(name)] = value
        # (n_parameters,) sizes for steps and units; any will do at zero, the torque is linear
        self.typical = np.abs(self.split(0.2, 0.5))
        self.typical[self.typical == 0.0] = 0.1
        # sum of squares that is rounding
        self.rounding = (ROUNDING**2) * float(self.measured @ self.measured)

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

    def residual(self, x: Array) -> Array:
        """Measured minus modelled torque ``(n_outputs,)`` at free parameters ``(d,)``."""
        values = self.vector(x)[None]
        # a trial step to where the torque is not finite is not taken
        with np.errstate(invalid="ignore", over="ignore"):
            model = [filtered_torque(self.chain, o, values)[0] for o in self.observations]
        return np.asarray(self.measured - np.concatenate(model))

    def jacobian(self, x: Array) -> Array:
        """Differentiate the modelled torque by the free parameters: ``(n_outputs, d)``."""
        steps = np.zeros(self.base.size)
        steps[self.columns] = 1e-6 * np.maximum(np.abs(x), self.typical[self.columns])
        full = torque_jacobian(self.chain, self.observations, self.vector(x), steps)
        return full[:, self.columns]


@dataclass(frozen=True, eq=False)
class Terms:
    """What is squared and summed: weighted residuals of the torque, and of priors."""

    weights: Array  # (n_outputs,) factors on the residuals
    # (k, d) and (k,): targets - rows @ x are the priors' residuals
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


class LocalMinimum(NamedTuple):
    """Where a search ended: free parameters ``(d,)``, and the sum of squares there."""

    x: Array
    squares: float


def minimise(
    problem: TorqueProblem,
    terms: Terms,
    x: Array,
    *,
    lower: Array | None = None,
    upper: Array | None = None,
    iterations: int = _ITERATIONS,
) -> LocalMinimum:
    """Minimise the sum of squares from a start ``(d,)`` within limits; equal limits hold a value.

    SciPy's trust region reflects steps off the limits and ends a little inside them: what ends
    there is put exactly on its limit, unless that raises the sum of squares.
    """
    lower = problem.lower if lower is None else lower
    upper = problem.upper if upper is None else upper
    moving = np.flatnonzero(lower < upper)

    def point(part: Array) -> Array:
        full = x.copy()
        full[moving] = part
        return full

    def residual(part: Array) -> Array:
        return terms.residual(problem, point(part))

    def jacobian(part: Array) -> Array:
        return -terms.jacobian(problem, point(part))[:, moving]

    best = LocalMinimum(x, float(np.sum(terms.residual(problem, x) ** 2)))
    if not moving.size or not np.isfinite(best.squares):
        return best
    result = optimize.least_squares(
        residual,
        x[moving],
        jacobian,
        (lower[moving], upper[moving]),
        x_scale="jac",
        ftol=_TOLERANCE,
        xtol=_TOLERANCE,
        gtol=_TOLERANCE,
        max_nfev=iterations + 1,
    )
    best = LocalMinimum(point(result.x), 2.0 * float(result.cost))
    met = bounds_met(best.x, lower, upper, problem.typical[problem.columns])
    on_limits = np.where(met < 0, lower, np.where(met > 0, upper, best.x))
    squares = float(np.sum(terms.residual(problem, on_limits) ** 2))
    if squares <= (1.0 + _NO_RISE) * best.squares + problem.rounding:
        return LocalMinimum(on_limits, squares)
    return best


@contextmanager
def few_threads(observations: Sequence[Observation]) -> Iterator[None]:
    """Keep linear algebra to one thread, and compiled kernels while recordings are short.

    Between many short calls the threads of the kernels and those of linear algebra wait for each
    other: on two busy cores that was measured to cost thirty times the work.
    """
    threads = numba.get_num_threads()
    if sum(o.q.size for o in observations) < _SAMPLES:
        numba.set_num_threads(1)
    try:
        with threadpool_limits(1, "blas"):
            yield
    finally:
        numba.set_num_threads(threads)
