"""The modelled torque behind the filter of the measured one, its form, and its minimum.

Joints with at most one load-dependent element and no Stribeck rise have the form
``psi Theta1 + sign(qd) |psi Theta2|``, eq. (13), wherever they move; at standstill the mechanism
has no loss, while eq. (13) leaves ``lambda_1``. Eqs. (14) to (19) minimise its error.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from bayesfric.mechanism.inverse import load_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.kernels import Samples, inverse_many
from bayesfric.mechanism.own_term import along
from bayesfric.mechanism.quantities import TOTALS, Parameter, State
from bayesfric.mechanism.scaling import scalings
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.recordings.signals import Signals

Term = tuple[int, float]  # a parameter's index, and its torque at the motor for a value of one

# Relative size below which a singular value of the regressors is rounding.
OPEN = 1e-9
# What is positive in any mechanism that loses energy; gravity's sign is that of Theta1.
POSITIVE = tuple(total.name for total in TOTALS.values() if total.lower == 0.0)
_NUMBERS_AT_ONCE = 2_000_000
# Samples of a recording up to which its layout for the kernels is kept: it takes longer than they.
_SHORT = 30_000


def filtered_torque(joint: Joint, observation: Signals, values: Array) -> Array:
    """Model the motor torque ``(n, n_outputs)`` of vectors ``(n, n_parameters)``, filtered."""
    o = observation
    samples = (_samples if o.q.size <= _SHORT else _samples.__wrapped__)(joint, o)
    out = np.empty((values.shape[0], o.filter.n_outputs))
    # a few vectors at a time: unfiltered torque of a long recording is large
    rows = max(1, _NUMBERS_AT_ONCE // max(o.q.size, 1))
    for first in range(0, values.shape[0], rows):
        part = slice(first, first + rows)
        out[part] = o.filter.apply(inverse_many(*joint.tables(values[part], o.inputs), samples))
    return out


@lru_cache(maxsize=32)
def _samples(joint: Joint, o: Signals) -> Samples:
    return joint.samples(o.q, o.qd, o.qdd, o.inputs, o.stamps)


def torque_jacobian(
    joint: Joint, observations: Sequence[Signals], values: Array, steps: Array
) -> Array:
    """Differentiate the filtered torque by the parameters: ``(n_outputs, n_parameters)``.

    The torque is linear in every parameter that adds to it, so one-sided differences are exact up
    to rounding except where a step changes the direction of power; of what only shapes terms they
    are central. Columns are zero where the step ``(n_parameters,)`` is.
    """
    moving = np.flatnonzero(steps)
    shifts = np.eye(values.size)[moving] * steps
    shaping = np.array([joint.parameters[k].row.role == "form" for k in moving], dtype=bool)
    vectors = np.concatenate([values[None], values + shifts, values - shifts[shaping]])
    blocks = []
    for o in observations:
        torque = filtered_torque(joint, o, vectors)
        middle, up, down = np.split(torque, [1, 1 + moving.size])
        difference = up - middle
        difference[shaping] = (up[shaping] - down) / 2.0
        block = np.zeros((o.filter.n_outputs, values.size))
        block[:, moving] = (difference / steps[moving, None]).T
        blocks.append(block)
    return np.concatenate(blocks)


def load_at_outputs(joint: Joint, o: Signals, values: Array) -> Array:
    """Compute the load's own torque ``(n_outputs,)`` at the middles of the outputs, eq. (3).

    N m or N at the joint.
    """
    at = o.filter.centres
    return load_torque(joint, values, o.q[at], o.acceleration, inputs=o.inputs, time=o.stamps[at])


def typical_load(
    joint: Joint, observations: Sequence[Signals], values: Array, quantile: float = 0.95
) -> float:
    """Give the joint torque at which efficiencies are stated: nearly the recordings' largest."""
    loads = [load_at_outputs(joint, o, values) for o in observations]
    return float(np.quantile(np.abs(np.concatenate(loads)), quantile))


def places(observations: Sequence[Signals], far: int = 2000) -> NDArray[np.int64]:
    """Give each output its place ``(n_outputs,)`` on an even grid of time, segments far apart.

    Outputs further apart than ``far`` are taken to be independent.
    """
    numbers, first = [], 0
    for o in observations:
        step = max(int(np.diff(o.filter.starts).min(initial=len(o.filter.taps))), 1)
        raw = o.filter.starts // step
        # a gap of a tenth of the recording separates segments, at most what any kernel spans
        gap = min(int(raw[-1] - raw[0]) // 10 + 1, far)
        numbers.append(raw - raw[0] + o.segment_of * gap + first)
        first = int(numbers[-1][-1]) + gap
    return np.concatenate(numbers)


@dataclass(frozen=True, eq=False)
class TorqueForm:
    """How a joint's parameters make up ``Theta1`` and ``Theta2`` of eq. (13).

    ``lambda_1 = (1/alpha_1 + 1/alpha_2)/2``, ``lambda_2 = (1/alpha_1 - 1/alpha_2)/2``, and ``Theta1
    = front + lambda_1 behind``, ``Theta2 = lambda_2 behind``, column by column. ``-Theta2`` makes
    the same torque.
    """

    chain: Joint  # The mechanism
    # Columns of psi that Theta1 and Theta2 multiply, those of TOTALS in motor units as the paper's;
    # offset.<recording> is one in that recording, added_load the torque of the known load at the
    # motor, whose coefficients are lambda_1 and lambda_2
    names1: tuple[str, ...]
    names2: tuple[str, ...]
    # Of each column the parameters up to the gearbox, and behind it, with their torque at the motor
    # for a value of one
    front: Mapping[str, list[Term]] = field(repr=False)
    behind: Mapping[str, list[Term]] = field(repr=False)
    loss: str  # Name of the element with load-dependent friction; empty for none

    def thetas(self, values: Array) -> tuple[Array, Array]:
        """Compute ``Theta1`` and ``Theta2`` of eq. (13) from a vector ``(n_parameters,)``."""
        lambda1, lambda2 = 1.0, 0.0
        if self.loss:
            point = dict(zip(self.chain.names, values.tolist(), strict=True))
            common = point.get(f"{self.loss}.load", 0.0)
            driving = point.get(f"{self.loss}.load_drive", common)
            driven = point.get(f"{self.loss}.load_back", common)
            lambda1, lambda2 = (2.0 + driving - driven) / 2.0, (driving + driven) / 2.0
        leg = self._sums(self.behind, values)
        motor = self._sums(self.front, values)
        theta1 = [motor.get(name, 0.0) + lambda1 * leg.get(name, 0.0) for name in self.names1]
        return np.array(theta1), np.array([lambda2 * leg.get(name, 0.0) for name in self.names2])

    def parameters(
        self, theta1: Array, theta2: Array, fixed: Mapping[str, float] | None = None
    ) -> Array:
        """Compute a vector from ``Theta1`` and ``Theta2``; exact where these have one.

        ``lambda_1/lambda_2`` comes from the columns that only the load fills (``theta5/theta10``),
        then motor = ``Theta1 - (lambda_1/lambda_2) Theta2`` and leg = ``Theta2/lambda_2``. The
        scale comes from the known mass, a ``fixed`` parameter, or is the middle of what a passive
        gearbox allows.
        """
        totals1 = dict(zip(self.names1, theta1.tolist(), strict=True))
        totals2 = dict(zip(self.names2, theta2.tolist(), strict=True))
        values = np.zeros(len(self.chain.names))
        rho = self._ratio(totals1, totals2)
        # one mu for both directions means lambda_1 = 1; with two it is a place to start
        lambda1, lambda2 = 1.0, 1.0 / rho
        single = f"{self.loss}.load" in self.chain.names
        if "added_load" in totals2 and not single and totals2["added_load"] > 0.0:
            lambda1, lambda2 = rho * totals2["added_load"], totals2["added_load"]
        self._spread(self.behind, {k: v / lambda2 for k, v in totals2.items()}, values)
        self._spread(
            self.front, {k: v - rho * totals2.get(k, 0.0) for k, v in totals1.items()}, values
        )
        if single:
            values[self.chain.names.index(f"{self.loss}.load")] = lambda2
        elif self.loss:
            values[self.chain.names.index(f"{self.loss}.load_drive")] = lambda1 + lambda2 - 1.0
            values[self.chain.names.index(f"{self.loss}.load_back")] = 1.0 - (lambda1 - lambda2)
        if "added_load" not in totals2:
            values = scale_known(self.chain, values, fixed or {})
        for name, value in (fixed or {}).items():
            values[self.chain.names.index(name)] = value
        return values

    def _sums(self, terms: Mapping[str, list[Term]], values: Array) -> dict[str, float]:
        """Sum each column; an angle turns gravity into a sine and a cosine column."""
        sums = {k: sum(values[i] * c for i, c in members) for k, members in terms.items()}
        if "gravity_cosine" in sums:
            angle = float(values[_angle(self.chain)[0]])
            sums["gravity_cosine"] = sums["gravity"] * math.sin(angle)
            sums["gravity"] *= math.cos(angle)
        if terms is self.behind:
            sums["added_load"] = 1.0
        return sums

    def _ratio(self, totals1: Mapping[str, float], totals2: Mapping[str, float]) -> float:
        """``lambda_1/lambda_2`` from columns of the load alone, else with all parts positive."""
        load_only = [k for k in totals2 if k in totals1 and not self.front.get(k)]
        # the known mass counts by itself; gravity's two parts in one unit
        for group in (["added_load"], ["gravity", "gravity_cosine"], load_only):
            pairs = [(totals1[k], totals2[k]) for k in group if k in load_only]
            squares = sum(b * b for _, b in pairs)
            if squares > 0.0:
                return max(sum(a * b for a, b in pairs) / squares, 0.1)
        shares = [
            totals1[k] / totals2[k] for k in POSITIVE if totals2.get(k, 0.0) > 0.0 and k in totals1
        ]
        return max(0.5 * min(shares, default=4.0), 1.0)

    def _spread(
        self, terms: Mapping[str, list[Term]], totals: Mapping[str, float], values: Array
    ) -> None:
        """Distribute column totals over their parameters."""
        if "gravity_cosine" in terms and "gravity" in totals:
            sine, cosine = totals["gravity"], totals.get("gravity_cosine", 0.0)
            sign = math.copysign(1.0, self.chain.load.gravity)
            angle = math.atan2(sign * cosine, sign * sine)
            values[_angle(self.chain)[0]] = angle
            totals = {**totals, "gravity": sign * math.hypot(sine, cosine)}
        for kind, members in terms.items():
            if kind != "gravity_cosine":
                for i, c in members:
                    values[i] += totals.get(kind, 0.0) / (len(members) * c)


def scale_known(joint: Joint, values: Array, fixed: Mapping[str, float]) -> Array:
    """Scale a vector until a fixed parameter has its value, else to the middle of the range."""
    for scaling in scalings(joint):
        factors = (scaling.factor_to(values, n, fixed[n]) for n in scaling.names if n in fixed)
        reached = (factor for factor in factors if 0.0 < factor < math.inf)
        values = scaling.scaled(values, next(reached, None) or scaling.middle(values))
    return values


def _angle(joint: Joint) -> list[int]:
    """Index of the gravity angle, if there is one."""
    return [i for i, p in enumerate(joint.parameters) if p.circular]


def torque_form(
    joint: Joint, observations: Sequence[Signals] = (), *, any_shape: bool = False
) -> TorqueForm | None:
    """Write a joint's torque in the form of eq. (13).

    Parameters
    ----------
    joint
        The mechanism.
    observations
        Whose known mass has separate columns, ``added_load``, if their motion identifies it.
    any_shape
        Leave out what only shapes or scales terms, as a Stribeck rise and the gain: the form is
        that of the others, times the gain.

    Returns
    -------
    TorqueForm or None
        None for a joint with several load-dependent elements, or with a known load at an unknown
        angle; unless ``any_shape``, also with an unknown gain or whatever shapes a term (Stribeck
        rise, exponent, load-dependent friction by direction or growing with speed): these are not
        of the form.
    """
    lossy = [i for i, e in enumerate(joint.elements) if e.load_loss != "none"]
    angled = bool(_angle(joint))
    masses = any(o.inputs.known_load for o in observations)
    shaped = any(p.row.role == "form" and not p.circular for p in joint.parameters)
    if len(lossy) > 1 or (shaped and not any_shape) or (angled and masses):
        return None
    last = lossy[0] if lossy else len(joint.elements)
    in_front = {"drive", *(element.name for element in joint.elements[: last + 1])}
    in_front |= set() if lossy else {"load"}
    front: dict[str, list[Term]] = {}
    behind: dict[str, list[Term]] = {}
    for i, p in enumerate(joint.parameters):
        if p.owner:  # offsets follow
            side = front if p.owner in in_front else behind
            for kind, c in filled_columns(joint, p):
                side.setdefault(kind, []).append((i, c))
    if angled:  # it turns gravity's two columns, see _sums
        for side in (front, behind):
            if "gravity" in side:
                side["gravity_cosine"] = side["gravity"]
    for name in joint.offset_names:
        front[name] = [(joint.names.index(name), 1.0)]
    order = column_names(joint)
    names1 = tuple(k for k in order if k in front or k in behind)
    names2 = tuple(k for k in order if k in behind)
    if masses and lossy:
        plain = np.concatenate([columns(joint, o, names2) for o in observations], axis=1)
        known = np.concatenate([columns(joint, o, ("added_load",)) for o in observations], axis=1)
        # one mass everywhere may be collinear with the leg: then it has no column
        if _rank(np.concatenate([plain, known])) > _rank(plain):
            names2 = (*names2, "added_load")
            names1 += ("added_load",) if joint.elements[last].load_loss == "two" else ()
    return TorqueForm(
        joint, names1, names2, front, behind, joint.elements[last].name if lossy else ""
    )


def filled_columns(joint: Joint, p: Parameter) -> tuple[tuple[str, float], ...]:
    """Columns one parameter fills, and its torque at the motor there for a value of one.

    Through a ratio of n from motor to owner, a term of the power k of motion, ``power`` of its row,
    comes to ``n**-(k + 1)`` at the motor: an inertia to ``J/n²``, Coulomb friction to ``C/n``.
    """
    if p.row.role != "own":
        return ()
    if p.row.power is None or not {kind for kind, _ in p.row.fills} <= TOTALS.keys():
        return ((p.name, 1.0),)
    # speed of the motor over that of its shaft
    factor = (joint.ratio / joint.reaches[p.owner]) ** -(p.row.power + 1)
    if p.quantity == "first_moment":
        factor *= joint.load.gravity
    return tuple((kind, weight * factor) for kind, weight in p.row.fills)


def column_names(joint: Joint) -> list[str]:
    """Names of all possible columns, in the order of the paper's theta."""
    offsets = joint.offset_names or ("offset",)
    order = [k for kind in TOTALS for k in (offsets if kind == "offset" else (kind,))]
    return list(dict.fromkeys([*order, *joint.names]))


def columns(joint: Joint, observation: Signals, names: Iterable[str]) -> Array:
    """Compute columns of ``psi`` of eq. (13) in motor units, before filtering: ``(n, N)``."""
    o, n = observation, joint.ratio
    inertia, moment = o.inputs.load(joint.load.motion)
    sine = np.sin(o.q)
    applied = 0.0 if o.inputs.load_torque is None else o.inputs.load_torque.at(o.stamps)
    state = State(
        n * o.q,
        n * o.qd,
        n * o.qdd,
        np.sign(o.qd),
        o.stamps,
        transmitted=(inertia * o.qdd + joint.load.gravity * moment * sine - applied) / n,
        gravity=sine,
    )

    def column(name: str) -> Array:
        if name in TOTALS and (total := TOTALS[name].column) is not None:
            cosine = name == "gravity_cosine"
            return np.asarray(total(state._replace(gravity=np.cos(o.q)) if cosine else state))
        if name in joint.offset_names:
            return np.full_like(o.q, name == f"offset.{o.inputs.recording}")
        p = joint.parameters[joint.names.index(name)]
        reach = joint.reaches[p.owner]
        return along(p.row, reach, o.q, o.qd, o.stamps, o.inputs) * (reach / n)

    rows = [column(name) for name in names]
    return np.stack(rows) if rows else np.empty((0, o.q.size))


def minimum_norm(regressors: Array) -> tuple[Array, Flags, Array, Array]:
    """Solve a linear least-squares problem ``(n, k)`` once for all targets.

    Gives the columns' norms ``(k,)``, which of them are collinear with others ``(k,)``, the map
    from targets to the minimum-norm solution ``(k, n)``, and an orthonormal basis of the columns.
    """
    norms = np.linalg.norm(regressors, axis=0)
    norms[norms == 0.0] = 1.0
    left, singular, right = np.linalg.svd(regressors / norms, full_matrices=False)
    identified = singular > OPEN * singular.max(initial=0.0)
    solution = (right[identified].T / singular[identified]) @ left.T[identified] / norms[:, None]
    return (
        norms,
        np.asarray((right[~identified] ** 2).sum(axis=0) > 1e-8),
        solution,
        left[:, identified],
    )


def _rank(rows: Array) -> int:
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    triangle = np.linalg.qr((rows / np.where(size > 0.0, size, 1.0)).T, mode="r")
    singular = np.linalg.svd(triangle, compute_uv=False)
    return int(np.count_nonzero(singular > OPEN * singular.max(initial=0.0)))


class VariableProjection:
    """The criterion (12) as a function of ``Theta2`` alone.

    Parameters
    ----------
    form
        Of the joint with the same observations.
    observations
        Recordings, prepared.

    Attributes
    ----------
    scale
        ``(n2,)`` norm of each column of psi that ``Theta2`` multiplies.

    Notes
    -----
    Model and measurement have passed the same linear filter, so (18) holds with filtered
    regressors. The columns of ``Theta1`` do not depend on ``Theta2``, so the derivative of the
    projected residual is the projected derivative, exactly.

    References
    ----------
    Golub and Pereyra, SIAM Journal on Numerical Analysis 10, 1973.
    """

    def __init__(self, form: TorqueForm, observations: Sequence[Signals]) -> None:
        self.form, self._observations = form, observations
        joint = form.chain
        self._psi2 = [columns(joint, o, form.names2) for o in observations]
        self._sign = [np.sign(o.qd) for o in observations]
        target, regressors = [], []
        two_losses = f"{form.loss}.load_drive" in joint.names
        for o in observations:
            known = np.zeros_like(o.measured)
            if o.inputs.known_load and "added_load" not in form.names1 and not two_losses:
                # lambda_1 is one: what the known load takes is known
                known = o.filter.apply(columns(joint, o, ("added_load",)))[0]
            target.append(o.measured - known)
            regressors.append(o.filter.apply(columns(joint, o, form.names1)))
        self._target = np.concatenate(target)
        *_, self._solution, self._range = minimum_norm(np.concatenate(regressors, axis=1).T)
        norms = np.sqrt(sum(((p**2).sum(axis=1) for p in self._psi2), np.zeros(len(form.names2))))
        self.scale: Array = np.where(norms > 0.0, norms, 1.0)

    def theta1(self, theta2: Array) -> Array:
        """Best ``Theta1`` ``(n1,)`` given ``Theta2`` ``(n2,)``, eq. (18).

        ``(psi' psi)^-1 psi' (torque - sign(qd) |psi Theta2|)``; of minimum norm if columns are
        collinear.
        """
        return np.asarray(self._solution @ (self._target - self._folded(theta2)))

    def residual(self, theta2: Array) -> Array:
        """Measured minus modelled torque at the best ``Theta1``, ``(n_outputs,)``, N m or N."""
        return self._outside(self._target - self._folded(theta2))

    def jacobian(self, theta2: Array) -> Array:
        """Differentiate :meth:`residual` by ``Theta2``, ``(n_outputs, n2)``; ``psi1`` of (17)."""
        blocks = [
            o.filter.apply(sign * np.sign(theta2 @ psi2) * psi2)
            for o, sign, psi2 in zip(self._observations, self._sign, self._psi2, strict=True)
        ]
        return -self._outside(np.concatenate(blocks, axis=1).T)

    def criterion(self, theta2: Array) -> float:
        """Sum of squares (12) at the best ``Theta1``."""
        residual = self.residual(theta2)
        return float(residual @ residual)

    def minimise(self, starts: Sequence[Array]) -> tuple[Array, Array, int]:
        """Solve eq. (19): search from several ``Theta2`` ``(n2,)`` (Levenberg-Marquardt).

        Gives ``Theta1`` and ``Theta2``, of this and its negative, which make the same torque, the
        physical one, and how many starts reached that minimum.
        """
        settings: Any = {"method": "lm", "x_scale": 1.0 / self.scale, "max_nfev": 100}
        settings |= {"xtol": 1e-12, "ftol": 1e-12, "gtol": 1e-14}
        # a start of zero would sit on the fold of |psi Theta2|
        unfolded = [np.where(start == 0.0, 1e-6 / self.scale, start) for start in starts]
        ends = [np.zeros(0)]
        if self.form.names2:
            ends = [least_squares(self.residual, x, self.jacobian, **settings).x for x in unfolded]
        heights = np.array([self.criterion(theta2) for theta2 in ends])
        best = int(np.argmin(heights))
        limit = (1.0 + 1e-6) * heights[best] + 1e-20 * float(self._target @ self._target)
        theta2 = self._signed(ends[best])
        return self.theta1(theta2), theta2, int(np.count_nonzero(heights <= limit))

    def _signed(self, theta2: Array) -> Array:
        """Of the two equal solutions give the one with ``Jc > 0`` and ``alpha_2 > alpha_1``.

        Every loss and inertia is positive then; where noise has turned a sign, the larger torques
        decide.
        """
        totals1 = dict(zip(self.form.names1, self.theta1(theta2), strict=True))
        score = 0.0
        for name, value in zip(self.form.names2, theta2 * self.scale, strict=True):
            if name in POSITIVE:
                score += value
            elif name.startswith("gravity"):
                score += value * np.sign(totals1[name])
        return -theta2 if score < 0.0 else theta2

    def _folded(self, theta2: Array) -> Array:
        """``sign(qd) |psi Theta2|``, filtered."""
        blocks = [
            o.filter.apply(sign * np.abs(theta2 @ psi2))
            for o, sign, psi2 in zip(self._observations, self._sign, self._psi2, strict=True)
        ]
        return np.concatenate(blocks)

    def _outside(self, x: Array) -> Array:
        """Project off what ``psi Theta1`` explains."""
        return np.asarray(x - self._range @ (self._range.T @ x))
