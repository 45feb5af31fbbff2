"""The posterior in the coordinates of ``bayesfric`` and from its moments, with a gradient.

``bayesfric`` has no gradient. Gradient samplers use two implementations of the same density: JAX,
which differentiates it, and Numba for one vector at a time, with a manual gradient. Both use
the matrices to which ``bayesfric`` reduces the recording, including the kinks of ``|psi Theta2|``:
samples whose direction of power differs from the reference's are corrected one by one.

Beyond ``RADIUS`` standard deviations of the expected posterior ``bayesfric`` evaluates every
sample; these two keep the signs. ``check`` compares all three, and draws from there are counted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import erfc, exp, expm1, log, sqrt
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.linear_torque import linear_torque
from bayesfric.inference.moments import RADIUS, SignRegion, moment_matrices
from bayesfric.inference.target import Target

Array = NDArray[np.float64]

TOLERANCE = 1e-8
# the four motor and leg parameters that GearboxCoordinates pairs, in this order
FRONT = ("motor.viscous", "motor.coulomb_positive", "motor.coulomb_negative", "motor.inertia")
LEG = ("joint.viscous", "joint.coulomb_positive", "joint.coulomb_negative", "load.inertia")


@dataclass(frozen=True, eq=False)
class Reduced:
    """The knee's posterior as plain arrays; ``(12,)`` coordinates as in ``GearboxCoordinates``."""

    pairs: Array  # (4, 2) indices of FRONT and LEG in the parameter vector
    worth: Array  # (4, 2) motor torque per unit of each
    moment: tuple[int, float]  # the same of load.first_moment
    losses: tuple[int, int]
    prior: Array  # (12, 2) mean and sd of the logarithms
    front: Array  # (11, 5) and behind: coefficients of psi1 a unit of each parameter
    behind: Array
    centre: Array  # of the region, whitened (5,), and what whitens
    whiten: Array
    to_columns: Array
    matrix: Array
    ratios: Array
    signs: Array
    jumps: Array
    weights: Array
    slopes: Array
    samples: int

    @classmethod
    def of(cls, target: Target, draws: Array, medians: Array, prior_sd: float) -> Reduced:
        """Reduce the target's one recording near posterior draws ``(n, 12)``."""
        likelihood = target.likelihood
        assert isinstance(likelihood, TorqueLikelihood)
        chain, (signals,) = likelihood.chain, likelihood.observations
        linear = linear_torque(chain, [signals])
        assert linear is not None
        values = draws[:, : len(target.free)]
        region = SignRegion.around(linear.coefficients(values)[1], linear.typical_size())
        assert region is not None
        moments = moment_matrices(linear, signals, 0, region, RADIUS)
        form, weights = moments.forms[0], moments.weights[:, 0]
        index = {name: i for i, name in enumerate(target.free)}
        # without load-dependent friction, -c is front plus behind, and leg is behind
        units, leg, _, _ = linear.coefficients(np.eye(len(index)) * (1.0 - _losses(index)))
        size = leg.shape[1]
        # one draw and its coordinates determine the torque per unit of each parameter
        u = target.from_parameters(draws[:1])
        totals, shares = u[0, :4], u[0, 4:8]
        a = 1.0 + draws[0, index["gearbox.load_drive"]]
        load_share = np.array([0.5 * erfc(-x / sqrt(2.0)) for x in shares])
        pairs = np.array([[index[f], index[b]] for f, b in zip(FRONT, LEG, strict=True)])
        moment_index = index["load.first_moment"]
        return cls(
            pairs=pairs,
            worth=np.stack(
                [
                    totals * (1.0 - load_share) / draws[0, pairs[:, 0]],
                    totals * load_share / (a * draws[0, pairs[:, 1]]),
                ],
                axis=1,
            ),
            moment=(moment_index, float(u[0, 8] / (a * draws[0, moment_index]))),
            losses=(index["gearbox.load_drive"], index["gearbox.load_back"]),
            prior=np.stack([np.log(medians), np.full(medians.size, prior_sd)], axis=1),
            front=-units[:, 1 : 1 + size] - leg,
            behind=leg,
            centre=np.linalg.solve(region.root, region.centre),
            whiten=np.linalg.inv(region.root),
            to_columns=moments.to_columns,
            matrix=0.5 * (form + form.T),  # each product occurs once
            ratios=moments.ratios,
            signs=np.ascontiguousarray(moments.signs.T),
            jumps=moments.jumps[:, 0],
            weights=weights**2,
            slopes=2.0 * weights[:, None] * moments.rows[moments.first],
            samples=signals.measured.size,
        )

    @cached_property
    def arrays(self) -> tuple[Any, ...]:
        """Arguments of the compiled function after the coordinates."""
        return (
            self.pairs, self.worth, *self.moment, *self.losses, self.prior,
            self.front, self.behind, self.centre, self.whiten, self.to_columns, self.matrix,
            self.ratios, self.signs, self.jumps, self.weights, self.slopes, self.samples,
        )  # fmt: skip

    def with_gradient(self, u: Array) -> tuple[float, Array]:
        """Return the log density of a vector ``(12,)`` up to a constant, and its gradient."""
        gradient = np.zeros(u.size)
        density: float = _with_gradient(u, gradient, *self.arrays)
        return density, gradient

    def in_jax(self) -> Callable[[Any], Any]:
        """Return the log density of a vector ``(12,)`` up to a constant, as a JAX function."""
        import jax.numpy as jnp
        from jax.scipy.stats import norm

        def log_density(u: Any) -> Any:
            totals, shares, moment, loss, v, sigma = u[:4], u[4:8], u[8], u[9], u[10], u[11]
            log_t = norm.logcdf(-loss)
            t = jnp.exp(log_t)
            log_a = -log_t * norm.cdf(v)
            a = jnp.exp(log_a)
            x = jnp.zeros(11)
            x = x.at[self.pairs[:, 0]].set(totals * norm.cdf(-shares) / self.worth[:, 0])
            x = x.at[self.pairs[:, 1]].set(totals * norm.cdf(shares) / (a * self.worth[:, 1]))
            x = x.at[self.moment[0]].set(moment / (a * self.moment[1]))
            x = x.at[self.losses[0]].set(jnp.expm1(log_a))
            x = x.at[self.losses[1]].set(-jnp.expm1(log_a + log_t))
            # outside the support logarithms and gradients are not finite
            possible = jnp.all(x > 0.0) & jnp.all(totals > 0.0) & (sigma > 0.0)
            x, sigma = jnp.where(x > 0.0, x, 1.0), jnp.where(sigma > 0.0, sigma, 1.0)
            density = jnp.log(jnp.where(totals > 0.0, totals, 1.0)).sum() - 3.0 * log_a
            density += jnp.log(-log_t) - 0.5 * (shares @ shares + loss**2 + v**2)
            logs = jnp.log(jnp.append(x, sigma))
            normal = (logs - self.prior[:, 0]) / self.prior[:, 1]
            density -= logs.sum() + 0.5 * (normal**2).sum()
            leg = x @ self.behind
            lambda1, lambda2 = 0.5 * a * (1.0 + t), 0.5 * a * (1.0 - t)
            c = jnp.concatenate([jnp.ones(1), -(x @ self.front) - lambda1 * leg, -lambda2 * leg])
            z = c @ self.to_columns
            level = self.signs @ leg
            jump = self.jumps * lambda2 * jnp.minimum(level, 0.0)
            squares = z @ self.matrix @ z + (jump @ self.slopes) @ z + jump**2 @ self.weights
            density -= 0.5 * squares / sigma**2 + self.samples * jnp.log(sigma)
            return jnp.where(possible, density, -jnp.inf)

        return log_density

    def distance(self, parameters: Array) -> Array:
        """Return the distance of parameters ``(n, 12)`` in standard deviations, ``(n,)``."""
        ray = (parameters[:, :11] @ self.behind) @ self.whiten.T
        along = ray @ self.centre / (ray * ray).sum(axis=1)
        return np.asarray(np.linalg.norm(along[:, None] * ray - self.centre, axis=1))


def check(reference: Array, densities: Array) -> float:
    """Return the largest difference of log densities ``(n,)`` up to a constant; raise above 1e-8.

    Relative to the fall from the maximum where that exceeds one.
    """
    top = int(np.argmax(reference))
    fall = reference[top] - reference
    difference = np.abs(densities - densities[top] + fall) / np.maximum(1.0, fall)
    if not np.all(difference <= TOLERANCE):
        raise AssertionError(f"not the same density: {difference.max():.1e} apart")
    return float(difference.max())


def _losses(index: dict[str, int]) -> Array:
    """Indicate the rows of load-dependent friction, ``(n, 1)``."""
    return np.array([[float(name.startswith("gearbox."))] for name in index])


@njit(cache=True)
def _phi(x: float) -> float:
    return exp(-0.5 * x * x) * 0.3989422804014327


@njit(cache=True)
def _ndtr(x: float) -> float:
    return 0.5 * erfc(-x * 0.7071067811865476)


@njit(cache=True)
def _with_gradient(
    u: Array,
    gradient: Array,
    pairs: NDArray[np.int64],
    worth: Array,
    first: int,
    first_worth: float,
    drive: int,
    back: int,
    prior: Array,
    front: Array,
    behind: Array,
    centre: Array,
    whiten: Array,
    to_columns: Array,
    matrix: Array,
    ratios: Array,
    signs: Array,
    jumps: Array,
    weights: Array,
    slopes: Array,
    samples: int,
) -> float:
    n_pairs, n = pairs.shape[0], behind.shape[1]
    gradient[:] = 0.0
    loss, v, sigma = u[9], u[10], u[11]
    t, share = _ndtr(-loss), _ndtr(v)
    if not 0.0 < t < 1.0:
        return -np.inf
    log_t = log(t)
    log_a = -log_t * share
    a = exp(log_a)
    x, gx = np.empty(11), np.zeros(12)
    density = -3.0 * log_a + log(-log_t) - 0.5 * (loss * loss + v * v)
    for i in range(n_pairs):
        total, load_share = u[i], u[4 + i]
        if total <= 0.0:
            return -np.inf
        x[pairs[i, 0]] = total * _ndtr(-load_share) / worth[i, 0]
        x[pairs[i, 1]] = total * _ndtr(load_share) / (a * worth[i, 1])
        density += log(total) - 0.5 * load_share * load_share
    x[first] = u[8] / (a * first_worth)
    x[drive], x[back] = expm1(log_a), -expm1(log_a + log_t)
    for j in range(12):
        value = x[j] if j < 11 else sigma
        if not value > 0.0:
            return -np.inf
        deviation = (log(value) - prior[j, 0]) / prior[j, 1]
        density -= log(value) + 0.5 * deviation * deviation
        gx[j] = -(1.0 + deviation / prior[j, 1]) / value
    # the likelihood
    motor, leg = np.zeros(n), np.zeros(n)
    for j in range(11):
        for k in range(n):
            motor[k] += x[j] * front[j, k]
            leg[k] += x[j] * behind[j, k]
    lambda1, lambda2 = 0.5 * a * (1.0 + t), 0.5 * a * (1.0 - t)
    size = to_columns.shape[0]
    c = np.empty(size)
    c[0] = 1.0
    for k in range(n):
        c[1 + k] = -motor[k] - lambda1 * leg[k]
        c[1 + n + k] = -lambda2 * leg[k]
    z, gz = np.zeros(size), np.zeros(size)
    for j in range(size):
        for k in range(size):
            z[k] += c[j] * to_columns[j, k]
    squares = 0.0
    for j in range(size):
        product = 0.0
        for k in range(size):
            product += matrix[j, k] * z[k]
        squares += z[j] * product
        gz[j] = 2.0 * product
    length, along = 0.0, 0.0
    ray = np.zeros(n)
    for j in range(n):
        for k in range(n):
            ray[j] += whiten[j, k] * leg[k]
        length += ray[j] * ray[j]
        along += ray[j] * centre[j]
    along /= length
    distance = 0.0
    for j in range(n):
        distance += (along * ray[j] - centre[j]) ** 2
    gleg, glambda2 = np.zeros(n), 0.0
    # segments within the distance of this draw
    checked = np.searchsorted(ratios, sqrt(distance) * (1.0 + 1e-9) + 1e-12, side="right")
    for s in range(checked if along > 0.0 else ratios.size):
        level = 0.0
        for k in range(n):
            level += signs[s, k] * leg[k]
        if level >= 0.0:
            continue
        jump, slope = jumps[s] * lambda2 * level, 0.0
        for k in range(size):
            slope += slopes[s, k] * z[k]
            gz[k] += jump * slopes[s, k]
        squares += jump * (slope + jump * weights[s])
        by_jump = (slope + 2.0 * jump * weights[s]) * jumps[s]
        glambda2 += by_jump * level
        for k in range(n):
            gleg[k] += by_jump * lambda2 * signs[s, k]
    precision = 1.0 / (sigma * sigma)
    density -= 0.5 * squares * precision + samples * log(sigma)
    gx[11] += squares * precision / sigma - samples / sigma
    glambda1 = 0.0
    for k in range(n):
        first_part, second_part = 0.0, 0.0
        for j in range(size):
            first_part -= to_columns[1 + k, j] * gz[j]
            second_part -= to_columns[1 + n + k, j] * gz[j]
        motor[k] = -0.5 * precision * first_part
        gleg[k] = -0.5 * precision * (gleg[k] + lambda1 * first_part + lambda2 * second_part)
        glambda1 += first_part * leg[k]
        glambda2 += second_part * leg[k]
    glambda1, glambda2 = -0.5 * precision * glambda1, -0.5 * precision * glambda2
    for j in range(11):
        for k in range(n):
            gx[j] += front[j, k] * motor[k] + behind[j, k] * gleg[k]
    # back through the coordinates
    ga = -3.0 / a + 0.5 * ((1.0 + t) * glambda1 + (1.0 - t) * glambda2) + gx[drive] - t * gx[back]
    gt = 1.0 / (t * log_t) + 0.5 * a * (glambda1 - glambda2) - a * gx[back]
    for i in range(n_pairs):
        total, load_share = u[i], u[4 + i]
        f, b = pairs[i, 0], pairs[i, 1]
        gradient[i] = (1.0 + gx[f] * x[f] + gx[b] * x[b]) / total
        by_share = gx[b] / (a * worth[i, 1]) - gx[f] / worth[i, 0]
        gradient[4 + i] = total * _phi(load_share) * by_share - load_share
        ga -= gx[b] * x[b] / a
    gradient[8] = gx[first] / (a * first_worth)
    ga -= gx[first] * x[first] / a
    gt -= ga * a * share / t
    gradient[9] = -loss - gt * _phi(loss)
    gradient[10] = -v - ga * a * log_t * _phi(v)
    gradient[11] = gx[11]
    return density
