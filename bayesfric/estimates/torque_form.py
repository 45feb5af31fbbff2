"""The torque as ``psi Theta1 + sign(qd) |psi Theta2|``, eq. (13), and the way back to parameters.

Chains with at most one load-dependent element and no Stribeck rise have this form wherever they
move; at standstill the mechanism has no loss, while eq. (13) leaves ``lambda_1``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.own_term import along
from bayesfric.mechanism.quantities import TOTALS, Parameter, State
from bayesfric.mechanism.scaling import scalings
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.recordings.observation import Observation

Term = tuple[int, float]  # a parameter's index, and its torque at the motor for a value of one

# Relative size below which a singular value of the regressors is rounding.
OPEN = 1e-9
# What is positive in any mechanism that loses energy; gravity's sign is that of Theta1.
POSITIVE = tuple(total.name for total in TOTALS.values() if total.lower == 0.0)


@dataclass(frozen=True, eq=False)
class TorqueForm:
    """How a chain's parameters make up ``Theta1`` and ``Theta2`` of eq. (13).

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


def scale_known(chain: Joint, values: Array, fixed: Mapping[str, float]) -> Array:
    """Scale a vector until a fixed parameter has its value, else to the middle of the range."""
    for scaling in scalings(chain):
        factors = (scaling.factor_to(values, n, fixed[n]) for n in scaling.names if n in fixed)
        reached = (factor for factor in factors if 0.0 < factor < math.inf)
        values = scaling.scaled(values, next(reached, None) or scaling.middle(values))
    return values


def _angle(chain: Joint) -> list[int]:
    """Index of the gravity angle, if there is one."""
    return [i for i, p in enumerate(chain.parameters) if p.circular]


def torque_form(
    chain: Joint, observations: Sequence[Observation] = (), *, any_shape: bool = False
) -> TorqueForm | None:
    """Write a chain's torque in the form of eq. (13).

    Parameters
    ----------
    chain
        The mechanism.
    observations
        Whose known mass has separate columns, ``added_load``, if their motion identifies it.
    any_shape
        Leave out what only shapes or scales terms, as a Stribeck rise and the gain: the form is
        that of the others, times the gain.

    Returns
    -------
    TorqueForm or None
        None for a chain with several load-dependent elements, or with a known load at an unknown
        angle; unless ``any_shape``, also with an unknown gain or whatever shapes a term (Stribeck
        rise, exponent, load-dependent friction by direction or growing with speed): these are not
        of the form.
    """
    lossy = [i for i, e in enumerate(chain.elements) if e.load_loss != "none"]
    angled = bool(_angle(chain))
    masses = any(o.inputs.known_load for o in observations)
    shaped = any(p.row.role == "form" and not p.circular for p in chain.parameters)
    if len(lossy) > 1 or (shaped and not any_shape) or (angled and masses):
        return None
    last = lossy[0] if lossy else len(chain.elements)
    in_front = {"drive", *(element.name for element in chain.elements[: last + 1])}
    in_front |= set() if lossy else {"load"}
    front: dict[str, list[Term]] = {}
    behind: dict[str, list[Term]] = {}
    for i, p in enumerate(chain.parameters):
        if p.owner:  # offsets follow
            side = front if p.owner in in_front else behind
            for kind, c in filled_columns(chain, p):
                side.setdefault(kind, []).append((i, c))
    if angled:  # it turns gravity's two columns, see _sums
        for side in (front, behind):
            if "gravity" in side:
                side["gravity_cosine"] = side["gravity"]
    for name in chain.offset_names:
        front[name] = [(chain.names.index(name), 1.0)]
    order = column_names(chain)
    names1 = tuple(k for k in order if k in front or k in behind)
    names2 = tuple(k for k in order if k in behind)
    if masses and lossy:
        plain = np.concatenate([columns(chain, o, names2) for o in observations], axis=1)
        known = np.concatenate([columns(chain, o, ("added_load",)) for o in observations], axis=1)
        # one mass everywhere may be collinear with the leg: then it has no column
        if _rank(np.concatenate([plain, known])) > _rank(plain):
            names2 = (*names2, "added_load")
            names1 += ("added_load",) if chain.elements[last].load_loss == "two" else ()
    return TorqueForm(
        chain, names1, names2, front, behind, chain.elements[last].name if lossy else ""
    )


def filled_columns(chain: Joint, p: Parameter) -> tuple[tuple[str, float], ...]:
    """Columns one parameter fills, and its torque at the motor there for a value of one.

    Through a ratio of n from motor to owner, a term of the power k of motion, ``power`` of its row,
    comes to ``n**-(k + 1)`` at the motor: an inertia to ``J/n²``, Coulomb friction to ``C/n``.
    """
    if p.row.role != "own":
        return ()
    if p.row.power is None or not {kind for kind, _ in p.row.fills} <= TOTALS.keys():
        return ((p.name, 1.0),)
    # speed of the motor over that of its shaft
    factor = (chain.ratio / chain.reaches[p.owner]) ** -(p.row.power + 1)
    if p.quantity == "first_moment":
        factor *= chain.load.gravity
    return tuple((kind, weight * factor) for kind, weight in p.row.fills)


def column_names(chain: Joint) -> list[str]:
    """Names of all possible columns, in the order of the paper's theta."""
    offsets = chain.offset_names or ("offset",)
    order = [k for kind in TOTALS for k in (offsets if kind == "offset" else (kind,))]
    return list(dict.fromkeys([*order, *chain.names]))


def columns(chain: Joint, observation: Observation, names: Iterable[str]) -> Array:
    """Compute columns of ``psi`` of eq. (13) in motor units, before filtering: ``(n, N)``."""
    o, n = observation, chain.ratio
    inertia, moment = o.inputs.load(chain.load.motion)
    sine = np.sin(o.q)
    applied = 0.0 if o.inputs.load_torque is None else o.inputs.load_torque.at(o.stamps)
    state = State(
        n * o.q,
        n * o.qd,
        n * o.qdd,
        np.sign(o.qd),
        o.stamps,
        transmitted=(inertia * o.qdd + chain.load.gravity * moment * sine - applied) / n,
        gravity=sine,
    )

    def column(name: str) -> Array:
        if name in TOTALS and (total := TOTALS[name].column) is not None:
            cosine = name == "gravity_cosine"
            return np.asarray(total(state._replace(gravity=np.cos(o.q)) if cosine else state))
        if name in chain.offset_names:
            return np.full_like(o.q, name == f"offset.{o.inputs.recording}")
        p = chain.parameters[chain.names.index(name)]
        reach = chain.reaches[p.owner]
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
