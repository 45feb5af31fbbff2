"""Coordinates in which the posterior is sampled.

A walker lives in unconstrained coordinates ``u``; a target turns ``u`` into
parameters and adds the logarithm of the Jacobian determinant, so that priors are
stated, and results reported, in physical parameters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_expit, ndtr, ndtri

from bayesfric.inference.prior.priors import Prior
from bayesfric.mechanism.joint import Joint

Array = NDArray[np.float64]

# A prior with a sd below this share of its mean tells its parameter.
_TELLING = 0.3
# Between two bounds, a posterior wider than this share of them feels both.
_WIDE = 0.1


class Coordinates(Protocol):
    """A one-to-one map between ``u`` and the free parameters."""

    @property
    def description(self) -> str:
        """In words, for the record."""
        ...

    def to_parameters(self, u: Array) -> tuple[Array, Array]:
        """Map ``(n, d)`` to parameters ``(n, d)`` and ``log|d parameters / d u|`` ``(n,)``.

        Rows without a counterpart come back with ``-inf``.
        """
        ...

    def from_parameters(self, parameters: Array) -> Array:
        """Map parameters ``(n, d)`` to ``u`` ``(n, d)``."""
        ...


class BoundedCoordinates:
    """Each parameter by itself: bounded ones bent, free ones as they are.

    A parameter above a bound is ``lower + w softplus(u)``: a straight line where
    the posterior lies several widths ``w`` above the bound, a logarithm next to it.
    A posterior that keeps away from the bound stays normal, one that leans on it
    needs no wall. (A plain logarithm would give the first a long left tail, in
    which walkers get lost.) Of a parameter between two bounds that are not far apart the
    normal quantile of its place between them is sampled: next to a bound a posterior is flat,
    and its quantile normal. (A logit would have a long tail there, in which walkers hang on.)

    ``widths`` ``(d,)`` are about the posterior sds; plain logarithms if they are not known yet.
    """

    def __init__(
        self, lower: Sequence[float], upper: Sequence[float], widths: Array | None = None
    ) -> None:
        self._bend = widths is not None
        self.description = "logarithm or normal quantile of each parameter between its bounds"
        if self._bend:
            self.description = "each parameter by itself, bent where it comes near a bound"
        self.lower, self.upper = np.array(lower, dtype=float), np.array(upper, dtype=float)
        low, high = np.isfinite(self.lower), np.isfinite(self.upper)
        span = np.where(low & high, self.upper - self.lower, np.inf)
        self._widths = np.ones(self.lower.size) if widths is None else widths
        self._between = low & high & ((self._widths > _WIDE * span) | (not self._bend))
        self._above = low & ~self._between
        self._below = ~low & high
        self._span = np.where(self._between, span, 1.0)
        self._low = np.where(low, self.lower, 0.0)
        self._high = np.where(high, self.upper, 0.0)

    def to_parameters(self, u: Array) -> tuple[Array, Array]:
        """See :class:`Coordinates`."""
        if self._bend:
            distance, log_slope = np.logaddexp(0.0, u), log_expit(u)
        else:
            # exp saturates far out; the density there is zero anyway
            distance, log_slope = np.exp(np.clip(u, -700.0, 700.0)), u
        distance = self._widths * distance
        x = np.where(self._above, self._low + distance, u)
        x = np.where(self._below, self._high - distance, x)
        x = np.where(self._between, self._low + self._span * ndtr(u), x)
        slope = np.where(self._above | self._below, np.log(self._widths) + log_slope, 0.0)
        slope = np.where(self._between, np.log(self._span) + _log_normal(u), slope)
        # so far out that rounding puts a parameter on its bound, where a noise model may end
        on_bound = (x <= self.lower) | (x >= self.upper)
        return x, np.where(on_bound.any(axis=1), -np.inf, slope.sum(axis=1))

    def from_parameters(self, parameters: Array) -> Array:
        """See :class:`Coordinates`."""
        # every branch is computed for every parameter, and each fails on the others' numbers
        with np.errstate(all="ignore"):
            u = np.where(self._above, self._unbent(parameters - self._low), parameters)
            u = np.where(self._below, self._unbent(self._high - parameters), u)
            share = (parameters - self._low) / self._span
            return np.where(self._between, ndtri(share), u)

    def _unbent(self, distance: Array) -> Array:
        scaled = distance / self._widths
        if not self._bend:
            return np.asarray(np.log(scaled))
        # log(expm1(y)) without overflow
        return np.asarray(scaled + np.log(-np.expm1(-scaled)))


# The chain whose inverse model is eq. (13), in this order of parameters: which element, whatever
# it is called, and what of it.
_GEARBOX_FORM = ("0.inertia", "0.viscous", "0.coulomb_positive", "0.coulomb_negative",
    "1.load_drive", "1.load_back", "2.viscous", "2.coulomb_positive", "2.coulomb_negative",
    "load.inertia", "load.first_moment")  # fmt: skip
# The same chain with one mu for both directions of power.
_SINGLE_LOSS_FORM = (*_GEARBOX_FORM[:4], "1.load", *_GEARBOX_FORM[6:])


class TorqueFormCoordinates:
    """Theta1, Theta2 of eq. (13) and the place of the scale between its bounds.

    The torque depends on Theta1 and Theta2 alone, in which the likelihood is
    close to normal. The eleventh number, the scale ``lambda_2``, does not touch
    the torque. A passive gearbox, ``mu_1 >= 0`` and ``0 <= mu_2 <= 1``, confines it to

    ``1/(rho + 1) <= lambda_2 <= 1/(rho - 1)``, ``rho = lambda_1/lambda_2 = theta5/theta10``,

    and its logarithm's place between those bounds is sampled as a normal quantile: where
    nothing tells the scale the place is about uniform, and its quantile normal. (A logit would
    have the long tails of a logistic distribution, in which walkers hang on.) Motor
    parameters, ``Theta1 - rho Theta2``, do not depend on the scale at all.

    Here Theta2's rows are leg parameters times ``lambda_2``, in joint units (the
    paper's rows divided by constants), and Theta1's in motor units. ``ratio`` is ``N``, motor
    speed over joint speed.

    A known ``first_moment``, ``ml`` in kg m, fixes the scale, ``lambda_2 = theta10 N/(g ml)``, and
    there is no eleventh coordinate. Of the ``ml`` or ``mu_1`` ``told`` well by a prior, the
    logarithm (that of ``1 + mu_1``) is the eleventh coordinate, in which such a posterior is
    straight, while its place between the bounds would be a bent ridge.
    """

    def __init__(
        self, ratio: float, gravity: float, first_moment: float | None = None, told: str = ""
    ) -> None:
        self.first_moment, self.told = first_moment, told
        self._moment_told = told.endswith(".first_moment")
        scale = "the alpha/leg scale between the bounds that a passive gearbox sets"
        if first_moment is not None:
            scale = "the scale known from load.first_moment"
        elif told:
            scale = f"the scale by {told}, which its prior tells"
        self.description = f"Theta1 and Theta2 of eq. (13), and {scale}"
        self._to_motor = _worth_at_motor(ratio, gravity)
        self._log_constant = -float(np.log(self._to_motor[:4]).sum())
        self._leg = [9, 6, 7, 8, 10]  # in _GEARBOX_FORM: J, f, C1, C2, ml

    def to_parameters(self, u: Array) -> tuple[Array, Array]:
        """See :class:`Coordinates`. ``u``: theta_1..5, theta_6..10, place of the scale."""
        theta1, theta2 = u[:, :5], u[:, 5:10]
        with np.errstate(all="ignore"):
            rho = theta1[:, 4] / theta2[:, 4]
            log_lambda2, log_slope = self._scale(u, rho)
            lambda2 = np.exp(log_lambda2)
            lambda1 = rho * lambda2
            parameters = np.empty((u.shape[0], 11))
            parameters[:, self._leg] = theta2 / (lambda2[:, None] * self._to_motor)
            parameters[:, :4] = theta1[:, :4] - rho[:, None] * theta2[:, :4]
            parameters[:, 4] = lambda1 + lambda2 - 1.0
            parameters[:, 5] = 1.0 - (lambda1 - lambda2)
            # |d(motor, mu, leg)/d(Theta1, Theta2, log lambda2)|, see the tests for the check
            constant = self._log_constant - math.log(self._to_motor[4]) + math.log(2.0)
            jacobian = constant - 3.0 * log_lambda2 - np.log(theta2[:, 4]) + log_slope
            possible = (theta2[:, 4] > 0.0) & (rho > 1.0)
            possible &= np.isfinite(jacobian) & np.isfinite(parameters).all(axis=1)
        return parameters[:, : u.shape[1]], np.where(possible, jacobian, -np.inf)

    def from_parameters(self, parameters: Array) -> Array:
        """See :class:`Coordinates`."""
        if self.first_moment is not None:
            known = np.full((parameters.shape[0], 1), self.first_moment)
            parameters = np.concatenate([parameters, known], axis=1)
        drive, back = 1.0 + parameters[:, 4], 1.0 - parameters[:, 5]
        lambda1, lambda2 = (drive + back) / 2.0, (drive - back) / 2.0
        leg = parameters[:, self._leg] * self._to_motor
        u = np.empty_like(parameters)
        u[:, 5:10] = lambda2[:, None] * leg
        u[:, :5] = lambda1[:, None] * leg
        u[:, :4] += parameters[:, :4]
        if self.first_moment is not None:
            return u[:, :10]
        if self.told:
            u[:, 10] = np.log(parameters[:, 10] if self._moment_told else drive)
            return u
        rho = lambda1 / lambda2
        low, high = -np.log(rho + 1.0), -np.log(rho - 1.0)
        u[:, 10] = ndtri((np.log(lambda2) - low) / (high - low))
        return u

    def _scale(self, u: Array, rho: Array) -> tuple[Array, Array]:
        """Compute ``log lambda_2`` and what its coordinate adds to the log Jacobian."""
        if self.first_moment is not None:
            # one coordinate and one parameter less: divide by d ml / d log lambda_2 = ml
            log_moment = math.log(self.first_moment)
            log_lambda2 = np.log(u[:, 9] / self._to_motor[4]) - log_moment
            return log_lambda2, np.full(u.shape[0], -log_moment)
        none = np.zeros(u.shape[0])
        if self._moment_told:
            return np.log(u[:, 9] / self._to_motor[4]) - u[:, 10], none
        if self.told:
            return u[:, 10] - np.log(rho + 1.0), none
        low, high = -np.log(rho + 1.0), -np.log(rho - 1.0)
        place = u[:, 10]
        return low + (high - low) * ndtr(place), np.log(high - low) + _log_normal(place)


class SingleLossCoordinates:
    """Theta1 and Theta2 of eq. (13) where one mu holds for both directions of power.

    Then ``lambda_1 = 1`` and ``lambda_2 = mu``: no scale is open, and ten coordinates are
    ten parameters, ``mu = theta10/theta5``.
    """

    description = "Theta1 and Theta2 of eq. (13), one mu for both directions"

    def __init__(self, ratio: float, gravity: float) -> None:
        self._to_motor = _worth_at_motor(ratio, gravity)
        self._log_constant = -float(np.log(self._to_motor).sum())
        self._leg = [8, 5, 6, 7, 9]  # in _SINGLE_LOSS_FORM: J, f, C1, C2, ml

    def to_parameters(self, u: Array) -> tuple[Array, Array]:
        """See :class:`Coordinates`. ``u``: theta_1..5, theta_6..10."""
        theta1, theta2 = u[:, :5], u[:, 5:]
        with np.errstate(all="ignore"):
            mu = theta2[:, 4] / theta1[:, 4]
            leg = theta2 / mu[:, None]
            parameters = np.empty_like(u)
            parameters[:, :4] = theta1[:, :4] - leg[:, :4]
            parameters[:, 4] = mu
            parameters[:, self._leg] = leg / self._to_motor
            # four of the leg by 1/mu, (mu, ml) by (theta5, theta10)
            jacobian = self._log_constant - 4.0 * np.log(mu) - np.log(theta1[:, 4])
            possible = (theta1[:, 4] > 0.0) & (mu > 0.0)
            possible &= np.isfinite(jacobian) & np.isfinite(parameters).all(axis=1)
        return parameters, np.where(possible, jacobian, -np.inf)

    def from_parameters(self, parameters: Array) -> Array:
        """See :class:`Coordinates`."""
        leg = parameters[:, self._leg] * self._to_motor
        u = np.empty_like(parameters)
        u[:, :5] = leg
        u[:, :4] += parameters[:, :4]
        u[:, 5:] = parameters[:, 4:5] * leg
        return u


def _log_normal(u: Array) -> Array:
    """Log density of a standard normal: the log slope of its distribution function."""
    with np.errstate(over="ignore"):  # minus infinity is right then
        return np.asarray(-0.5 * u**2 - 0.5 * math.log(2.0 * math.pi))


def _worth_at_motor(n: float, gravity: float) -> Array:
    """Give what each leg parameter is worth at the motor: inertia, viscous, C1, C2, gravity.

    Where gravity is negative its column of ``psi`` is, so that Theta stays positive.
    """
    return np.array([1.0 / n**2, 1.0 / n**2, 1.0 / n, 1.0 / n, abs(gravity) / n])


def _tells(prior: Prior) -> bool:
    """Whether a prior says more of its parameter than its order of magnitude."""
    return prior.sd() < _TELLING * prior.mean()


def choose_coordinates(
    chain: Joint, priors: Mapping[str, Prior], widths: Array | None = None
) -> Coordinates:
    """Take the coordinates that suit the chain, its priors and posterior sds ``(d,)`` best."""
    free = [name for name in chain.names if not priors[name].fixed]
    if all(e.ratio == 1.0 for i, e in enumerate(chain.elements) if i != 1):
        form, joint = _form(chain), (chain.ratio, chain.load.gravity)
        if form == _GEARBOX_FORM:
            drive, back, moment = (chain.names[i] for i in (4, 5, 10))
            reversible = priors[back].fixed or priors[back].upper <= 1.0
            if reversible and len(free) == len(form):
                told = [name for name in (moment, drive) if _tells(priors[name])]
                return TorqueFormCoordinates(*joint, told=told[0] if told else "")
            if reversible and tuple(free) == chain.names[:-1] and priors[moment].value > 0.0:
                return TorqueFormCoordinates(*joint, priors[moment].value)
        if form == _SINGLE_LOSS_FORM and len(free) == len(form):
            return SingleLossCoordinates(*joint)
    bounds = [(priors[name].lower, priors[name].upper) for name in free]
    return BoundedCoordinates([low for low, _ in bounds], [high for _, high in bounds], widths)


def _form(chain: Joint) -> tuple[str, ...]:
    """Tell parameters by place and quantity, whatever elements are called: ``0.inertia``."""
    places = {element.name: str(i) for i, element in enumerate(chain.elements)}
    owners = [(p.name.rpartition(".")[0], p.quantity) for p in chain.parameters]
    return tuple(f"{places.get(owner, owner)}.{quantity}" for owner, quantity in owners)
