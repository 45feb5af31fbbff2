r"""The log-posterior as the sampler sees it.

Priors are given in physical parameters :math:`\theta`, walkers move in unconstrained coordinates
:math:`u`, so the sampled density is

.. math:: \log p(u) = \log p(\theta) + \log p(y \mid \theta) + \log|\partial\theta/\partial u|
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.assemble import alpha_sign
from bayesfric.inference.closed_loop import ClosedLoopLikelihood
from bayesfric.inference.coordinates import BoundedCoordinates, choose_coordinates
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.noise import Noise
from bayesfric.inference.position_likelihood import PositionLikelihood
from bayesfric.inference.priors import Prior, joint_log_density
from bayesfric.recordings.arrays import Array, Flags

Likelihood = TorqueLikelihood | PositionLikelihood | ClosedLoopLikelihood


class Target:
    """Posterior of the mechanism's free parameters and the noise scales, in this order.

    ``priors`` include fixed parameters. ``widths`` ``(d,)`` are approximate posterior standard
    deviations, which only shape the coordinates.
    """

    def __init__(
        self,
        likelihood: Likelihood,
        priors: Mapping[str, Prior],
        noise: Noise,
        widths: Array | None = None,
    ) -> None:
        chain = likelihood.chain
        self.likelihood, self.noise = likelihood, noise
        self.free = tuple(name for name in chain.names if not priors[name].fixed)
        self.names = self.free + noise.names
        self.priors = tuple(priors[name] for name in self.free) + noise.priors
        self.dimension, self.not_finite = len(self.names), 0
        self._columns = [chain.names.index(name) for name in self.free]
        self._template = np.array(
            [priors[name].value if priors[name].fixed else 0.0 for name in chain.names]
        )
        self._all_priors = priors
        model_widths, noise_widths = (
            (None, None) if widths is None else np.split(widths, [len(self.free)])
        )
        self.coordinates = choose_coordinates(chain, priors, model_widths)
        self._noise_coordinates = BoundedCoordinates.of(noise.priors, noise_widths)

    def __call__(self, u: Array) -> Array:
        """Log posterior density ``(n,)`` of coordinates ``(n, d)``.

        The expensive likelihood is only evaluated where prior and Jacobian are finite. A non-finite
        value is counted in ``not_finite`` and is ``-inf``; at the edge of a prior that is infinite
        there a walker would be stuck.
        """
        parameters, jacobian = self.to_parameters(u)
        out = np.where(np.isfinite(jacobian), jacobian, -np.inf)
        out[~np.isfinite(parameters).all(axis=1)] = -np.inf
        possible = np.isfinite(out)
        out[possible] += self.log_prior(parameters[possible])
        possible = np.isfinite(out)
        out[~possible] = -np.inf
        if possible.any():
            density = self.log_likelihood(parameters[possible])
            is_finite = np.isfinite(density)
            self.not_finite += int(np.count_nonzero(~is_finite))
            out[possible] += np.where(is_finite, density, -np.inf)
        return out

    def with_widths(self, widths: Array) -> Target:
        """Return the same target in coordinates for posterior standard deviations ``(d,)``."""
        return Target(self.likelihood, self._all_priors, self.noise, widths)

    def with_circular_cut_at(self, values: Mapping[str, float]) -> Target:
        """Wrap circular angles so that the cut lies opposite the estimated values, by name.

        The ends of a prior over a whole turn have no meaning, and must not split the posterior.
        """
        cut = {name: self._all_priors[name].cut_opposite(value) for name, value in values.items()}
        if all(prior is self._all_priors[name] for name, prior in cut.items()):
            return self
        return Target(self.likelihood, {**self._all_priors, **cut}, self.noise)

    def relinearised_at(self, parameters: Array) -> Target:
        """Return the same target with the likelihood linearised at parameters ``(d,)``."""
        assert isinstance(self.likelihood, PositionLikelihood)
        likelihood = self.likelihood.relinearised_at(self.chain_values(parameters[None])[0])
        return Target(likelihood, self._all_priors, self.noise)

    def at(self, parameters: Array, stride: int | None = None) -> Target:
        """Return the same target, its closed-loop likelihood referring to parameters ``(d,)``.

        With another ``stride`` that of every so many readings.
        """
        likelihood, out = self.likelihood, copy(self)
        assert isinstance(likelihood, ClosedLoopLikelihood)
        if stride not in (None, likelihood.stride):
            likelihood = likelihood.with_stride(stride)
        scales = self.noise.scales(parameters[None, len(self.free) :])[0]
        out.likelihood = likelihood.at(self.chain_values(parameters[None])[0], scales)
        return out

    def precomputed(self, u: Array) -> Target:
        """Return the same target, fast near coordinates ``(n, d)``; its values do not change."""
        parameters, jacobian = self.to_parameters(u)
        draws = self.chain_values(parameters[np.isfinite(jacobian)])
        out = copy(self)
        out.likelihood = self.likelihood.precomputed(draws)
        return out

    def subsample(self) -> Target:
        """Return the target of subsamples of long recordings."""
        out = copy(self)
        out.likelihood = self.likelihood.subsample()
        return out

    def chain_values(self, parameters: Array) -> Array:
        """Insert fixed parameters: ``(n, d)`` to ``(n, n_parameters)``."""
        values = np.tile(self._template, (parameters.shape[0], 1))
        values[:, self._columns] = parameters[:, : len(self.free)]
        return values

    def to_parameters(self, u: Array) -> tuple[Array, Array]:
        """Map coordinates ``(n, d)`` to parameters and the log Jacobian ``(n,)``."""
        k = len(self.free)
        model, log_model = self.coordinates.to_parameters(u[:, :k])
        noise, log_noise = self._noise_coordinates.to_parameters(u[:, k:])
        return np.concatenate([model, noise], axis=1), log_model + log_noise

    def from_parameters(self, parameters: Array) -> Array:
        """Map parameters ``(n, d)`` to coordinates."""
        k = len(self.free)
        model = self.coordinates.from_parameters(parameters[:, :k])
        noise = self._noise_coordinates.from_parameters(parameters[:, k:])
        return np.concatenate([model, noise], axis=1)

    def to_linear(self, u: Array) -> tuple[Array, Array]:
        """Map coordinates ``(n, d)`` to linear ones, with ``log|dv/du|`` ``(n,)``."""
        k = len(self.free)
        v, slope = self.coordinates.to_linear(u[:, :k])
        return np.concatenate([v, u[:, k:]], axis=1), slope

    def from_linear(self, v: Array) -> Array:
        """Map linear coordinates back; impossible rows are not finite."""
        k = len(self.free)
        return np.concatenate([self.coordinates.from_linear(v[:, :k]), v[:, k:]], axis=1)

    def unbounded(self, parameters: Array) -> Array:
        """Map parameters ``(n, d)`` to linear coordinates, in which bounds truncate a normal."""
        return self.to_linear(self.from_parameters(parameters))[0]

    def from_unbounded(self, v: Array) -> Array:
        """Invert :meth:`unbounded`; rows beyond a bound or outside the prior are not finite."""
        u, out = self.from_linear(v), np.full(v.shape, np.nan)
        possible = np.isfinite(u).all(axis=1)
        parameters, slope = self.to_parameters(u[possible])
        parameters[~np.isfinite(slope)] = np.nan
        finite = np.flatnonzero(np.isfinite(parameters).all(axis=1))
        # coordinates may extend beyond a prior
        outside = finite[~np.isfinite(self.log_prior(parameters[finite]))]
        parameters[outside] = np.nan
        out[possible] = parameters
        return out

    @cached_property
    def friction(self) -> Flags:
        """Flags ``(k,)`` of unbounded coordinates that are friction, not physical constants."""
        measurands = {p.name: p.row.measurand for p in self.likelihood.chain.parameters}
        represented = self.coordinates.represents
        return np.array([measurands[self.free[i]] == "law" for i in represented], dtype=bool)

    def log_prior(self, parameters: Array) -> Array:
        """Log prior density ``(n,)`` of parameters ``(n, d)``."""
        return self._prior_density(parameters)

    @cached_property
    def _prior_density(self) -> Callable[[Array], Array]:
        return joint_log_density(self.priors)

    def log_likelihood(self, parameters: Array) -> Array:
        """Log-likelihood ``(n,)`` of parameters ``(n, d)``."""
        scales = self.noise.scales(parameters[:, len(self.free) :])
        return self.likelihood.log_density(self.chain_values(parameters), scales)


@dataclass(frozen=True, eq=False)
class LocalUnits:
    """Unit change of each parameter, in logarithms where possible, so that all are comparable."""

    names: tuple[str, ...]  # free parameters
    # the parameter, or the alpha of a load-dependent friction
    labels: tuple[str, ...]
    # (d,) 1 and -1 for coefficients with alpha_1 and alpha_2, else 0
    ways: NDArray[np.int_]
    # (d,) unit change, SI units: the value itself (logarithms), or the prior's standard deviation
    # if it is nearly zero
    units: Array
    shifted: Flags  # (d,) whether it is the prior's standard deviation

    def moved(self, values: Array, step: Array) -> Array:
        """Move parameters ``(d,)`` by a step ``(d,)`` in these units."""
        factor = np.exp(np.clip(step, -50.0, 50.0))
        out = np.where(self.shifted, values + step * self.units, values * factor)
        ways = self.ways
        return np.where(ways, ways * ((1.0 + ways * values) / factor - 1.0), out)


def units_of(target: Target, parameters: Array) -> LocalUnits:
    """Return the units at sampled parameters ``(d,)``.

    For load-dependent friction the logarithm of ``alpha_1 = 1/(1 + mu_1)`` or ``alpha_2 = 1/(1 -
    mu_2)``, in which the paper's scaling (section 4.2) is a straight line.
    """
    chain, values = target.likelihood.chain, parameters[: len(target.free)]
    free = [chain.parameters[chain.names.index(name)] for name in target.free]
    ways = np.array([alpha_sign(p) for p in free], dtype=np.int_)
    labels = tuple(
        f"{p.owner}.{p.quantity.replace('load', 'alpha')}" if way else p.name
        for p, way in zip(free, ways, strict=True)
    )
    # alpha_2 is infinite if the gearbox is irreversible
    alpha = -ways * (1.0 + ways * values)
    alpha = np.where((ways < 0) & (np.abs(alpha) <= 1e-3), 1e-3, alpha)
    sds = np.array([p.sd() for p in target.priors[: len(free)]])
    sds = np.where(np.isfinite(sds), sds, 1.0)
    # shares of the prior standard deviation below which a value counts as zero
    least = np.array([1e-3 if p.lower == 0.0 else 1e-2 for p in free]) * sds
    shifted = (ways == 0) & (np.abs(values) <= least)
    units = np.where(shifted, sds, np.where(ways, alpha, values))
    return LocalUnits(target.free, labels, ways, units, shifted)
