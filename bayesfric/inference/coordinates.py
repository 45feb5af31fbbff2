"""Coordinates in which the posterior is searched and sampled.

Priors are given and results reported in physical parameters. The search for the mode and the
sampler work in coordinates in which the posterior is closer to a normal; a target adds the log
Jacobian determinant.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from bayesfric.inference.priors import Prior
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import Parameter
from bayesfric.recordings.arrays import Array


def choose_coordinates(
    chain: Joint, priors: Mapping[str, Prior], widths: Array | None = None
) -> BoundedCoordinates | GearboxCoordinates:
    """Choose the coordinates of a mechanism; ``widths`` are ``(d,)``."""
    lossy = [e for e in chain.elements if e.load_loss != "none"]
    if len(lossy) == 1 and _sides(chain)[1]:
        back = priors.get(f"{lossy[0].name}.load_back")
        # an irreversible gearbox, mu_2 above one, transmits nothing backwards
        if back is None or (back.value if back.fixed else back.upper) <= 1.0:
            return GearboxCoordinates(chain, priors, widths)
    free = [priors[name] for name in chain.names if not priors[name].fixed]
    return BoundedCoordinates.of(free, widths)


class BoundedCoordinates:
    """Each parameter separately, with bounds and posterior widths ``(d,)``, nan if not known.

    Without widths, for the search, a parameter with one bound is the logarithm of its distance from
    it, one with two bounds the normal quantile of its relative position. With widths, for the
    sampler, a parameter represents itself, as the torque is linear in it and the bound truncates
    the posterior; only bounds closer than ten widths are mapped by the quantile.
    """

    is_nonlinear = False

    def __init__(
        self,
        lower: Sequence[float] | Array,
        upper: Sequence[float] | Array,
        widths: Array | None = None,
    ) -> None:
        self.lower, self.upper = np.array(lower, dtype=float), np.array(upper, dtype=float)
        # index (d,) of the free parameter whose torque each linear coordinate represents
        self.represents = np.arange(self.lower.size)
        low, high = np.isfinite(self.lower), np.isfinite(self.upper)
        span = np.where(low & high, self.upper - self.lower, np.inf)
        widths = np.full(low.size, np.nan) if widths is None else widths
        unknown = np.isnan(widths)
        self._above, self._below = unknown & low & ~high, unknown & high & ~low
        self._between = low & high & (unknown | (widths > 0.1 * span))
        self._span = np.where(self._between, span, 1.0)
        self._low = np.where(low, self.lower, 0.0)
        self._high = np.where(high, self.upper, 0.0)

    @classmethod
    def of(cls, priors: Sequence[Prior], widths: Array | None = None) -> BoundedCoordinates:
        """Make the coordinates of parameters with priors."""
        return cls([p.lower for p in priors], [p.upper for p in priors], widths)

    def to_parameters(self, u: Array) -> tuple[Array, Array]:
        """Map ``(n, d)`` to parameters and the log Jacobian ``(n,)``, ``-inf`` if impossible."""
        # exp saturates; the density there is zero
        distance = np.exp(np.clip(u, -700.0, 700.0))
        x = np.where(self._above, self._low + distance, u)
        x = np.where(self._below, self._high - distance, x)
        x = np.where(self._between, self._low + self._span * ndtr(u), x)
        slope = np.where(self._above | self._below, u, 0.0)
        slope = np.where(self._between, np.log(self._span) + _log_normal(u), slope)
        # rounding may place a parameter on its bound, where a noise model may be undefined
        outside = (x <= self.lower) | (x >= self.upper)
        return x, np.where(outside.any(axis=1), -np.inf, slope.sum(axis=1))

    def from_parameters(self, parameters: Array) -> Array:
        """Map parameters ``(n, d)`` to coordinates ``(n, d)``."""
        # all branches are evaluated for all parameters, and fail on the others' values
        with np.errstate(all="ignore"):
            u = np.where(self._above, np.log(parameters - self._low), parameters)
            u = np.where(self._below, np.log(self._high - parameters), u)
            return np.where(self._between, ndtri((parameters - self._low) / self._span), u)

    def to_linear(self, u: Array) -> tuple[Array, Array]:
        """Return coordinates ``(n, d)``, in which the torque is linear, with ``log|dv/du|``."""
        return u, np.zeros(len(u))

    def from_linear(self, v: Array) -> Array:
        """Return the same coordinates."""
        return v


class GearboxCoordinates:
    """Torques at the motor while it drives, and their distribution over motor, load and gearbox.

    With ``A = 1 + mu_1``, a parameter ``a`` in front of the load loss and one of the same kind
    behind it, ``b``, reflected to the motor by ``c``, act there as ``D = a c_a + A b c_b``; one
    that is only behind it as ``D = A b c_b``. The coordinates are

    - every ``D``, a sum of columns of ``Theta1 + Theta2`` of eq. (13), which any recording in which
      the motor drives determines, and in which the likelihood is close to normal;
    - the load's share ``A b c_b/D``, and ``m = 1 - (1 - mu_2)/(1 + mu_1)``, the relative torque
      missing when the load drives. They lie between 0 and 1, and their normal quantile is sampled:
      only a recording in which the load drives determines them, else they fill their range. (In
      Theta1 and Theta2 that range is a cone, whose tip, a gearbox without loss, has an unbounded
      density.)
    - the scale, which no torque determines. A passive gearbox, ``mu_1 >= 0`` and
      ``0 <= mu_2 <= 1``, confines it to ``0 <= log A <= -log(1 - m)``; the normal quantile of its
      place there is sampled. If the prior determines ``ml`` or ``mu_1``, the logarithm of ``ml``
      or of ``A`` replaces it, in which such a posterior is straight; a known one leaves no scale.

    Data that determine much of what is missing when the load drives determine sums of ``D share
    m``, and the posterior is curved in shares and ``m``, but not in ``D`` and these products
    (:meth:`to_linear`); moves are made in both sets. In quantiles alone the demo's posterior was a
    tenth too narrow, though every criterion was met.

    One mu for both directions leaves no scale, ``m = 2 mu/(1 + mu)``. All other parameters use
    :class:`BoundedCoordinates`, such a mu among them if it is known or may be above one.
    """

    def __init__(
        self, chain: Joint, priors: Mapping[str, Prior], widths: Array | None = None
    ) -> None:
        free = [name for name in chain.names if not priors[name].fixed]
        indices = {name: i for i, name in enumerate(free)}
        fixed = {n: priors[n].value for n in chain.names if priors[n].fixed}
        front, behind = _sides(chain)
        loss = next(e for e in chain.elements if e.load_loss != "none")
        kinds = ("load",) if loss.load_loss == "one" else ("load_drive", "load_back")
        names = [f"{loss.name}.{kind}" for kind in kinds]
        self._drive, self._back = (indices.get(n, -1) for n in (names[0], names[-1]))
        self._known_drive = fixed.get(names[0], math.nan)
        self._known_back = fixed.get(names[-1], math.nan)
        partners = {p.quantity: p for p in reversed(front) if p.lower == 0.0}
        # a free parameter behind, with a partner in front or without, and one in front of a known
        pairs, unpaired, with_known_leg = [], [], []
        reference: Parameter | None = None  # known, only behind: it determines the scale
        for b in behind:
            a = partners.pop(b.quantity, None) if b.lower == 0.0 else None
            a = a if a is not None and a.name in indices else None
            if b.name in indices and a is not None:
                pairs.append((a, b))
            elif b.name in indices:
                unpaired.append(b)
            elif a is not None:
                with_known_leg.append((a, b))
            elif fixed[b.name] > 0.0 and reference is None and b.quantity not in partners:
                reference = b
        # the first represents m in linear coordinates, and is positive if any is
        unpaired.sort(key=lambda b: b.lower != 0.0)
        self._positive = bool(unpaired) and unpaired[0].lower == 0.0
        self._scale = _choose_scale(names, indices, reference, [p.name for p in unpaired], priors)

        def columns_and_torques(parameters: Sequence[Parameter]) -> tuple[NDArray[np.int_], Array]:
            columns = np.array([indices[p.name] for p in parameters], dtype=int)
            return columns, np.array([_unit_torque(chain, p) for p in parameters])

        self._front, self._front_torque = columns_and_torques([a for a, _ in pairs])
        self._leg, self._leg_torque = columns_and_torques([b for _, b in pairs])
        self._unpaired, self._unpaired_torque = columns_and_torques(unpaired)
        in_front, known = [a for a, _ in with_known_leg], [b for _, b in with_known_leg]
        self._with_known_leg, self._with_known_leg_torque = columns_and_torques(in_front)
        self._known_leg = np.array([_unit_torque(chain, b) * fixed[b.name] for b in known])
        self._reference = 1.0
        if reference is not None:
            self._reference = _unit_torque(chain, reference) * fixed[reference.name]
        self._moment = next((i for i, b in enumerate(unpaired) if b.quantity == "first_moment"), -1)
        represented = {*self._front, *self._leg, *self._unpaired, *self._with_known_leg}
        represented |= set() if self._scale == "one" else {self._drive, self._back}
        self._others = np.array([i for i in range(len(free)) if i not in represented], dtype=int)
        others = [priors[free[i]] for i in self._others]
        self._bounded = BoundedCoordinates.of(
            others, None if widths is None else widths[self._others]
        )
        self.is_nonlinear = self._scale not in ("one", "known")
        has_scale = self._scale in ("place", "drive", "moment", "known leg")
        sizes = [len(pairs), len(pairs), len(unpaired), len(with_known_leg), len(others)]
        sizes += [int(self.is_nonlinear), int(has_scale)]
        self._ends, self._size = np.cumsum(sizes)[:-1], len(free)
        assert sum(sizes) == self._size
        # the missing torque and the scale represent the load loss
        loss_column = self._back if self._back >= 0 else self._drive
        sums = [self._front, self._leg, self._unpaired, self._with_known_leg, self._others]
        self.represents = np.full(self._size, loss_column, dtype=np.intp)
        self.represents[: self._ends[4]] = np.concatenate(sums)

    def to_parameters(self, u: Array) -> tuple[Array, Array]:
        """Map ``(n, d)`` to parameters and the log Jacobian ``(n,)``, ``-inf`` if impossible."""
        totals, shares, unpaired, with_known_leg, others, missing, scale = np.split(
            u, self._ends, axis=1
        )
        out = np.empty((u.shape[0], self._size))
        with np.errstate(all="ignore"):
            out[:, self._others], slope = self._bounded.to_parameters(others)
            log_a, log_m, loss_slope = self._losses(out, unpaired, missing, scale)
            slope = slope + loss_slope
            a = np.exp(log_a)[:, None]
            if self._scale != "one":
                if self._drive >= 0:
                    out[:, self._drive] = np.expm1(log_a)
                if self._back >= 0:
                    out[:, self._back] = -np.expm1(log_a + log_m)
            out[:, self._leg] = totals * ndtr(shares) / (a * self._leg_torque)
            out[:, self._front] = totals * ndtr(-shares) / self._front_torque
            out[:, self._unpaired] = unpaired / (a * self._unpaired_torque)
            out[:, self._with_known_leg] = (
                with_known_leg - a * self._known_leg
            ) / self._with_known_leg_torque
            # of a share and the total: D / (c_a A c_b)
            slope = slope + np.log(totals / (self._front_torque * self._leg_torque)).sum(axis=1)
            slope = slope + _log_normal(shares).sum(axis=1)
            slope = slope - (self._leg.size + self._unpaired.size) * log_a
            constant = np.concatenate([self._unpaired_torque, self._with_known_leg_torque])
            slope = slope - np.log(constant).sum()
            possible = np.isfinite(slope) & np.isfinite(out).all(axis=1)
        return out, np.where(possible, slope, -np.inf)

    def to_linear(self, u: Array) -> tuple[Array, Array]:
        """Map ``(n, d)`` to linear coordinates, with ``log|dv/du|`` ``(n,)``.

        The torques missing when the load drives, ``D share m``, replace shares, and that of the
        first unpaired torque replaces ``m``.
        """
        if not self.is_nonlinear:
            return u, np.zeros(len(u))
        v, k, m_index = u.copy(), self._leg.size, self._ends[4]
        totals, shares = u[:, :k], u[:, k : 2 * k]
        m, first_total = ndtr(u[:, m_index]), self._first_unpaired(u)
        with np.errstate(all="ignore"):
            v[:, k : 2 * k] = totals * ndtr(shares) * m[:, None]
            v[:, m_index] = first_total * m
            slope = _log_normal(shares).sum(axis=1) + np.log(totals * m[:, None]).sum(axis=1)
            return v, np.asarray(slope + np.log(first_total) + _log_normal(u[:, m_index]))

    def from_linear(self, v: Array) -> Array:
        """Map linear coordinates ``(n, d)`` back; impossible rows are not finite."""
        if not self.is_nonlinear:
            return v
        u, k, m_index = v.copy(), self._leg.size, self._ends[4]
        with np.errstate(all="ignore"):
            m = v[:, m_index] / self._first_unpaired(v)
            u[:, k : 2 * k] = ndtri(v[:, k : 2 * k] / (v[:, :k] * m[:, None]))
            u[:, m_index] = ndtri(m)
        return u

    def _first_unpaired(self, u: Array) -> Array:
        """Return the first torque that is only behind the loss, or one if its sign is unknown."""
        return u[:, self._ends[1]] if self._positive else np.ones(len(u))

    def _losses(
        self, out: Array, unpaired: Array, missing: Array, scale: Array
    ) -> tuple[Array, Array, Array]:
        """Return ``log A``, ``log(1 - m)`` and their part of the log Jacobian, ``(n,)`` each.

        ``missing`` is the quantile of ``m`` in its range, ``scale`` the coordinate of the scale.
        """
        zeros, kind = np.zeros(out.shape[0]), self._scale
        if kind in ("one", "known"):
            loss = out[:, self._drive] if self._drive >= 0 else self._known_drive
            return np.log1p(loss) + zeros, zeros, zeros
        # a known loss limits the range of m
        minimum = {
            "known drive": self._known_drive / (1.0 + self._known_drive),
            "known back": self._known_back,
        }.get(kind, 0.0)
        log_m = np.log1p(-minimum) + np.log(ndtr(-missing[:, 0]))
        slope = math.log1p(-minimum) + _log_normal(missing[:, 0])
        if kind == "known drive":
            log_a = np.log1p(self._known_drive) + zeros
            return log_a, log_m, slope + log_a
        if kind == "known back":
            log_a = np.log1p(-self._known_back) - log_m
            return log_a, log_m, slope + log_a - log_m
        if kind == "single":
            log_a = math.log(2.0) - np.log1p(np.exp(log_m))
            return log_a, log_m, slope + 2.0 * log_a - math.log(2.0)
        v = scale[:, 0]
        if kind == "place":
            log_a = -log_m * ndtr(v)
            slope = slope + np.log(-log_m) + _log_normal(v)
        elif kind == "drive":
            log_a = v
        elif kind == "moment":
            log_a = np.log(unpaired[:, self._moment] / self._unpaired_torque[self._moment]) - v
        else:  # a known parameter behind the loss determines A
            log_a = np.log(v / self._reference)
            slope = slope - np.log(v)
        return log_a, log_m, slope + 2.0 * log_a

    def from_parameters(self, parameters: Array) -> Array:
        """Map parameters ``(n, d)`` to coordinates ``(n, d)``."""
        zeros, kind = np.zeros(parameters.shape[0]), self._scale
        with np.errstate(all="ignore"):
            drive = parameters[:, self._drive] if self._drive >= 0 else self._known_drive + zeros
            back = parameters[:, self._back] if self._back >= 0 else self._known_back + zeros
            a = 1.0 + drive
            leg = a[:, None] * parameters[:, self._leg] * self._leg_torque
            front = parameters[:, self._front] * self._front_torque
            totals = leg + front
            # of the smaller part, for accuracy
            shares = np.where(leg < front, ndtri(leg / totals), -ndtri(front / totals))
            unpaired = a[:, None] * parameters[:, self._unpaired] * self._unpaired_torque
            with_known_leg = parameters[
                :, self._with_known_leg
            ] * self._with_known_leg_torque + np.outer(a, self._known_leg)
            u = [totals, shares, unpaired, with_known_leg]
            u += [self._bounded.from_parameters(parameters[:, self._others])]
            remaining = (1.0 - back) / a  # 1 - m
            maximum = {"known drive": 1.0 / a, "known back": 1.0 - back}.get(kind, zeros + 1.0)
            share = remaining / maximum
            missing = np.where(share < 0.5, -ndtri(share), ndtri((drive + back) / a))
            if kind in ("known drive", "known back"):
                missing = -ndtri(share)
            scale = {
                "place": ndtri(-np.log1p(drive) / np.log(remaining)),
                "drive": np.log1p(drive),
                "moment": np.log(
                    parameters[:, self._unpaired[self._moment]] if self._moment >= 0 else a
                ),
                "known leg": a * self._reference,
            }.get(kind)
            u += [missing[:, None]] if self.is_nonlinear else []
            u += [] if scale is None else [scale[:, None]]
        return np.concatenate(u, axis=1)


def _choose_scale(
    losses: list[str],
    indices: Mapping[str, int],
    reference: Parameter | None,
    unpaired: list[str],
    priors: Mapping[str, Prior],
) -> str:
    """Choose the coordinate of the scale of load and alpha.

    ``losses`` are the names of one mu or two, ``indices`` those of free parameters, ``reference`` a
    known load parameter, ``unpaired`` the free ones without a partner in front of the loss.
    """
    if len(losses) == 1:
        mu = priors[losses[0]]
        return "one" if mu.fixed or mu.upper > 1.0 else "single"
    drive, back = losses
    if drive not in indices:
        return "known drive" if back in indices else "known"
    if back not in indices:
        return "known back"
    if reference is not None:
        return "known leg"

    def is_informative(prior: Prior) -> bool:
        return prior.sd() < 0.3 * prior.mean()

    if any(name.endswith(".first_moment") and is_informative(priors[name]) for name in unpaired):
        return "moment"
    return "drive" if is_informative(priors[drive]) else "place"


def _sides(chain: Joint) -> tuple[list[Parameter], list[Parameter]]:
    """Split parameters into those in front of the load loss and those behind it."""
    last = next(i for i, e in enumerate(chain.elements) if e.load_loss != "none")
    before = {element.name for element in chain.elements[: last + 1]}
    after = {element.name for element in chain.elements[last + 1 :]} | {"load"}
    terms = [p for p in chain.parameters if p.row.role == "own"]
    return [p for p in terms if p.owner in before], [p for p in terms if p.owner in after]


def _unit_torque(chain: Joint, p: Parameter) -> float:
    """Return the lossless torque at the motor for unit value and unit motion of the motor."""
    reach = chain.reaches[p.owner] / chain.ratio
    gravity = abs(chain.load.gravity) if p.quantity == "first_moment" else 1.0
    return float(gravity * reach ** ((p.row.power or 0) + 1))


def _log_normal(u: Array) -> Array:
    """Log density of a standard normal."""
    with np.errstate(over="ignore"):
        return np.asarray(-0.5 * u**2 - 0.5 * math.log(2.0 * math.pi))
