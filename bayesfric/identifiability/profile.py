"""Profile likelihoods: how well the torque can be explained at each value of one parameter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from bayesfric.estimates.assemble import bounds_met, centred
from bayesfric.estimates.descent import Terms, TorqueProblem, descend, few_threads
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.torque_form import factor_to
from bayesfric.inference.fitting import Fit
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.scaling import scalings
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]

# Half the 90 % quantile of chi-square with one degree of freedom: where an interval ends.
DROP_90 = -0.5 * float(chi2.ppf(0.9, 1))
# Rounds in which recordings get their own noise scales, and the gain that ends them.
_ROUNDS = 10
_SETTLED = 1e-5


@dataclass(frozen=True, eq=False)
class Profile:
    """Profile log-likelihood of one parameter."""

    name: str
    values: Array  # (m,) rising, in the parameter's unit
    # (m,) largest log-likelihood with the parameter held at each value, minus the largest of all:
    # zero at the best value, never positive
    drop: Array
    # for each value, which other parameters stand on a bound there; those that an open scale can be
    # moved away from do not count
    on_bound: tuple[tuple[str, ...], ...]


def profiles(fit: Fit, points: int = 15) -> tuple[Profile, ...]:
    """Profile the torque's log-likelihood along every free parameter of a fit.

    Priors enter by their supports alone. Whichever likelihood was sampled, this is the
    torque's, with white noise.

    Each has so many ``points``, evenly over the central 99 % of its posterior; a parameter whose
    draws are all equal has no profile.
    """
    target = fit.target
    ends = np.quantile(fit.posterior.flat(), [0.005, 0.5, 0.995], axis=0)
    middle = target.chain_values(ends[1][None])[0]
    known = dict(zip(fit.chain.names, middle.tolist(), strict=True))
    knowledge = Knowledge(
        fixed={name: value for name, value in known.items() if name not in target.free},
        bounds={
            name: prior.limits for name, prior in zip(target.free, target.priors, strict=False)
        },
    )
    grids = {
        name: np.linspace(ends[0, j], ends[2, j], points)
        for j, name in enumerate(target.free)
        if ends[0, j] < ends[2, j]
    }
    starts = [middle, *(fit.chain.vector(dict(e.point)) for e in fit.estimates if e.point)]
    own_noise = len(set(target.noise.places[:, 0].tolist())) > 1
    return profile_likelihoods(
        fit.chain, fit.observations, knowledge, grids, starts, own_noise=own_noise
    )


def profile_likelihoods(
    chain: Joint,
    observations: Sequence[Observation],
    knowledge: Knowledge,
    grids: Mapping[str, Array],
    starts: Sequence[Array],
    *,
    own_noise: bool = False,
) -> tuple[Profile, ...]:
    """Profile the log-likelihood of the torque, white noise of unknown scale.

    At each value of one parameter, of rising ``grids``, all others are fitted anew within their
    limits, each fit starting from its neighbour's, outwards from the best, which is looked for
    from ``starts`` ``(n_parameters,)``. The noise scale that fits best, each recording's if it has
    its ``own_noise``, is known in closed form and leaves ``-n/2 log SS``. Told values do not enter.
    """
    with few_threads(observations):
        whole = _Search(TorqueProblem(chain, observations, knowledge), own_noise)
        best = max((whole.fit(start) for start in starts), key=lambda one: one.height)
        found = {}
        for name, grid in grids.items():
            value = float(best.values[chain.names.index(name)])
            held = replace(knowledge, fixed={**knowledge.fixed, name: value})
            search = _Search(TorqueProblem(chain, observations, held), own_noise)
            found[name] = _walk(search, name, np.asarray(grid), best)
    # a profile may have come upon a better fit than the search for it
    top = max([best.height, *(p.height for points in found.values() for p in points)])
    return tuple(
        Profile(
            name,
            np.asarray(grids[name]),
            np.array([p.height - top for p in points]),
            tuple(p.on_bound for p in points),
        )
        for name, points in found.items()
    )


@dataclass(frozen=True, eq=False)
class _Point:
    """A best fit: chain's parameters, log-likelihood, and which free ones are on a bound."""

    values: Array
    height: float
    on_bound: tuple[str, ...]


class _Search:
    """The best fit with some parameters held."""

    def __init__(self, problem: TorqueProblem, own_noise: bool) -> None:
        self.problem = problem
        sizes = [o.measured.size for o in problem.observations]
        self._borders = np.cumsum(sizes)[:-1] if own_noise else np.array([], dtype=np.int64)

    def fit(self, values: Array) -> _Point:
        """Search downhill from a vector ``(n_parameters,)``."""
        problem = self.problem
        x = problem.inside(values)
        height = self.height(x)
        for _ in range(_ROUNDS if x.size else 0):
            sizes, squares = self._parts(x)
            scales = np.sqrt(squares / sizes)
            # one over the noise scale of each output, times a constant
            weights = np.repeat(scales.min() / scales, sizes)
            x = descend(problem, Terms(weights), x).x
            before, height = height, self.height(x)
            # one noise scale needs no second round
            if not self._borders.size or height - before <= _SETTLED:
                break
        found = problem.vector(x)
        # bounds that an open scale can be moved away from do not count
        moved = centred(problem.chain, problem.knowledge, problem.observations, found)
        bounds = bounds_met(moved[problem.columns], problem.lower, problem.upper)
        names = tuple(n for n, b in zip(problem.free, bounds, strict=True) if b)
        return _Point(found, height, names)

    def height(self, x: Array) -> float:
        """Log-likelihood at its best noise scales, up to a constant."""
        sizes, squares = self._parts(x)
        return float(-0.5 * sizes @ np.log(squares))

    def _parts(self, x: Array) -> tuple[NDArray[np.int64], Array]:
        """Count the outputs that share a noise scale, and sum their squares."""
        parts = np.split(self.problem.residual(x), self._borders)
        # a recording without noise has rounding for residuals
        least = max(self.problem.rounding, 1e-300)
        squares = np.array([max(float(part @ part), least) for part in parts])
        return np.array([part.size for part in parts]), squares


def _walk(search: _Search, name: str, grid: Array, best: _Point) -> list[_Point]:
    """Fit at every value of a grid, from the one nearest to the best fit to both sides."""
    chain, base = search.problem.chain, search.problem.base
    column = chain.names.index(name)
    nearest = int(np.argmin(np.abs(grid - best.values[column])))
    points: dict[int, _Point] = {}
    for order in (range(nearest, grid.size), range(nearest - 1, -1, -1)):
        before = best if order.start == nearest else points[nearest]
        for k in order:
            base[column] = grid[k]
            begin = max(
                _neighbours(chain, name, before.values, float(grid[k])),
                key=lambda values: search.height(search.problem.inside(values)),
            )
            before = points[k] = search.fit(begin)
    return [points[k] for k in range(grid.size)]


def _neighbours(chain: Joint, name: str, values: Array, value: float) -> list[Array]:
    """Start a parameter at another value: the others as they were, or scaled along with it."""
    factors = [(one, factor_to(one, values, name, value)) for one in scalings(chain)]
    return [values.copy(), *(one.scaled(values, k) for one, k in factors if k)]
