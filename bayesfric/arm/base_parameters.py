"""Base parameters: the combinations of inertial parameters that torques depend on (Gautier 1991).

Found numerically: of the regressor's columns along random motions, root to tip, each is either
independent of those before or a linear combination of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from bayesfric.arm.inertial_prior import PER_BODY, Bodies, InertialPrior
from bayesfric.recordings.arrays import Array

_SAMPLES = 120
_ROUNDING = 1e-8
_PARAMETERS = ("mass", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
_UNITS = ("kg", *("kg m",) * 3, *("kg m²",) * 6)


@dataclass(frozen=True)
class BaseParameter:
    """One combination; all fields are in ``arm.json``."""

    name: str  # of its first inertial parameter, such as ``mx of forearm_link``
    beside: Mapping[str, float]  # the other terms, with their factors
    unit: str
    value: float  # posterior by all joints
    sd: float
    urdf: float  # prior
    urdf_sd: float

    @property
    def text(self) -> str:
        """The combination as a formula."""
        parts = (f"{'+-'[k < 0.0]} {abs(k):.3g} {name}" for name, k in self.beside.items())
        return " ".join((self.name, *parts)).replace(" 1 ", " ")


def combinations(bodies: Bodies) -> tuple[Array, Array]:
    """Find the base parameters of an arm, independent of its motion.

    Returns the index ``(r,)`` of the first inertial parameter of each, and their coefficients
    ``(r, 10 n_links)``, which are 1 for the first.
    """
    count, n = len(bodies.joints), PER_BODY * len(bodies.links)
    motion = np.random.default_rng(0).uniform(-2.0, 2.0, (3, count, _SAMPLES))
    identity = np.broadcast_to(np.eye(n), (count, n, n))
    columns = np.moveaxis(bodies.torques(motion, identity), 1, 2).reshape(-1, n)
    triangle = np.linalg.qr(columns).R
    basis, first = np.zeros((len(triangle), 0)), list[int]()
    for k in range(n):
        column = triangle[:, k]
        residual = column - basis @ (basis.T @ column)
        if np.linalg.norm(residual) > _ROUNDING * np.linalg.norm(triangle):
            first.append(k)
            basis = np.linalg.qr(triangle[:, first])[0]
    q, r = np.linalg.qr(triangle[:, first])
    coefficients = solve_triangular(r, q.T @ triangle)
    return np.array(first), np.where(np.abs(coefficients) > 1e3 * _ROUNDING, coefficients, 0.0)


def base_parameters(bodies: Bodies, prior: InertialPrior, draws: Array) -> Sequence[BaseParameter]:
    """Give the posterior of the base parameters, those first whose sd the data reduce most.

    ``draws`` ``(n, n_deviations)`` are of the deviations of an inertial prior.
    """
    names = [f"{parameter} of {link}" for link in bodies.links for parameter in _PARAMETERS]
    first, coefficients = combinations(bodies)
    urdf, slopes = coefficients @ prior.nominal, coefficients @ prior.spread
    value, sd = urdf + slopes @ draws.mean(axis=0), (draws @ slopes.T).std(axis=0)
    prior_sd = np.sqrt(np.sum(slopes**2, axis=1))
    contraction = np.divide(sd, prior_sd, out=np.ones_like(sd), where=prior_sd > 0.0)
    return [
        BaseParameter(
            names[first[i]],
            {
                names[k]: float(coefficients[i, k])
                for k in np.flatnonzero(coefficients[i])
                if k != first[i]
            },
            _UNITS[first[i] % PER_BODY],
            *(float(x[i]) for x in (value, sd, urdf, prior_sd)),
        )
        for i in np.argsort(contraction)
    ]
