"""A polynomial in place of a likelihood that simulates, exact priors and walls around it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy import stats

from bayesfric.recordings.arrays import Array

# States further below the best are no part of the posterior, and would bend the fit to them.
_SO_IMPROBABLE = 1e-6
# States for every coefficient, or the polynomial would learn their scatter.
_STATES_A_COEFFICIENT = 2


@dataclass(frozen=True)
class Surrogate:
    """Log posterior with the likelihood replaced by a cubic in the coordinates.

    What bends a posterior of a joint most are walls (no inertia or loss is negative) and what
    the priors say of the scale; both stay exact. The likelihood is close to normal in these
    coordinates: a cubic through the states of a warm-up follows it within a
    tenth of a unit, at a thousandth of a simulation's cost.

    It is ``z g + z C z + T z z z`` of ``z = (u - centre) @ whiten``, about standard normal; the
    third order is held at its value at ``radius`` further out, where a cubic would rise without
    end.
    """

    log_prior: Callable[[Array], Array]
    centre: Array
    whiten: Array
    gradient: Array
    curvature: Array
    third: Array  # (d, d, d)
    radius: float

    @classmethod
    def fitted(
        cls, log_prior: Callable[[Array], Array], states: Array, log_density: Array
    ) -> Surrogate | None:
        """Fit by least squares to what is known, without third order if that is little.

        ``None`` if it is too little for a quadratic. ``states`` ``(n, d)`` may repeat.
        """
        d = states.shape[1]
        # a walker that stayed where it was says nothing new
        first = np.sort(np.unique(log_density, return_index=True)[1])
        states, log_density = states[first], log_density[first]
        near = log_density > log_density.max() - stats.chi2.isf(_SO_IMPROBABLE, d) / 2.0
        states, log_density = states[near], log_density[near]
        pairs = np.array(list(combinations_with_replacement(range(d), 2))).T
        triples = np.array(list(combinations_with_replacement(range(d), 3))).T
        quadratic = 1 + d + pairs.shape[1]
        if states.shape[0] < _STATES_A_COEFFICIENT * quadratic:
            return None
        centre = states.mean(axis=0)
        try:
            root = np.linalg.cholesky(np.atleast_2d(np.cov(states.T)))
        except np.linalg.LinAlgError:  # one direction in which nothing moved yet
            return None
        whiten = np.asarray(np.linalg.inv(root).T, dtype=np.float64)
        z = (states - centre) @ whiten
        features = [np.ones((z.shape[0], 1)), z, z[:, pairs[0]] * z[:, pairs[1]]]
        if states.shape[0] >= _STATES_A_COEFFICIENT * (quadratic + triples.shape[1]):
            features.append(z[:, triples[0]] * z[:, triples[1]] * z[:, triples[2]])
        likelihood = log_density - log_prior(states)
        found = np.linalg.lstsq(np.concatenate(features, axis=1), likelihood, rcond=None)[0]
        upper, third = np.zeros((d, d)), np.zeros((d, d, d))
        upper[tuple(pairs)] = found[1 + d : quadratic]
        if found.size > quadratic:
            third[tuple(triples)] = found[quadratic:]
        # a likelihood that rose on all sides would draw proposals away from the posterior
        values, vectors = np.linalg.eigh((upper + upper.T) / 2.0)
        curvature = (vectors * np.minimum(values, 0.0)) @ vectors.T
        radius = float(np.linalg.norm(z, axis=1).max())
        return cls(log_prior, centre, whiten, found[1 : 1 + d], curvature, third, radius)

    def __call__(self, u: Array) -> Array:
        """Log density up to a constant, ``(n, d)`` to ``(n,)``."""
        n, d = u.shape
        z = (u - self.centre) @ self.whiten
        level = z @ self.gradient + np.sum(z @ self.curvature * z, axis=1)
        inner = z * np.minimum(1.0, self.radius / np.linalg.norm(z, axis=1))[:, None]
        bent = (inner @ self.third.reshape(d, -1)).reshape(n, d, d)
        level += np.einsum("nij,ni,nj->n", bent, inner, inner)
        return np.asarray(self.log_prior(u) + level)
