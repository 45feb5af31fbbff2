"""The benchmark's posterior for the rivals, in NumPy alone.

Written out from eqs. (3) to (9) and (13) of the paper; shares no code with ``bayesfric``.

A parameter vector is the natural logarithm of, in this order, ``Jm fm Cm1 Cm2 mu1 mu2 fc Cc1 Cc2
Jc ml sigma``; densities include the Jacobian of the logarithm.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

# As near to the reference as rounding allows; relative where the density is far below its top.
TOLERANCE = 1e-8

ORDER = (
    "motor.inertia",
    "motor.viscous",
    "motor.coulomb_positive",
    "motor.coulomb_negative",
    "gearbox.load_drive",
    "gearbox.load_back",
    "joint.viscous",
    "joint.coulomb_positive",
    "joint.coulomb_negative",
    "load.inertia",
    "load.first_moment",
    "noise.sigma",
)


@dataclass(frozen=True, eq=False)
class Posterior:
    """The problem as arrays.

    The torque is ``motor @ (Jm, fm, Cm1, Cm2) + lambda1 T + lambda2 sign |T|`` with the torque at
    the gearbox ``T = leg @ (Jc, fc, Cc1, Cc2, ml)``, ``lambda1 = 1 + (mu1 - mu2)/2`` and
    ``lambda2 = (mu1 + mu2)/2``: eq. (13).

    Attributes
    ----------
    names
        Parameters, in order.
    motor, leg
        ``(N, 4)`` and ``(N, 5)``, torque at the motor's shaft per unit of each parameter.
    sign, torque
        ``(N,)`` direction of motion and measured motor torque.
    prior_mean, prior_sd, upper
        ``(12,)`` of the logarithms; ``upper`` is infinite where there is none.
    starts
        ``(n, 12)`` close to the posterior.
    reference_logarithms, reference_log_density
        ``(m, 12)`` and ``(m,)`` from ``bayesfric``, up to one constant.
    """

    names: tuple[str, ...]
    motor: np.ndarray
    leg: np.ndarray
    sign: np.ndarray
    torque: np.ndarray
    prior_mean: np.ndarray
    prior_sd: np.ndarray
    upper: np.ndarray
    starts: np.ndarray
    reference_logarithms: np.ndarray
    reference_log_density: np.ndarray

    @cached_property
    def both(self) -> np.ndarray:
        """Rows of ``motor`` and ``leg`` under each other, ``(9, N)``."""
        return np.concatenate([self.motor, self.leg], axis=1).T.copy()

    @property
    def dimension(self) -> int:
        """Number of sampled parameters."""
        return len(self.names)

    def log_density(self, x: np.ndarray) -> float:
        """Log density of one vector ``(12,)``."""
        if np.any(x > self.upper):
            return -np.inf
        z = (x - self.prior_mean) / self.prior_sd
        return self.log_likelihood(x) - 0.5 * float(z @ z)

    def log_likelihood(self, x: np.ndarray) -> float:
        """Log-likelihood of one vector ``(12,)``, a constant left out."""
        p = np.exp(x)
        leg = p[[9, 6, 7, 8, 10]]
        lambda1, lambda2 = 1.0 + 0.5 * (p[4] - p[5]), 0.5 * (p[4] + p[5])
        residual = self.torque - self.motor @ p[:4] - self.leg @ (lambda1 * leg)
        residual -= self.sign * np.abs(self.leg @ (lambda2 * leg))
        return -0.5 * float(residual @ residual) / p[11] ** 2 - self.torque.size * x[11]

    def log_density_many(self, x: np.ndarray) -> np.ndarray:
        """Log density of many vectors at once, ``(n, 12)`` to ``(n,)``."""
        p = np.exp(x)
        leg = p[:, [9, 6, 7, 8, 10]]
        lambda1, lambda2 = 1.0 + 0.5 * (p[:, 4] - p[:, 5]), 0.5 * (p[:, 4] + p[:, 5])
        # in place: every further array of this size costs more than the arithmetic
        residual = np.concatenate([p[:, :4], lambda1[:, None] * leg], axis=1) @ self.both
        residual -= self.torque
        loss = (lambda2[:, None] * leg) @ self.leg.T
        np.abs(loss, out=loss)
        loss *= self.sign
        residual += loss
        squares = np.einsum("ij,ij->i", residual, residual)
        z = (x - self.prior_mean) / self.prior_sd
        density = -0.5 * squares / p[:, 11] ** 2 - self.torque.size * x[:, 11]
        density -= 0.5 * np.einsum("ij,ij->i", z, z)
        return np.where((x > self.upper).any(axis=1), -np.inf, density)

    def check(self, log_density: Callable[[np.ndarray], float]) -> float:
        """Return the largest difference from the reference log density; raise if it differs."""
        densities = np.array([float(log_density(x)) for x in self.reference_logarithms])
        reference = self.reference_log_density
        top = int(np.argmax(reference))
        difference = np.abs((densities - densities[top]) - (reference - reference[top]))
        allowed = TOLERANCE * np.maximum(1.0, reference[top] - reference)
        if not np.all(difference <= allowed):
            raise AssertionError(f"not the same posterior: log densities differ by {difference}")
        return float(np.max(difference * TOLERANCE / allowed))


def read(path: Path) -> Posterior:
    """Read the file of ``problem.py``."""
    with np.load(path, allow_pickle=False) as file:
        names = tuple(str(name) for name in file["names"])
        if names != ORDER:
            raise ValueError(f"{path}: parameters in an order that this file does not know")
        q, qd, qdd = file["q"], file["qd"], file["qdd"]
        n, gravity = float(file["ratio"]), float(file["gravity"])
        prior = json.loads(str(file["prior"]))
        forwards, backwards = (qd > 0).astype(float), (qd < 0).astype(float)
        return Posterior(
            names=names,
            motor=np.stack([n * qdd, n * qd, forwards, -backwards], axis=1),
            leg=np.stack([qdd, qd, forwards, -backwards, gravity * np.sin(q)], axis=1) / n,
            sign=np.sign(qd),
            torque=file["torque"],
            prior_mean=np.log([row["median"] for row in prior]),
            prior_sd=np.array([row["sd"] for row in prior]),
            upper=np.log([np.inf if row["upper"] is None else row["upper"] for row in prior]),
            starts=file["starts"],
            reference_logarithms=file["reference_logarithms"],
            reference_log_density=file["reference_log_density"],
        )
