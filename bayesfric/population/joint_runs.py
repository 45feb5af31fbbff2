"""The joint posterior of all runs: shared parameters, and those that vary between runs.

Varying parameters are ``theta_r ~ N(mu, tau^2)``, all others shared. Each run's noise is held at
the mean of the run alone: it is far better determined than any parameter, and would be most of the
dimensions. ``mu`` has a flat prior and is integrated in closed form, which leaves ``-(R - 1) log
tau - sum (theta_r - mean)^2 / (2 tau^2)``. ``tau`` has the prior of
:mod:`bayesfric.population.population`, by the sds of runs fitted alone. All runs together determine
the shared parameters; sampling takes many dimensions, so this is for few runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.inference.coordinates import BoundedCoordinates
from bayesfric.inference.discrepancy import Discrepancy, move_within_support
from bayesfric.inference.posterior import Posterior
from bayesfric.inference.priors import joint_log_density, read_prior
from bayesfric.inference.start import Start
from bayesfric.inference.target import Target
from bayesfric.population.population import Varying, interval
from bayesfric.recordings.arrays import Array


class JointTarget(Target):
    """The log-posterior, as :func:`bayesfric.inference.sampling.sample` sees a target.

    ``posteriors`` of each run alone shape coordinates, starts and the prior of the spreads.
    """

    def __init__(
        self,
        targets: Sequence[Target],
        recordings: Sequence[str],
        varying: Sequence[str],
        posteriors: Sequence[Posterior],
        seed: int,
    ) -> None:
        first, self.targets = targets[0], list(targets)
        shared = [name for name in first.free if name not in varying]
        priors = dict(zip(first.names, first.priors, strict=True))
        # a formal prior only: log_prior has the reference prior
        flat = {"distribution": "uniform", "loc": 0.0, "scale": 1e100}
        run_priors = {name: priors[name] for name in shared}
        for run in recordings:
            run_priors |= {f"{name}.{run}": priors[name] for name in varying}
        for name in varying:
            run_priors[f"{name}.spread"] = read_prior(name, flat, lower=0.0, upper=np.inf)
        self.names, self.priors = tuple(run_priors), tuple(run_priors.values())
        self.dimension, self._shared = len(self.names), len(shared)
        index = {name: j for j, name in enumerate(self.names)}
        self._places = [
            np.array([index[n] if n in shared else index[f"{n}.{run}"] for n in first.free])
            for run in recordings
        ]
        # (varying, R) and (varying,)
        self._varying = np.array([[index[f"{n}.{run}"] for run in recordings] for n in varying])
        self._spreads = np.array([index[f"{name}.spread"] for name in varying])
        # the population is the prior of varying parameters
        self._noise = [p.flat()[:, len(first.free) :].mean(axis=0) for p in posteriors]
        columns = [first.names.index(name) for name in varying]
        self._sds = np.array([p.flat()[:, columns].std(axis=0) for p in posteriors]).T
        draws = self._first_draws(posteriors, np.random.default_rng([seed, 15]))
        widths, upper = draws.std(axis=0), np.array([p.upper for p in self.priors])
        # a spread is sampled as its logarithm
        widths[self._spreads], upper[self._spreads] = np.nan, np.inf
        self.coordinates = BoundedCoordinates([p.lower for p in self.priors], upper, widths)
        self.likelihood: Any = SimpleNamespace(
            fast=all(t.likelihood.fast for t in targets), method="input-error"
        )
        self.not_finite = 0
        u = self.coordinates.from_parameters(draws)
        self.start = Start(u.mean(axis=0), np.cov(u.T))

    def _first_draws(self, posteriors: Sequence[Posterior], rng: np.random.Generator) -> Array:
        """Draw parameters about as spread as the posterior, from posteriors of runs alone."""
        number, runs = 2000, len(posteriors)
        weights, total = np.zeros(self.dimension), np.zeros((number, self.dimension))
        for places, posterior in zip(self._places, posteriors, strict=True):
            flat = posterior.flat()
            x = flat[rng.integers(len(flat), size=number), : places.size]
            weight = 1.0 / x.var(axis=0)
            total[:, places] += weight * x
            weights[places] += weight
        # of shared parameters precisions add, and draws average by them
        out = total / np.where(weights > 0.0, weights, 1.0)
        for k, places, sds in zip(self._spreads, self._varying, self._sds, strict=True):
            # not much less than the smallest sd of a run
            scatter = np.hypot(out[:, places].std(axis=1, ddof=1), 0.3 * sds.min())
            out[:, k] = scatter * np.sqrt((runs - 1) / rng.chisquare(runs - 1, number))
        return out

    def to_parameters(self, u: Array) -> tuple[Array, Array]:
        """Map coordinates ``(n, d)`` to parameters and the log Jacobian ``(n,)``."""
        return self.coordinates.to_parameters(u)

    def precomputed(self, u: Array) -> JointTarget:
        """Make the same target with likelihoods that are fast near coordinates ``(n, d)``."""
        parameters, slope = self.to_parameters(u)
        parameters = parameters[np.isfinite(slope)]
        out = copy(self)
        out.targets = [
            target.precomputed(target.from_parameters(run_parameters))
            for target, run_parameters in zip(self.targets, self._of_runs(parameters), strict=True)
        ]
        return out

    def log_prior(self, parameters: Array) -> Array:
        """Log prior density of parameters ``(n, d)``; that of a mean is flat."""
        x = parameters
        out = joint_log_density(self.priors[: self._shared])(x[:, : self._shared])
        for k, places, sds in zip(self._spreads, self._varying, self._sds, strict=True):
            tau, theta = x[:, k], x[:, places]
            squares = ((theta - theta.mean(axis=1, keepdims=True)) ** 2).sum(axis=1)
            out -= (len(places) - 1) * np.log(tau) + 0.5 * squares / tau**2
            variance = sds**2 + tau[:, None] ** 2
            out += np.log(tau) + 0.5 * np.log((1.0 / variance**2).sum(axis=1))
        return out

    def log_likelihood(self, parameters: Array) -> Array:
        """Log-likelihood of parameters ``(n, d)``: the sum over independent runs."""
        total = np.zeros(len(parameters))
        for target, run_parameters in zip(self.targets, self._of_runs(parameters), strict=True):
            total += target.log_likelihood(run_parameters)
        return total

    def _of_runs(self, parameters: Array) -> Iterator[Array]:
        """Give each run's parameters, noise included, of ``(n, d)``."""
        for places, noise in zip(self._places, self._noise, strict=True):
            yield np.column_stack([parameters[:, places], np.tile(noise, (len(parameters), 1))])

    def widened(self, posterior: Posterior, discrepancies: Sequence[Discrepancy]) -> Array:
        """Widen draws of the posterior ``(n, d)`` by the discrepancy of the runs' models.

        A term missing in one run is missing in all, so its effect does not average out over runs.
        A pair of draw and move that ends beyond a bound is replaced by another.
        """
        flat, rng = posterior.flat(), np.random.default_rng([posterior.seed, 17])
        u, widened = self.coordinates.from_parameters(flat), flat.copy()
        # of each run what moves the estimates of all, for a move of its own
        slopes = []
        for target, run, error in zip(
            self.targets, self._of_runs(flat), discrepancies, strict=True
        ):
            coordinates = target.unbounded(run)[:, : error.mean.size]
            cross = np.cov(coordinates.T, u.T)[: coordinates.shape[1], coordinates.shape[1] :]
            slopes.append(np.linalg.solve(error.covariance, cross))

        def move(drawn: NDArray[np.intp]) -> Array:
            levels, sides = rng.uniform(size=(drawn.size, 1)), rng.standard_normal((drawn.size, 1))
            moved = u[drawn]
            for error, slope in zip(discrepancies, slopes, strict=True):
                picked = rng.integers(len(error.deviations), size=drawn.size)
                moved += np.where(levels < error.moved, error.moves(picked, sides) @ slope, 0.0)
            parameters, log_slope = self.to_parameters(moved)
            parameters[~np.isfinite(log_slope)] = np.nan
            return parameters

        move_within_support(widened, np.arange(len(u)), move, rng)
        return widened


def varying_parts(
    posterior: Posterior,
    flat: Array,
    recordings: Sequence[str],
    varying: Sequence[str],
    level: float,
) -> dict[str, Varying]:
    """Summarise varying parameters of draws ``(n, d)``: population, each run, the next one."""
    rng = np.random.default_rng(np.random.SeedSequence(posterior.seed, spawn_key=(13,)))
    parts = {}
    for name in varying:
        columns = [posterior.names.index(f"{name}.{run}") for run in recordings]
        theta, tau = flat[:, columns], flat[:, posterior.names.index(f"{name}.spread")]
        error = tau / np.sqrt(len(columns))
        mean = theta.mean(axis=1) + error * rng.standard_normal(len(flat))
        following = mean + tau * rng.standard_normal(len(flat))
        parts[name] = Varying(
            mean=interval(mean, level),
            spread=interval(tau, level),
            following=interval(following, level),
            runs=tuple(interval(x, level) for x in theta.T),
        )
    return parts
