"""The posterior in the coordinates of ``bayesfric`` and from its moments, with a gradient.

``bayesfric`` itself has no gradient. Gradient samplers get the same density here twice: in JAX,
which differentiates it, and in Numba for one vector at a time, with the gradient by hand. Both
rest on the matrices that ``bayesfric`` reduces the recording to, kinks of ``|psi Theta2|``
included: a sample whose direction of power differs from the reference's is put right one by one.

Beyond ``RADIUS`` sds of the expected posterior ``bayesfric`` computes every sample anew; these two
go on with the signs that they have. ``check`` compares all three, and draws that went there are
counted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import erfc, exp, expm1, log, log1p, sqrt
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.moments.fast_moments import RADIUS
from bayesfric.inference.moments.linear_torque import linear_torque
from bayesfric.inference.moments.moment_matrices import SignRegion, moment_matrices
from bayesfric.inference.target import Target

Array = NDArray[np.float64]

TOLERANCE = 1e-8
# motor and leg of these four, in this order, are what GearboxCoordinates pairs
FRONT = ("motor.viscous", "motor.coulomb_positive", "motor.coulomb_negative", "motor.inertia")
LEG = ("joint.viscous", "joint.coulomb_positive", "joint.coulomb_negative", "load.inertia")


_HALF = 0.6931471805599453  # log 2


@dataclass(frozen=True, eq=False)
class Reduced:
    """The knee's posterior as plain arrays; ``(12,)`` coordinates are laid out as in ``split``."""

    pairs: Array  # (4, 2) places in the parameter vector of FRONT and LEG
    worth: Array  # (4, 2) torque at the motor of a unit of each
    moment: tuple[int, float]  # the same of load.first_moment
    losses: tuple[int, int]
    noise_width: float  # of the noise scale's coordinate
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
        chain, (o,) = likelihood.chain, likelihood.observations
        linear = linear_torque(chain, [o])
        assert linear is not None
        values = draws[:, : len(target.free)]
        region = SignRegion.around(linear.coefficients(values).leg, linear.typical_size())
        assert region is not None
        m = moment_matrices(linear, o, 0, region, RADIUS)
        k, (form, *_), signs, jumps, weights = m.to_columns.shape[0], *m.arrays[:3], m.arrays[5]
        slopes = m.arrays[6].reshape(m.ratios.size, -1, m.padded)
        at = {name: i for i, name in enumerate(target.free)}
        # without losses minus c is front and behind together, and the leg is what is behind
        units = linear.coefficients(np.eye(len(at)) * (1.0 - _losses(at)))
        size = units.leg.shape[1]
        # coordinates of one, and what parameters they are, tell what each is worth
        u = target.from_parameters(draws[:1])
        felt, places = u[0, :4], u[0, 4:8]
        a = 1.0 + draws[0, at["gearbox.load_drive"]]
        share = np.array([0.5 * erfc(-x / sqrt(2.0)) for x in places])
        pairs = np.array([[at[f], at[b]] for f, b in zip(FRONT, LEG, strict=True)])
        first = at["load.first_moment"]
        return cls(
            pairs=pairs,
            worth=np.stack(
                [
                    felt * (1.0 - share) / draws[0, pairs[:, 0]],
                    felt * share / (a * draws[0, pairs[:, 1]]),
                ],
                axis=1,
            ),
            moment=(first, float(u[0, 8] / (a * draws[0, first]))),
            losses=(at["gearbox.load_drive"], at["gearbox.load_back"]),
            noise_width=float(draws[0, 11] / _half_normal(u[0, 11])),
            prior=np.stack([np.log(medians), np.full(medians.size, prior_sd)], axis=1),
            front=-units.all[:, 1 : 1 + size] - units.leg,
            behind=units.leg,
            centre=np.linalg.solve(region.root, region.centre),
            whiten=np.linalg.inv(region.root),
            to_columns=m.to_columns,
            matrix=0.5 * (form[:, :k] + form[:, :k].T),  # each product stands once
            ratios=m.ratios,
            signs=np.ascontiguousarray(signs.T),
            jumps=jumps[:, 0],
            weights=weights[:, 0] ** 2,
            slopes=np.ascontiguousarray(slopes[:, 0, :k]),
            samples=o.measured.size,
        )

    @cached_property
    def arrays(self) -> tuple[Any, ...]:
        """What the compiled function takes behind the coordinates."""
        return (
            self.pairs, self.worth, *self.moment, *self.losses, self.noise_width, self.prior,
            self.front, self.behind, self.centre, self.whiten, self.to_columns, self.matrix,
            self.ratios, self.signs, self.jumps, self.weights, self.slopes, self.samples,
        )  # fmt: skip

    def one(self, u: Array) -> tuple[float, Array]:
        """Log density of one vector ``(12,)`` up to a constant, and its gradient; Numba."""
        gradient = np.zeros(u.size)
        density: float = _one(u, gradient, *self.arrays)
        return density, gradient

    def in_jax(self) -> Callable[[Any], Any]:
        """Log density of one vector ``(12,)`` up to a constant, for JAX to transform."""
        import jax.numpy as jnp
        from jax.lax import stop_gradient
        from jax.scipy.special import log_ndtr
        from jax.scipy.stats import norm

        def half_normal(u: Any) -> Any:
            aim, h = log_ndtr(-u) - _HALF, jnp.maximum(u, 0.1) + _HALF / jnp.maximum(u, 1.0)
            for _ in range(12):  # Newton's steps; the last one has the gradient
                h = stop_gradient(h)
                tail = log_ndtr(-h)
                h = jnp.maximum(h + (tail - aim) * jnp.exp(tail - norm.logpdf(h)), 1e-300)
            return h

        def log_density(u: Any) -> Any:
            felt, places, alone, lost, v, noise = u[:4], u[4:8], u[8], u[9], u[10], u[11]
            log_t = norm.logcdf(-lost)
            t = jnp.exp(log_t)
            log_a = -log_t * norm.cdf(v)
            a = jnp.exp(log_a)
            x = jnp.zeros(11)
            x = x.at[self.pairs[:, 0]].set(felt * norm.cdf(-places) / self.worth[:, 0])
            x = x.at[self.pairs[:, 1]].set(felt * norm.cdf(places) / (a * self.worth[:, 1]))
            x = x.at[self.moment[0]].set(alone / (a * self.moment[1]))
            x = x.at[self.losses[0]].set(jnp.expm1(log_a))
            x = x.at[self.losses[1]].set(-jnp.expm1(log_a + log_t))
            soft = half_normal(noise)
            sigma = self.noise_width * soft
            # outside the support the logarithms would be no numbers, and so would gradients
            possible = jnp.all(x > 0.0) & jnp.all(felt > 0.0)
            x = jnp.where(x > 0.0, x, 1.0)
            out = jnp.log(jnp.where(felt > 0.0, felt, 1.0)).sum() - 3.0 * log_a
            out += jnp.log(-log_t) - 0.5 * (places @ places + lost**2 + v**2)
            out += 0.5 * (soft**2 - noise**2)
            logs = jnp.log(jnp.append(x, sigma))
            out -= logs.sum() + 0.5 * (((logs - self.prior[:, 0]) / self.prior[:, 1]) ** 2).sum()
            leg = x @ self.behind
            lambda1, lambda2 = 0.5 * a * (1.0 + t), 0.5 * a * (1.0 - t)
            c = jnp.concatenate([jnp.ones(1), -(x @ self.front) - lambda1 * leg, -lambda2 * leg])
            z = c @ self.to_columns
            level = self.signs @ leg
            jump = self.jumps * lambda2 * jnp.minimum(level, 0.0)
            squares = z @ self.matrix @ z + (jump @ self.slopes) @ z + jump**2 @ self.weights
            out -= 0.5 * squares / sigma**2 + self.samples * jnp.log(sigma)
            return jnp.where(possible, out, -jnp.inf)

        return log_density

    def distance(self, parameters: Array) -> Array:
        """How many sds of the expected posterior parameters ``(n, 12)`` are away, ``(n,)``."""
        ray = (parameters[:, :11] @ self.behind) @ self.whiten.T
        along = ray @ self.centre / (ray * ray).sum(axis=1)
        return np.asarray(np.linalg.norm(along[:, None] * ray - self.centre, axis=1))


def check(wanted: Array, found: Array) -> float:
    """Compare log densities ``(n,)`` that may differ by one constant; give the most they do.

    Relative to the fall from the top where that is more than one. AssertionError beyond 1e-8.
    """
    top = int(np.argmax(wanted))
    fall = wanted[top] - wanted
    difference = np.abs(found - found[top] + fall) / np.maximum(1.0, fall)
    if not np.all(difference <= TOLERANCE):
        raise AssertionError(f"not the same density: {difference.max():.1e} apart")
    return float(difference.max())


def _losses(at: dict[str, int]) -> Array:
    """One in the rows of load losses, ``(n, 1)``."""
    return np.array([[float(name.startswith("gearbox."))] for name in at])


@njit(cache=True)
def _phi(x: float) -> float:
    return exp(-0.5 * x * x) * 0.3989422804014327


@njit(cache=True)
def _ndtr(x: float) -> float:
    return 0.5 * erfc(-x * 0.7071067811865476)


@njit(cache=True)
def _log_tail(x: float) -> float:
    """Log of the chance that a standard normal is above ``x``."""
    if x < 25.0:
        return log(0.5 * erfc(x * 0.7071067811865476))
    y = 1.0 / (x * x)
    left = log1p(-y * (1.0 - 3.0 * y * (1.0 - 5.0 * y * (1.0 - 7.0 * y))))
    return left - 0.5 * x * x - log(x * 2.5066282746310002)


@njit(cache=True)
def _half_normal(u: float) -> float:
    """See :func:`bayesfric.inference.coordinates.half_normal`; by Newton's steps."""
    if u < -4.0:
        below = _ndtr(u)
        return 1.2533141373155001 * (below + 0.2617993877991494 * below**3)
    aim, h = _log_tail(u) - _HALF, max(u, 0.1) + _HALF / max(u, 1.0)
    for _ in range(50):
        tail = _log_tail(h)
        step = (tail - aim) * exp(tail + 0.5 * h * h) * 2.5066282746310002
        h = max(h + step, 1e-300)
        if abs(step) <= 1e-15 * h:
            break
    return h


@njit(cache=True)
def _one(
    u: Array,
    gradient: Array,
    pairs: NDArray[np.int64],
    worth: Array,
    first: int,
    first_worth: float,
    drive: int,
    back: int,
    noise_width: float,
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
    lost, v, noise = u[9], u[10], u[11]
    t, share = _ndtr(-lost), _ndtr(v)
    if not (0.0 < t < 1.0) or noise < -700.0:
        return -np.inf
    log_t = log(t)
    log_a = -log_t * share
    a = exp(log_a)
    x, gx = np.empty(11), np.zeros(12)
    out = -3.0 * log_a + log(-log_t) - 0.5 * (lost * lost + v * v)
    for i in range(n_pairs):
        felt, place = u[i], u[4 + i]
        if felt <= 0.0:
            return -np.inf
        x[pairs[i, 0]] = felt * _ndtr(-place) / worth[i, 0]
        x[pairs[i, 1]] = felt * _ndtr(place) / (a * worth[i, 1])
        out += log(felt) - 0.5 * place * place
    x[first] = u[8] / (a * first_worth)
    x[drive], x[back] = expm1(log_a), -expm1(log_a + log_t)
    soft = _half_normal(noise)
    sigma = noise_width * soft
    by_noise = 0.5 * (soft * soft - noise * noise)  # twice the slope of that, its logarithm
    out += by_noise
    for j in range(12):
        value = x[j] if j < 11 else sigma
        if not value > 0.0:
            return -np.inf
        away = (log(value) - prior[j, 0]) / prior[j, 1]
        out -= log(value) + 0.5 * away * away
        gx[j] = -(1.0 + away / prior[j, 1]) / value
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
        total = 0.0
        for k in range(size):
            total += matrix[j, k] * z[k]
        squares += z[j] * total
        gz[j] = 2.0 * total
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
    # no further than this draw is away
    looked = np.searchsorted(ratios, sqrt(distance) * (1.0 + 1e-9) + 1e-12, side="right")
    for s in range(looked if along > 0.0 else ratios.size):
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
    out -= 0.5 * squares * precision + samples * log(sigma)
    gx[11] += squares * precision / sigma - samples / sigma
    glambda1 = 0.0
    for k in range(n):
        one, two = 0.0, 0.0
        for j in range(size):
            one -= to_columns[1 + k, j] * gz[j]
            two -= to_columns[1 + n + k, j] * gz[j]
        motor[k] = -0.5 * precision * one
        gleg[k] = -0.5 * precision * (gleg[k] + lambda1 * one + lambda2 * two)
        glambda1 += one * leg[k]
        glambda2 += two * leg[k]
    glambda1, glambda2 = -0.5 * precision * glambda1, -0.5 * precision * glambda2
    for j in range(11):
        for k in range(n):
            gx[j] += front[j, k] * motor[k] + behind[j, k] * gleg[k]
    # back through the coordinates
    ga = -3.0 / a + 0.5 * ((1.0 + t) * glambda1 + (1.0 - t) * glambda2) + gx[drive] - t * gx[back]
    gt = 1.0 / (t * log_t) + 0.5 * a * (glambda1 - glambda2) - a * gx[back]
    for i in range(n_pairs):
        felt, place = u[i], u[4 + i]
        f, b = pairs[i, 0], pairs[i, 1]
        gradient[i] = (1.0 + gx[f] * x[f] + gx[b] * x[b]) / felt
        by_share = gx[b] / (a * worth[i, 1]) - gx[f] / worth[i, 0]
        gradient[4 + i] = felt * _phi(place) * by_share - place
        ga -= gx[b] * x[b] / a
    gradient[8] = gx[first] / (a * first_worth)
    ga -= gx[first] * x[first] / a
    gt -= ga * a * share / t
    gradient[9] = -lost - gt * _phi(lost)
    gradient[10] = -v - ga * a * log_t * _phi(v)
    slope = 0.5 * exp(by_noise)
    gradient[11] = gx[11] * noise_width * slope + soft * slope - noise
    return out
