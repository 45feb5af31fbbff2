"""One posterior of all runs: what they share, what each has of its own, and where that comes from.

Parameters that vary are each run's own, ``theta_r ~ N(mu, tau^2)``; all others are shared. Noise is
each run's own besides, and held at the mean that the run alone has: a recording tells it far better
than any parameter, and sampling it would be most of all dimensions. ``mu`` has a flat prior and is
integrated in closed form: what is left of the population is ``-(R - 1) log tau - sum (theta_r -
mean)^2 / (2 tau^2)``. ``tau`` has the prior of :mod:`bayesfric.population.population`, by the sds
that runs fitted alone have, so that both ways answer one question. This way the shared parameters
are told by all runs together; it takes a sampling of many dimensions, and is for few runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from types import SimpleNamespace

import numpy as np

from bayesfric.inference.coordinates import BoundedCoordinates
from bayesfric.inference.discrepancy import Discrepancy
from bayesfric.inference.posterior import Posterior
from bayesfric.inference.prior.priors import JointPrior, read_prior
from bayesfric.inference.sampling.start import Start
from bayesfric.inference.target import LogPosterior, Target
from bayesfric.population.population import Varying, interval
from bayesfric.recordings.arrays import Array

# Draws of runs that starts are made from; and share of the overall scatter that a spread is near
# at least.
_DRAWS, _NEAR = 2000, 0.3
# Stream of the seed that they are drawn from; and what no spread comes near.
_STARTS, _WIDEST = 15, 1e100


class JointTarget(LogPosterior):
    """The log-posterior, as :func:`bayesfric.inference.sampling.sampling.sample` sees a target.

    Parameters
    ----------
    targets
        Of each run alone, of one joint with the same priors.
    recordings
        Their names.
    varying
        Names of parameters that are each run's own.
    posteriors
        Of each run alone: they shape coordinates, starts and the prior of the spreads.
    seed
        Of the draws that starts are made from.
    """

    def __init__(
        self,
        targets: Sequence[Target],
        recordings: Sequence[str],
        varying: Sequence[str],
        posteriors: Sequence[Posterior],
        seed: int,
    ) -> None:
        first = targets[0]
        self.targets = list(targets)
        shared = [name for name in first.free if name not in varying]
        priors = dict(zip(first.names, first.priors, strict=True))
        # shown nowhere: the density has a prior of its own
        flat = {"distribution": "uniform", "loc": 0.0, "scale": _WIDEST}
        told = {name: priors[name] for name in shared}
        for run in recordings:
            told |= {f"{name}.{run}": priors[name] for name in varying}
        for name in varying:
            told[f"{name}.spread"] = read_prior(name, flat, lower=0.0, upper=np.inf)
        self.names, self.priors = tuple(told), tuple(told.values())
        self.dimension = len(self.names)
        at = {name: j for j, name in enumerate(self.names)}
        self._places = [
            np.array([at[n] if n in shared else at[f"{n}.{run}"] for n in first.free])
            for run in recordings
        ]
        self._own = np.array([[at[f"{n}.{run}"] for run in recordings] for n in varying])  # (., R)
        self._spreads = np.array([at[f"{name}.spread"] for name in varying])
        # priors that count: the population is that of what varies
        apart = {*self._spreads.tolist(), *self._own.ravel().tolist()}
        self._counted = [j for j in range(self.dimension) if j not in apart]
        self._joint_prior = JointPrior([self.priors[j] for j in self._counted])
        free = len(first.free)
        self._noise = [p.flat()[:, free:].mean(axis=0) for p in posteriors]
        own = [first.names.index(name) for name in varying]
        self._sds = np.array([p.flat()[:, own].std(axis=0) for p in posteriors]).T  # (varying, R)
        draws = self._begin(posteriors, np.random.default_rng([seed, _STARTS]))
        self.coordinates = BoundedCoordinates(
            [p.lower for p in self.priors],
            [p.upper if p.upper < _WIDEST else np.inf for p in self.priors],
            draws.std(axis=0),
        )
        self.to_linear, self.from_linear = self.coordinates.to_linear, self.coordinates.from_linear
        self.likelihood = SimpleNamespace(
            fast=all(t.likelihood.fast for t in targets), method="input-error"
        )
        self.not_finite = 0
        u = self.coordinates.from_parameters(draws)
        self.start = Start(u.mean(axis=0), np.cov(u.T))

    def _begin(self, posteriors: Sequence[Posterior], rng: np.random.Generator) -> Array:
        """Make parameters about as spread as the posterior, from those of runs alone."""
        out = np.empty((_DRAWS, self.dimension))
        weights = np.zeros(self.dimension)
        total = np.zeros((_DRAWS, self.dimension))
        for places, posterior in zip(self._places, posteriors, strict=True):
            flat = posterior.flat()
            x = flat[rng.integers(len(flat), size=_DRAWS), : places.size]
            weight = 1.0 / x.var(axis=0)
            total[:, places] += weight * x
            weights[places] += weight
        kept = weights > 0.0
        # of what is shared the precisions add, and so do the draws, by them
        out[:, kept] = total[:, kept] / weights[kept]
        for k, places in zip(self._spreads, self._own, strict=True):
            apart = out[:, places].std(axis=1, ddof=1)
            least = _NEAR * self._sds[k - self._spreads[0]].min()
            count = len(places) - 1
            out[:, k] = np.hypot(apart, least) * np.sqrt(count / rng.chisquare(count, _DRAWS))
        return out

    def to_parameters(self, u: Array) -> tuple[Array, Array]:
        """Map coordinates ``(n, d)`` to parameters and the log Jacobian ``(n,)``."""
        return self.coordinates.to_parameters(u)

    def precomputed(self, u: Array) -> JointTarget:
        """Make the same target, every run's likelihood cheaper near coordinates ``(n, d)``."""
        parameters, slope = self.to_parameters(u)
        parameters = parameters[np.isfinite(slope)]
        out = copy(self)
        out.targets = [
            target.precomputed(target.from_parameters(own))
            for target, own in zip(self.targets, self._of_runs(parameters), strict=True)
        ]
        return out

    def log_prior(self, parameters: Array) -> Array:
        """Log prior density of parameters ``(n, d)``; that of a mean is flat."""
        x = parameters
        out = self._joint_prior.log_density(x[:, self._counted])
        for k, places, sds in zip(self._spreads, self._own, self._sds, strict=True):
            tau, theta = x[:, k], x[:, places]
            apart = ((theta - theta.mean(axis=1, keepdims=True)) ** 2).sum(axis=1)
            out -= (len(places) - 1) * np.log(tau) + 0.5 * apart / tau**2
            variance = sds**2 + tau[:, None] ** 2
            out += np.log(tau) + 0.5 * np.log((1.0 / variance**2).sum(axis=1))
        return out

    def log_likelihood(self, parameters: Array) -> Array:
        """Log-likelihood of parameters ``(n, d)``: runs know nothing of each other."""
        found = np.zeros(len(parameters))
        for target, own in zip(self.targets, self._of_runs(parameters), strict=True):
            found += target.log_likelihood(own)
        return found

    def _of_runs(self, parameters: Array) -> Iterator[Array]:
        """Give each run's own parameters, noise included, of ``(n, d)``."""
        for places, noise in zip(self._places, self._noise, strict=True):
            yield np.column_stack([parameters[:, places], np.tile(noise, (len(parameters), 1))])

    def widened(self, posterior: Posterior, rooms: Sequence[Discrepancy]) -> Array:
        """Move draws of the posterior ``(n, d)`` by as much as the recordings' models may be off.

        What one lacks all may lack: the part of it that may be there or not is so in all of them,
        and what does not average out over recordings is not counted as if it did.
        """
        flat = posterior.flat()
        u, rng = self.coordinates.from_parameters(flat), np.random.default_rng([posterior.seed, 17])
        chance, sides = rng.uniform(size=(len(u), 1)), rng.standard_normal((len(u), 1))
        moved = u.copy()
        for target, run, room in zip(self.targets, self._of_runs(flat), rooms, strict=True):
            own = target.unbounded(run)[:, : room.mean.size]
            cross = np.cov(own.T, u.T)[: own.shape[1], own.shape[1] :]
            # a move of the run's own estimate as the score that makes it
            moves = room.moves(rng.integers(len(room.deviations), size=len(u)), sides)
            scores = np.linalg.solve(room.covariance, moves.T).T
            moved += np.where(chance < room.moved, scores @ cross, 0.0)
        return self.to_parameters(moved)[0]


def varying_parts(
    posterior: Posterior,
    flat: Array,
    recordings: Sequence[str],
    varying: Sequence[str],
    level: float,
) -> dict[str, Varying]:
    """Sum up what varies, of draws ``(n, d)``: population, each run, and the next one."""
    rng = np.random.default_rng(np.random.SeedSequence(posterior.seed, spawn_key=(13,)))
    found = {}
    for name in varying:
        columns = [posterior.names.index(f"{name}.{run}") for run in recordings]
        theta, tau = flat[:, columns], flat[:, posterior.names.index(f"{name}.spread")]
        error = tau / np.sqrt(len(columns))
        mean = theta.mean(axis=1) + error * rng.standard_normal(len(flat))
        following = mean + tau * rng.standard_normal(len(flat))
        found[name] = Varying(
            mean=interval(mean, level),
            spread=interval(tau, level),
            following=interval(following, level),
            runs=tuple(interval(x, level) for x in theta.T),
        )
    return found
