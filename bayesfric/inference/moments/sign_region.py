"""Where in the space of leg parameters the direction of power at a sample is certain.

Whether the motor drives the load or is driven depends on the sign of the load's torque, and that on
the parameters. Within a region about the posterior most samples have the same sign for all.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesfric.recordings.arrays import Array

# Share of its own length that a draw must have along the mean direction to shape the region.
_ALONG = 0.2
# Least spread of any direction: relative to the mean one, and absolute (the centre has length 1).
_FLOOR, _LEAST = 1e-6, 1e-12


@dataclass(frozen=True, eq=False)
class SignRegion:
    """An ellipsoid ``|inv(root) (l - centre)| <= R`` of leg parameters, for every R.

    The sign of ``psi l`` does not depend on the length of ``l``, so what counts is how near
    to the centre the ray through ``l`` comes. A sample's sign is the centre's at all ``l``
    nearer than its ratio ``|psi centre| / |root' psi|``.
    """

    centre: Array  # (n2,) leg parameters in motor units, of any length
    root: Array  # (n2, n2) such that root root' is the draws' covariance about it

    @cached_property
    def _inverse(self) -> Array:
        return np.asarray(np.linalg.inv(self.root))

    @classmethod
    def around(cls, legs: Array, size: Array) -> SignRegion | None:
        """Fit the region to draws.

        Shapes: ``legs`` (n, n2), ``size`` (n2,).
        """
        if legs.shape[1] == 0:
            return cls(np.zeros(0), np.zeros((0, 0)))
        torques = legs * size
        length = np.linalg.norm(torques, axis=1)
        good = np.isfinite(length) & (length > 0.0)
        unit = torques[good] / length[good, None]
        mean = unit.mean(axis=0) if unit.size else np.zeros(legs.shape[1])
        if not np.linalg.norm(mean) > 0.0:
            return None
        mean /= np.linalg.norm(mean)
        along = unit @ mean
        near = along > _ALONG
        if not near.any():
            return None
        # all draws at one length along the mean direction: their lengths say nothing here
        flat = unit[near] / along[near, None]
        centre = flat.mean(axis=0)
        apart = flat - centre
        covariance = apart.T @ apart / max(flat.shape[0] - 1, 1)
        floor = _FLOOR * np.trace(covariance) / mean.size + _LEAST
        covariance[np.diag_indices(mean.size)] += floor
        return cls(centre / size, np.linalg.cholesky(covariance) / size[:, None])

    def distance(self, legs: Array) -> Array:
        """Tell how near the ray through leg parameters comes to the centre.

        Shapes: ``legs`` (n, n2), returns (n,).
        """
        if self.centre.size == 0:
            return np.zeros(legs.shape[0])
        # a product with a small inverse is far cheaper than a solve at every step
        ray = self._inverse @ legs.T
        target = self._inverse @ self.centre
        with np.errstate(all="ignore"):
            # at length one nothing overflows
            ray /= np.abs(ray).max(axis=0)
            along = target @ ray / (ray * ray).sum(axis=0)
            distance = np.sqrt(((along * ray - target[:, None]) ** 2).sum(axis=0))
        return np.where(along > 0.0, distance, np.where(np.isnan(along), np.nan, np.inf))

    def ratios(self, psi: Array) -> Array:
        """Tell the distance up to which samples have the centre's sign.

        Shapes: ``psi`` (n2, n), returns (n,).
        """
        level = self.centre @ psi
        spread = self.root.T @ psi
        width = np.sqrt(np.einsum("kn,kn->n", spread, spread))
        ratio = np.full(level.size, np.inf)
        np.divide(np.abs(level), width, out=ratio, where=width > 0.0)
        return ratio
