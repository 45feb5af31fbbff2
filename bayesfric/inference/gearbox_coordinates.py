"""Coordinates for a joint with load-dependent friction: what data determine apart from what not.

No torque tells the leg's parameters from the gearbox' alphas (section 4.2 of the paper: scaled
together they change nothing), and motion in which the load never drives tells even less. In
parameters as they are named such a posterior is a bent ridge. Here each direction that the data
may leave open has a coordinate of its own, and fills its range in it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from bayesfric.inference.coordinates import BoundedCoordinates, Coordinates, log_normal
from bayesfric.inference.prior.priors import Prior
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import Parameter
from bayesfric.recordings.arrays import Array

# A prior with a sd below this share of its mean determines its parameter.
_INFORMATIVE = 0.3
# Where the losses are known, or sampled themselves, the torque is linear as it is.
_LINEAR = ("one", "known")

Scale = Literal[
    "place", "drive", "moment", "known leg", "known drive", "known back", "known", "single", "one"
]


class GearboxCoordinates(Coordinates):
    """Torques seen at the motor while it drives, and how motor, leg and gearbox share them.

    With ``A = 1 + mu_1``, a parameter ``a`` in front of the load loss and the one behind it of the
    same kind, ``b``, brought to the motor by ``c``, are seen there as ``D = a c_a + A b c_b``; one
    that is only behind it as ``D = A b c_b``. The coordinates are

    - every ``D``, a sum of columns of ``Theta1 + Theta2`` of eq. (13), which any recording in which
      the motor drives determines, and in which the likelihood is close to normal;
    - the leg's share ``A b c_b/D``, and ``m = 1 - (1 - mu_2)/(1 + mu_1)``, what of a torque behind
      the loss is missing when the load drives. They lie between 0 and 1, and their normal quantile
      is sampled: only a recording in which the load drives determines them, and where none does
      they fill their range. (In Theta1 and Theta2 themselves that range is a cone, whose tip, a
      gearbox without loss, has a density without end: searches ended and walkers hung on there.)
    - the scale, which no torque determines. A passive gearbox, ``mu_1 >= 0`` and
      ``0 <= mu_2 <= 1``, confines it to ``0 <= log A <= -log(1 - m)``; the normal quantile of its
      place there is sampled. Where the prior states ``ml`` or ``mu_1`` well, the logarithm of
      ``ml`` or of ``A`` takes its place, in which such a posterior is straight; one that is known
      leaves no scale.

    Where the data determine much of what is missing when the load drives they determine sums of
    ``D`` times share times ``m``, and the posterior is curved in shares and ``m``. In ``D`` and
    these products it is not (:meth:`to_linear`); moves are made in both sets. In quantiles alone
    the demo's posterior came out a tenth too narrow, though every criterion was met.

    One mu for both directions leaves no scale, ``m = 2 mu/(1 + mu)``. All other parameters go by
    :class:`BoundedCoordinates`, such a mu among them where it is known or may be above one.

    Shapes: ``widths`` (d,).
    """

    def __init__(
        self, chain: Joint, priors: Mapping[str, Prior], widths: Array | None = None
    ) -> None:
        free = [name for name in chain.names if not priors[name].fixed]
        at = {name: i for i, name in enumerate(free)}
        known = {n: priors[n].value for n in chain.names if priors[n].fixed}
        front, behind = _sides(chain)
        loss = next(e for e in chain.elements if e.load_loss != "none")
        one = loss.load_loss == "one"
        names = [f"{loss.name}.{q}" for q in (("load",) if one else ("load_drive", "load_back"))]
        self._drive, self._back = (at.get(n, -1) for n in (names[0], names[-1]))
        self._known_drive = known.get(names[0], math.nan)
        self._known_back = known.get(names[-1], math.nan)
        partners = {p.quantity: p for p in reversed(front) if p.lower == 0.0}
        pairs: list[tuple[Parameter, Parameter]] = []
        alone: list[Parameter] = []  # free, only behind
        beside: list[tuple[Parameter, Parameter]] = []  # free in front of a known one behind
        reference: Parameter | None = None  # known, only behind: it tells the scale
        for b in behind:
            a = partners.pop(b.quantity, None) if b.lower == 0.0 else None
            a = a if a is not None and a.name in at else None
            if b.name in at and a is not None:
                pairs.append((a, b))
            elif b.name in at:
                alone.append(b)
            elif a is not None:
                beside.append((a, b))
            elif known[b.name] > 0.0 and reference is None and b.quantity not in partners:
                reference = b
        # the first stands for m where the torque is to be linear, and is positive if any is
        alone.sort(key=lambda b: b.lower != 0.0)
        self._positive = bool(alone) and alone[0].lower == 0.0
        self._scale = _scale_by(names, at, reference, [p.name for p in alone], priors)
        self._front, self._front_worth = _placed(chain, at, [a for a, _ in pairs])
        self._leg, self._leg_worth = _placed(chain, at, [b for _, b in pairs])
        self._alone, self._alone_worth = _placed(chain, at, alone)
        self._beside, self._beside_worth = _placed(chain, at, [a for a, _ in beside])
        self._beside_leg = np.array([_worth(chain, b) * known[b.name] for _, b in beside])
        self._reference = 1.0
        if reference is not None:
            self._reference = _worth(chain, reference) * known[reference.name]
        self._moment = next((i for i, b in enumerate(alone) if b.quantity == "first_moment"), -1)
        taken = {*self._front, *self._leg, *self._alone, *self._beside}
        taken |= set() if self._scale == "one" else {self._drive, self._back}
        self._others = np.array([i for i in range(len(free)) if i not in taken], dtype=int)
        rest = [priors[free[i]] for i in self._others]
        self._bounded = BoundedCoordinates(
            [p.lower for p in rest],
            [p.upper for p in rest],
            None if widths is None else widths[self._others],
        )
        sizes = [len(pairs), len(pairs), len(alone), len(beside), len(rest)]
        sizes += [int(self._scale not in ("one", "known"))]
        sizes += [int(self._scale in ("place", "drive", "moment", "known leg"))]
        self._ends = np.cumsum(sizes)[:-1]
        self._size = len(free)
        assert sum(sizes) == self._size

    def to_parameters(self, u: Array) -> tuple[Array, Array]:
        """See :class:`Coordinates`."""
        felt, places, alone, beside, rest, lost, scale = np.split(u, self._ends, axis=1)
        out = np.empty((u.shape[0], self._size))
        with np.errstate(all="ignore"):
            out[:, self._others], slope = self._bounded.to_parameters(rest)
            log_a, log_m, more = self._losses(out, alone, lost, scale)
            slope = slope + more
            a = np.exp(log_a)[:, None]
            if self._scale != "one":
                if self._drive >= 0:
                    out[:, self._drive] = np.expm1(log_a)
                if self._back >= 0:
                    out[:, self._back] = -np.expm1(log_a + log_m)
            out[:, self._leg] = felt * ndtr(places) / (a * self._leg_worth)
            out[:, self._front] = felt * ndtr(-places) / self._front_worth
            out[:, self._alone] = alone / (a * self._alone_worth)
            out[:, self._beside] = (beside - a * self._beside_leg) / self._beside_worth
            # of a share and what is felt: D / (c_a A c_b)
            slope = slope + (np.log(felt / (self._front_worth * self._leg_worth))).sum(axis=1)
            slope = slope + log_normal(places).sum(axis=1)
            slope = slope - (self._leg.size + self._alone.size) * log_a
            slope = slope - np.log(self._alone_worth).sum() - np.log(self._beside_worth).sum()
            possible = np.isfinite(slope) & np.isfinite(out).all(axis=1)
        return out, np.where(possible, slope, -np.inf)

    @property
    def is_nonlinear(self) -> bool:
        """See :class:`Coordinates`."""
        return self._scale not in _LINEAR

    @property
    def represents(self) -> NDArray[np.intp]:
        """See :class:`Coordinates`: what is missing and the scale are the load loss's."""
        sums = [self._front, self._leg, self._alone, self._beside, self._others]
        loss = self._back if self._back >= 0 else self._drive
        rest = np.full(self._size - sum(part.size for part in sums), loss)
        return np.concatenate([*sums, rest]).astype(np.intp)

    def to_linear(self, u: Array) -> tuple[Array, Array]:
        """See :class:`Coordinates`.

        What is missing of the leg's torques when the load drives, ``D share m``, takes the place of
        shares, and that of the first torque that is only behind the loss the place of ``m``.
        """
        if self._scale in _LINEAR:
            return u, np.zeros(len(u))
        v = u.copy()
        felt, places, m_at = self._parts(u)
        m, whole = ndtr(u[:, m_at]), self._whole(u)
        with np.errstate(all="ignore"):
            v[:, felt.stop : 2 * felt.stop] = u[:, felt] * ndtr(places) * m[:, None]
            v[:, m_at] = whole * m
            slope = log_normal(places).sum(axis=1) + np.log(u[:, felt] * m[:, None]).sum(axis=1)
            return v, np.asarray(slope + np.log(whole) + log_normal(u[:, m_at]))

    def from_linear(self, v: Array) -> Array:
        """See :class:`Coordinates`."""
        if self._scale in _LINEAR:
            return v
        u = v.copy()
        felt, missing, m_at = self._parts(v)
        with np.errstate(all="ignore"):
            m = v[:, m_at] / self._whole(v)
            u[:, felt.stop : 2 * felt.stop] = ndtri(missing / (v[:, felt] * m[:, None]))
            u[:, m_at] = ndtri(m)
        return u

    def _parts(self, u: Array) -> tuple[slice, Array, int]:
        """Where pairs' torques are, what stands for their shares, and where ``m`` is."""
        k = self._leg.size
        return slice(0, k), u[:, k : 2 * k], int(self._ends[4])

    def _whole(self, u: Array) -> Array:
        """Give the first torque that is only behind the loss, one where none is sure to be any."""
        return u[:, self._ends[1]] if self._positive else np.ones(len(u))

    def _losses(
        self, out: Array, alone: Array, lost: Array, scale: Array
    ) -> tuple[Array, Array, Array]:
        """Give ``log A``, ``log(1 - m)`` and what both add to the log Jacobian, ``(n,)`` each.

        ``lost`` is the quantile of ``m`` in what a known loss leaves of its range, ``scale`` the
        coordinate of the scale; which of them there are, and how they are meant, is ``_scale``.
        """
        none, kind = np.zeros(out.shape[0]), self._scale
        if kind == "one":
            loss = out[:, self._drive] if self._drive >= 0 else self._known_drive + none
            return np.log1p(loss), none, none
        if kind == "known":
            return np.log1p(self._known_drive) + none, none, none
        # m lies above what a known loss leaves of its range
        least = {
            "known drive": self._known_drive / (1.0 + self._known_drive),
            "known back": self._known_back,
        }.get(kind, 0.0)
        log_m = np.log1p(-least) + np.log(ndtr(-lost[:, 0]))
        slope = math.log1p(-least) + log_normal(lost[:, 0])
        if kind == "known drive":
            log_a = np.log1p(self._known_drive) + none
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
            slope = slope + np.log(-log_m) + log_normal(v)
        elif kind == "drive":
            log_a = v
        elif kind == "moment":
            log_a = np.log(alone[:, self._moment] / self._alone_worth[self._moment]) - v
        else:  # the known one behind the loss: what the motor feels of it tells A
            log_a = np.log(v / self._reference)
            slope = slope - np.log(v)
        return log_a, log_m, slope + 2.0 * log_a

    def from_parameters(self, parameters: Array) -> Array:
        """See :class:`Coordinates`."""
        none, kind = np.zeros(parameters.shape[0]), self._scale
        with np.errstate(all="ignore"):
            drive = parameters[:, self._drive] if self._drive >= 0 else self._known_drive + none
            back = parameters[:, self._back] if self._back >= 0 else self._known_back + none
            a = 1.0 + drive
            leg = a[:, None] * parameters[:, self._leg] * self._leg_worth
            front = parameters[:, self._front] * self._front_worth
            felt = leg + front
            # of the smaller part, whose digits the other's share of one has lost
            places = np.where(leg < front, ndtri(leg / felt), -ndtri(front / felt))
            alone = a[:, None] * parameters[:, self._alone] * self._alone_worth
            beside = parameters[:, self._beside] * self._beside_worth + np.outer(
                a, self._beside_leg
            )
            u = [felt, places, alone, beside]
            u += [self._bounded.from_parameters(parameters[:, self._others])]
            kept = (1.0 - back) / a  # 1 - m
            least = {"known drive": 1.0 / a, "known back": 1.0 - back}.get(kind, none + 1.0)
            share = kept / least
            lost = np.where(share < 0.5, -ndtri(share), ndtri((drive + back) / a))
            if kind in ("known drive", "known back"):
                lost = -ndtri(share)
            scale = {
                "place": ndtri(-np.log1p(drive) / np.log(kept)),
                "drive": np.log1p(drive),
                "moment": np.log(
                    parameters[:, self._alone[self._moment]] if self._moment >= 0 else a
                ),
                "known leg": a * self._reference,
            }.get(kind)
            u += [] if kind in ("one", "known") else [lost[:, None]]
            u += [] if scale is None else [scale[:, None]]
        return np.concatenate(u, axis=1)


def _scale_by(
    losses: list[str],
    at: Mapping[str, int],
    reference: Parameter | None,
    alone: list[str],
    priors: Mapping[str, Prior],
) -> Scale:
    """Say what the scale of leg and alpha goes by, given which losses are free or known.

    ``losses`` are the names of one mu or two, ``at`` places of free parameters, ``reference`` a
    known leg parameter, and ``alone`` the free ones with no partner in front of the loss.
    """
    if len(losses) == 1:
        mu = priors[losses[0]]
        return "one" if mu.fixed or mu.upper > 1.0 else "single"
    drive, back = losses
    if drive not in at:
        return "known drive" if back in at else "known"
    if back not in at:
        return "known back"
    if reference is not None:
        return "known leg"
    if any(name.endswith(".first_moment") and _informative(priors[name]) for name in alone):
        return "moment"
    return "drive" if _informative(priors[drive]) else "place"


def _sides(chain: Joint) -> tuple[list[Parameter], list[Parameter]]:
    """Parameters that add a torque in front of the load loss, and behind it."""
    last = next(i for i, e in enumerate(chain.elements) if e.load_loss != "none")
    before = {element.name for element in chain.elements[: last + 1]}
    after = {element.name for element in chain.elements[last + 1 :]} | {"load"}
    own = [p for p in chain.parameters if p.row.role == "own"]
    return [p for p in own if p.owner in before], [p for p in own if p.owner in after]


def _placed(
    chain: Joint, at: Mapping[str, int], parameters: Sequence[Parameter]
) -> tuple[NDArray[np.int_], Array]:
    """Say where free parameters are, and what each is worth at the motor."""
    places = np.array([at[p.name] for p in parameters], dtype=int)
    return places, np.array([_worth(chain, p) for p in parameters])


def _worth(chain: Joint, p: Parameter) -> float:
    """Give the torque at the motor for a value of one at the motor's unit of motion, no losses."""
    reach = chain.reaches[p.owner] / chain.ratio
    gravity = abs(chain.load.gravity) if p.quantity == "first_moment" else 1.0
    return float(gravity * reach ** ((p.row.power or 0) + 1))


def _informative(prior: Prior) -> bool:
    """Whether a prior says more of its parameter than its order of magnitude."""
    return prior.sd() < _INFORMATIVE * prior.mean()


def choose_coordinates(
    chain: Joint, priors: Mapping[str, Prior], widths: Array | None = None
) -> Coordinates:
    """Take the coordinates that suit a mechanism best.

    Shapes: ``widths`` (d,).
    """
    lossy = [e for e in chain.elements if e.load_loss != "none"]
    if len(lossy) == 1 and _sides(chain)[1]:
        back = f"{lossy[0].name}.load_back"
        # an irreversible gearbox, mu_2 above one, passes nothing back
        if (
            back not in priors
            or (priors[back].value if priors[back].fixed else priors[back].upper) <= 1.0
        ):
            return GearboxCoordinates(chain, priors, widths)
    free = [priors[name] for name in chain.names if not priors[name].fixed]
    return BoundedCoordinates([p.lower for p in free], [p.upper for p in free], widths)
