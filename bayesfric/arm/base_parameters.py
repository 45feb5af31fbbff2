"""Base parameters: the sums of inertial parameters that torques depend on (Gautier 1991).

Found numerically: of the regressor's columns along any motions, root to tip, each either adds to
those before or is a combination of them. What is a combination is told only in sums with these.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from bayesfric.arm.inertial_prior import Bodies, Doubt
from bayesfric.arm.inertia import OF_ONE
from bayesfric.recordings.arrays import Array

# Moments, each of all joints, that tell which columns depend on others.
_MOMENTS = 120
_ROUNDING = 1e-8
_OF_LINK = ("mass", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
_UNITS = ("kg", *("kg m",) * 3, *("kg m²",) * 6)


@dataclass(frozen=True)
class BaseParameter:
    """One combination.

    Attributes
    ----------
    name
        Of its first inertial parameter, such as ``mx of forearm_link``.
    beside
        What is in the sum besides, with its factor.
    unit
        Of the sum.
    value, sd
        By all joints.
    urdf, urdf_sd
        As the URDF has it, and how well that was said to be known.
    """

    name: str
    beside: Mapping[str, float]
    unit: str
    value: float
    sd: float
    urdf: float
    urdf_sd: float

    @property
    def text(self) -> str:
        """The sum."""
        parts = (f"{'+-'[k < 0.0]} {abs(k):.3g} {name}" for name, k in self.beside.items())
        return " ".join((self.name, *parts)).replace(" 1 ", " ")


def combinations(bodies: Bodies) -> tuple[Array, Array]:
    """Find the base parameters of an arm, whatever its motion.

    Returns
    -------
    first
        ``(r,)`` index of the first inertial parameter of each.
    sums
        ``(r, 10 n_links)``: what each is the sum of, with a factor of one for its first.
    """
    count, n = len(bodies.joints), OF_ONE * len(bodies.links)
    motion = np.random.default_rng(0).uniform(-2.0, 2.0, (3, count, _MOMENTS))
    every = np.broadcast_to(np.eye(n), (count, n, n))
    columns = np.moveaxis(bodies.torques(motion, every), 1, 2).reshape(-1, n)
    triangle = np.linalg.qr(columns).R
    basis, first = np.zeros((len(triangle), 0)), list[int]()
    for k in range(n):
        column = triangle[:, k]
        rest = column - basis @ (basis.T @ column)
        if np.linalg.norm(rest) > _ROUNDING * np.linalg.norm(triangle):
            first.append(k)
            basis = np.linalg.qr(triangle[:, first])[0]
    q, r = np.linalg.qr(triangle[:, first])
    sums = solve_triangular(r, q.T @ triangle)
    return np.array(first), np.where(np.abs(sums) > 1e3 * _ROUNDING, sums, 0.0)


def base_parameters(bodies: Bodies, doubt: Doubt, draws: Array) -> Sequence[BaseParameter]:
    """Say what ``draws`` ``(n, n_causes)`` of a doubt's causes make of the base parameters.

    Those first of which the data say most beside the URDF.
    """
    names = [f"{one} of {link}" for link in bodies.links for one in _OF_LINK]
    first, sums = combinations(bodies)
    urdf, ways = sums @ doubt.nominal, sums @ doubt.spread
    value, sd = urdf + ways @ draws.mean(axis=0), (draws @ ways.T).std(axis=0)
    prior = np.sqrt(np.sum(ways**2, axis=1))
    told = np.divide(sd, prior, out=np.ones_like(sd), where=prior > 0.0)
    return [
        BaseParameter(
            names[first[i]],
            {names[k]: float(sums[i, k]) for k in np.flatnonzero(sums[i]) if k != first[i]},
            _UNITS[first[i] % OF_ONE],
            *(float(x[i]) for x in (value, sd, urdf, prior)),
        )
        for i in np.argsort(told)
    ]
