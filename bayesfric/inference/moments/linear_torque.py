"""The torque as a linear function of a few coefficients, for known directions of power.

With the load's torque ``T = psi2 l`` at the gearbox (``l`` the load's parameters in motor units)
the motor torque is ``psi1 Theta1 + sign(qd) sign(T) psi2 Theta2``, eq. (13): its sign is that of
``l`` for any sign of lambda_2, so this holds for negative coefficients of load-dependent friction,
too. At exact standstill the mechanism has no loss while eq. (13) leaves ``lambda_1 T``; separate
columns for those samples correct that. An unknown gain divides all coefficients.

A function of speed that multiplies a loss (a Stribeck rise, a load-dependent friction that grows
with speed or depends on direction) multiplies its columns; the law itself is evaluated for it: with
``mu_1`` and ``mu_2`` sums of such functions ``phi``, so are ``lambda_1`` and ``lambda_2``. A
function of unknown shape is interpolated, :mod:`bayesfric.inference.moments.shape_nodes`. A square
of the load has the products of the columns of ``psi2``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayesfric.estimates.torque import Term, columns, filled_columns, torque_form
from bayesfric.inference.moments.shape_nodes import ShapeNodes
from bayesfric.mechanism.chain import slots_of
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.kernels import load_losses
from bayesfric.mechanism.parameter import Parameter
from bayesfric.mechanism.quantities import State
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

Along = Callable[[Observation], Array]  # (m, n) functions of the motion along a piece of it
Weights = Callable[[Array], Array]  # (n, m) what multiplies them, for parameter vectors
T = TypeVar("T")

# Gravity on a known mass at angle zero and a quarter turn on, and factors by an unknown angle: at
# angle zero the first is in the known load's own column.
_TURNED = "added_sine", "added_cosine"
_TURNS: dict[str, Weights] = {
    "gravity": np.cos,
    "gravity_cosine": np.sin,
    "added_sine": lambda angle: np.cos(angle) - 1.0,
    "added_cosine": np.sin,
}
# Samples of a recording from which the size of its columns is estimated.
_TYPICAL_SAMPLES = 20_000
# Speeds that distinguish functions, rad/s or m/s.
_TEST_SPEEDS = np.array([1.0, -1.0, 0.3, -0.3, 7.0, -7.0])


@dataclass(frozen=True)
class Coefficients:
    """Coefficients of the columns for ``n`` parameter vectors."""

    # (n, K): one for the measured torque, minus Theta1, then minus Theta2 and minus the remaining
    # lambda_1 with each function of speed, minus those of the squared load, and, at standstill,
    # minus (1 - lambda_1) l. Columns times this are residuals
    all: Array
    # (n, n2) load parameters l; sign(psi2 l) is the direction of the load's torque
    leg: Array
    lambda2: Array  # (n, m), with each function of speed
    inside: NDArray[np.bool_]  # (n,) whether unknown shapes are in their ranges


@dataclass(frozen=True, eq=False)
class _Group:
    """Columns of :func:`bayesfric.estimates.torque.columns`, each times some functions."""

    along: Along
    weights: Weights
    front: Array  # (n_parameters, columns) coefficients in front of and behind the gearbox
    behind: Array
    used: tuple[int, ...]  # columns that exist

    @property
    def of_leg(self) -> tuple[int, ...]:
        """Columns that exist behind the gearbox."""
        return tuple(j for j in self.used if self.behind[:, j].any())


@dataclass(frozen=True, eq=False)
class _Loss:
    """Functions of the motion that multiply the load loss, and their share of mu_1 and mu_2."""

    along: Along
    drive: Weights
    back: Weights


class LinearTorque:
    """Columns and coefficients of a mechanism's torque, near draws ``(n, n_parameters)``."""

    def __init__(self, chain: Joint, observations: Sequence[Observation], draws: Array) -> None:
        form = torque_form(chain, any_shape=True)
        if form is None:
            raise ValueError("the chain's torque is not of the form of eq. (13)")
        self.chain = chain
        self._pieces = [
            _piece(o, slice(None, None, max(1, o.q.size // _TYPICAL_SAMPLES))) for o in observations
        ]
        self._draws = draws
        self._at = {name: i for i, name in enumerate(chain.names)}
        angle = self._at.get("load.gravity_angle", -1)
        load_names: tuple[str, ...] = ()
        if any(o.inputs.known_load for o in observations):
            load_names = ("added_load", *(_TURNED if angle >= 0 else ()))
        self._names = (*form.names1, *load_names)
        front, behind = self._matrix(form.front), self._matrix(form.behind)
        self._known = np.zeros((2, len(self._names)))
        if load_names:
            self._known[1 if form.loss else 0, len(form.names1) :] = 1.0
        # columns that depend on an unknown angle, and their factors
        self._angle = angle
        self._turned = [(self._names.index(k), f) for k, f in _TURNS.items() if k in self._names]
        self._gain = self._at["drive.gain"] if chain.gain else -1
        self.shapes: list[ShapeNodes] = []
        self._groups = list(self._all_groups(front, behind))
        function_only = {j for group in self._groups[1:] for j in group.used} - {
            *self._groups[0].used
        }
        self._direct = [j for j in range(len(self._names)) if j not in function_only]
        # one sample suffices to count functions
        one_sample = _piece(observations[0], slice(1))
        columns = [
            (g, j)
            for g, group in enumerate(self._groups)
            for j in group.used
            for _ in group.along(one_sample)
        ]
        self.names1 = tuple(self._names[j] for _, j in columns)
        self._leg_columns = [i for i, (g, j) in enumerate(columns) if self._is_leg(form.loss, g, j)]
        self.names2 = tuple(self.names1[i] for i in self._leg_columns)
        # no gain divides terms of the recorded torque itself
        self._joints = [i for i, n in enumerate(self.names1) if not n.startswith("drive.")]
        self._losses = list(self._all_losses(form.loss))
        self._square, self._before = -1, 1.0
        if f"{form.loss}.load_square" in self._at:
            self._square = self._at[f"{form.loss}.load_square"]
            self._before = chain.ratio / chain.reaches[form.loss]
        self.functions_of_speed = len(self.functions(observations[0], 0, 1))
        n2 = len(self.names2)
        two_losses = bool(form.loss) and f"{form.loss}.load" not in self._at
        self.rest = two_losses and any(bool((o.qd == 0.0).any()) for o in observations)
        self._pairs = np.triu_indices(n2) if self._square >= 0 else (np.zeros(0, int),) * 2
        self.size = 1 + len(self.names1) + n2 * (2 * self.functions_of_speed - 1)
        self.size += self._pairs[0].size + (n2 if self.rest else 0)

    def _matrix(self, terms: Mapping[str, list[Term]]) -> Array:
        out = np.zeros((len(self.chain.names), len(self._names)))
        for name, entries in terms.items():
            for i, factor in entries:
                out[i, self._names.index(name)] += factor
        return out

    def _is_leg(self, loss: str, group: int, column: int) -> bool:
        if not loss:
            return False
        is_known_load = group == 0 and self._known[1, column] != 0.0
        return is_known_load or column in self._groups[group].of_leg

    def _all_groups(self, front: Array, behind: Array) -> Iterator[_Group]:
        """Yield plain columns, those of unknown shape, and those with a Stribeck rise."""
        shaped = [p for p in self.chain.parameters if p.row.role == "own" and p.row.shape]
        shaped_columns = [self._names.index(p.name) for p in shaped]
        plain_columns = tuple(j for j in range(len(self._names)) if j not in shaped_columns)
        yield _Group(_constant, _ones, front, behind, plain_columns)
        for p, j in zip(shaped, shaped_columns, strict=True):
            column = _shaped(self.chain, p)
            nodes = self._nodes(f"{p.owner}.{p.row.shape}", column)
            yield _Group(_each(column, nodes), _lagrange(nodes), front, behind, (j,))
        for element in self.chain.elements:
            rise = self._rise(element.name, "stribeck_ratio")
            if rise is None:
                continue
            along, weights = rise
            indices = [i for i, p in enumerate(self.chain.parameters) if p.owner == element.name]
            rows = [
                i
                for i in indices
                if self.chain.parameters[i].row.role == "own" and self.chain.parameters[i].row.rises
            ]
            rising = np.zeros((len(self.chain.names), 1))
            rising[rows] = 1.0
            kinds = {
                k for i in rows for k, _ in filled_columns(self.chain, self.chain.parameters[i])
            }
            used = tuple(self._names.index(k) for k in self._names if k in kinds)
            yield _Group(along, weights, front * rising, behind * rising, used)

    def _rise(self, element: str, slot: str) -> tuple[Along, Weights] | None:
        """Return functions and weights of an element's Stribeck rise."""
        ratio = [
            i
            for i, p in enumerate(self.chain.parameters)
            if p.owner == element and slot in slots_of(p)
        ]
        if not ratio:
            return None
        power = self._at.get(f"{element}.stribeck_exponent", -1)
        exponent = 2.0 if power < 0 else float(self._draws[0, power])
        reach = self.chain.reaches[element]

        def column(o: Observation, velocity: float) -> Array:
            return np.asarray(np.exp(-(np.abs(reach * o.qd / velocity) ** exponent)))

        nodes = self._nodes(f"{element}.stribeck_velocity", column)
        ratio_index, weights = ratio[0], _lagrange(nodes)
        return _each(column, nodes), lambda values: values[:, [ratio_index]] * weights(values)

    def _nodes(self, name: str, column: Callable[[Observation, float], Array]) -> ShapeNodes:
        """Choose nodes for an unknown shape by its name, shared by all its terms."""
        index = self._at[name]
        for shape in self.shapes:
            if shape.index == index:
                return shape
        p = self.chain.parameters[index]

        def everywhere(shape: float) -> Array:
            return np.concatenate([column(o, shape) for o in self._pieces])

        nodes = ShapeNodes.over(index, self._draws[:, index], (p.lower, p.upper), everywhere)
        self.shapes.append(nodes)
        return nodes

    def _all_losses(self, loss: str) -> Iterator[_Loss]:
        """Yield functions that the load loss is a sum of, constant first."""
        if not loss:
            yield _Loss(_constant, _zero, _zero)
            return
        steady, grown = (list(self._distinct_losses(loss, part)) for part in (0, 1))
        yield from steady
        rise = self._rise(loss, "stribeck_load_ratio")
        if rise is not None:
            functions, weights = rise
            for steady_loss in steady:
                drive, back = _times(weights, steady_loss.drive), _times(weights, steady_loss.back)
                yield _Loss(_times(functions, steady_loss.along), drive, back)
        yield from grown

    def _distinct_losses(self, loss: str, part: int) -> Iterator[_Loss]:
        """Yield the distinct functions in one part of :func:`_losses`.

        The law is evaluated for one parameter at a time.
        """
        element = [e.name for e in self.chain.elements].index(loss)
        rows = self.chain.tables(np.eye(len(self.chain.names))).elements[:, element]
        reach = self.chain.reaches[loss]
        distinct: dict[tuple[float, ...], tuple[Along, Array]] = {}
        for i, row in enumerate(rows):
            for direction, losses in enumerate(_losses(row, _TEST_SPEEDS)[part]):
                for size in losses[losses != 0.0][:1]:  # at the first speed with a loss
                    shape = tuple((losses / size).round(12).tolist())
                    entry = (
                        _multiplier(row, reach, part, direction, size),
                        np.zeros((2, len(rows), 1)),
                    )
                    distinct.setdefault(shape, entry)[1][direction, i] = size
        for along, shares in distinct.values():
            yield _Loss(along, _sum(shares[0]), _sum(shares[1]))

    def coefficients(self, values: Array) -> Coefficients:
        """Compute the coefficients of parameter vectors ``(n, n_parameters)``, SI units.

        ``lambda_1 = 1 + (mu_1 - mu_2)/2`` and ``lambda_2 = (mu_1 + mu_2)/2``, for each function of
        speed.
        """
        n, k1 = values.shape[0], len(self.names1)
        motor, leg = (self._multiplied(values, behind) for behind in (False, True))
        behind = leg[:, self._leg_columns]
        inside = np.ones(n, dtype=np.bool_)
        for shape in self.shapes:
            inside &= shape.covers(values)
        all_coefficients = np.empty((n, self.size))
        all_coefficients[:, 0] = 1.0
        drive = np.concatenate([loss.drive(values) for loss in self._losses], axis=1)
        back = np.concatenate([loss.back(values) for loss in self._losses], axis=1)
        excess, lambda2 = 0.5 * (drive - back), 0.5 * (drive + back)
        all_coefficients[:, 1 : 1 + k1] = -(motor + leg) - excess[:, :1] * leg
        pieces = [-(lambda2[:, :, None] * behind[:, None, :]).reshape(n, -1)]
        pieces.append(-(excess[:, 1:, None] * behind[:, None, :]).reshape(n, -1))
        if self._square >= 0:
            i, j = self._pairs
            twice = np.where(i == j, 1.0, 2.0) * self._before
            pieces.append(-values[:, [self._square]] * twice * behind[:, i] * behind[:, j])
        if self.rest:
            pieces.append(excess[:, :1] * behind)
        all_coefficients[:, 1 + k1 :] = np.concatenate(pieces, axis=1)
        return self._measured(Coefficients(all_coefficients, behind, lambda2, inside), values)

    def _multiplied(self, values: Array, behind: bool) -> Array:
        """Compute coefficients of the columns of ``psi1``, in front of or behind the gearbox."""
        parts = []
        for g, group in enumerate(self._groups):
            products = values @ (group.behind if behind else group.front)
            if g == 0:
                products = products + self._known[int(behind)]
                if self._angle >= 0:
                    for j, factor in self._turned:
                        products[:, j] *= factor(values[:, self._angle])
            weights = group.weights(values)
            parts.append(
                (products[:, group.used, None] * weights[:, None, :]).reshape(len(values), -1)
            )
        return np.concatenate(parts, axis=1)

    def _measured(self, joint: Coefficients, values: Array) -> Coefficients:
        """Convert coefficients of the joint's torque to those of the measured one."""
        if self._gain < 0:
            return joint
        gain = values[:, self._gain]
        behind = range(1 + len(self.names1), joint.all.shape[1])
        joint.all[:, [*(1 + i for i in self._joints), *behind]] /= gain[:, None]
        return replace(joint, lambda2=joint.lambda2 / gain[:, None])

    def columns(self, o: Observation, begin: int, end: int) -> tuple[Array, Array]:
        """Compute ``psi1`` ``(n1, n)`` and ``psi2`` ``(n2, n)`` of samples, before the filter."""
        piece = _piece(o, slice(begin, end))
        base = self._known_columns(piece)
        blocks = [
            (base[list(group.used), None] * group.along(piece)[None]).reshape(-1, end - begin)
            for group in self._groups
        ]
        psi1 = np.concatenate(blocks)
        return psi1, psi1[self._leg_columns]

    def _known_columns(self, piece: Observation) -> Array:
        """Compute columns before functions multiply them, one if functions are all."""
        out = np.ones((len(self._names), piece.q.size))
        direct = [j for j in self._direct if self._names[j] not in _TURNED]
        out[direct] = columns(self.chain, piece, [self._names[j] for j in direct])
        if len(direct) < len(self._direct):  # a known mass at an unknown angle
            load = self.chain.load
            weight = load.gravity * piece.inputs.load(load.motion)[1] / self.chain.ratio
            for name, function in zip(_TURNED, (np.sin, np.cos), strict=True):
                out[self._names.index(name)] = weight * function(piece.q)
        return out

    def functions(self, o: Observation, begin: int, end: int) -> Array:
        """Compute functions of speed ``(m, n)`` of the load-dependent friction, constant first."""
        piece = _piece(o, slice(begin, end))
        return np.concatenate([loss.along(piece) for loss in self._losses])

    def rows(self, psi1: Array, psi2: Array, phi: Array, sign: Array, side: Array) -> Array:
        """Compute all columns ``(K - 1, n)`` but the measured torque, before the filter."""
        out = np.empty((self.size - 1, side.size))
        k, n2 = len(self.names1), len(self.names2)
        out[:k] = psi1
        for function in phi:
            np.multiply(sign * side * function, psi2, out=out[k : k + n2])
            k += n2
        for function in phi[1:]:
            np.multiply(np.abs(sign) * function, psi2, out=out[k : k + n2])
            k += n2
        i, j = self._pairs
        out[k : k + i.size] = sign * psi2[i] * psi2[j]
        if self.rest:
            np.multiply(sign == 0.0, psi2, out=out[k + i.size :])
        return out

    def typical_size(self) -> Array:
        """Rms ``(n2,)`` of each column of ``psi2``, one if it is zero."""
        total = np.zeros(len(self.names2))
        for o in self._pieces:
            total += (self.columns(o, 0, o.q.size)[1] ** 2).mean(axis=1)
        rms = np.sqrt(total / len(self._pieces))
        return np.where(np.isfinite(rms) & (rms > 0.0), rms, 1.0)


def linear_torque(
    chain: Joint, observations: Sequence[Observation], draws: Array | None = None
) -> LinearTorque | None:
    """Write the torque as linear for known directions of power, if possible."""
    values = np.empty((0, len(chain.names))) if draws is None else draws
    if torque_form(chain, any_shape=True) is None:
        return None
    for i, p in enumerate(chain.parameters):
        if p.quantity == "stribeck_exponent" and np.ptp(values[:, i]) > 0.0:
            return None
    return LinearTorque(chain, observations, values)


def _constant(o: Observation) -> Array:
    return np.ones((1, o.qd.size))


def _ones(values: Array) -> Array:
    return np.ones((values.shape[0], 1))


def _zero(values: Array) -> Array:
    return np.zeros((values.shape[0], 1))


@njit(cache=True)
def _losses(element: Array, speed: Array) -> Array:
    """Load losses ``(2, 2, n)``: with and without a rise, of each direction of power."""
    out = np.empty((2, 2, speed.size))
    for j in range(speed.size):
        v = speed[j]
        for part in range(2):
            out[part, 0, j], out[part, 1, j] = load_losses(element, np.sign(v), v, 1.0 - part)
        out[0, :, j] -= out[1, :, j]
    return out


def _multiplier(element: Array, reach: float, part: int, way: int, size: float) -> Along:
    """One function of :func:`_losses`, over its ``size``."""
    return lambda o: _losses(element, reach * o.qd)[part, way][None] / size


def _sum(share: Array) -> Weights:
    return lambda values: values @ share


def _times(a: Callable[[T], Array], b: Callable[[T], Array]) -> Callable[[T], Array]:
    return lambda at: a(at) * b(at)


def _lagrange(nodes: ShapeNodes) -> Weights:
    return lambda values: nodes.weights(values[:, nodes.index])


def _each(column: Callable[[Observation, float], Array], nodes: ShapeNodes) -> Along:
    return lambda o: nodes.along(lambda shape: column(o, shape))


def _shaped(chain: Joint, p: Parameter) -> Callable[[Observation, float], Array]:
    reach = chain.reaches[p.owner]

    def column(o: Observation, shape: float) -> Array:
        assert p.row.column is not None
        state = State(reach * o.q, reach * o.qd, 0.0, np.sign(o.qd), o.stamps, 0.0, 0.0)
        return np.asarray(p.row.column(state, shape) * (reach / chain.ratio))

    return column


def _piece(o: Observation, part: slice) -> Observation:
    return replace(o, q=o.q[part], qd=o.qd[part], qdd=o.qdd[part], stamps=o.stamps[part])
