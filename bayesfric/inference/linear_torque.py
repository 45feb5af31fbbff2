"""The torque as a linear function of a few coefficients, for known directions of power.

With the load's torque ``T = psi2 l`` at the gearbox (``l`` the load's parameters in motor units)
the motor torque is ``psi1 Theta1 + sign(qd) sign(T) psi2 Theta2``, eq. (13): its sign is that of
``l`` for any sign of lambda_2, so this holds for negative coefficients of load-dependent friction,
too. At exact standstill the mechanism has no loss while eq. (13) leaves ``lambda_1 T``; separate
columns for those samples correct that. An unknown gain divides all coefficients. A square of the
load has the products of the columns of ``psi2``.

A function of speed that multiplies a loss (a Stribeck rise, a load-dependent friction that grows
with speed or depends on direction) multiplies its columns: with ``mu_1`` and ``mu_2`` sums of such
functions ``phi``, so are ``lambda_1`` and ``lambda_2``. A function that depends smoothly on its
unknown shape (the speed of a Stribeck rise, the exponent of a power of speed, a time constant) is a
polynomial in it over the relevant range, by its values at Chebyshev nodes. The torque stays linear
in as many coefficients.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.polynomial import chebyshev

from bayesfric.estimates.torque import Term, TorqueForm, columns, filled_columns, torque_form
from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint, slots_of
from bayesfric.mechanism.quantities import Parameter, State
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.recordings.signals import Signals

T = TypeVar("T")
# (m, samples) functions along a recording, and (n, m) what multiplies them for parameter vectors
Functions = Callable[[Signals], Array]
Weights = Callable[[Array], Array]
ShapedColumn = Callable[[Signals, float], Array]  # (samples,) for a value of the shape

# Gravity on a known mass at angle zero and a quarter turn on, and factors by an unknown angle: at
# angle zero the first is in the known load's own column.
_TURNED = "added_sine", "added_cosine"
_TURNS: dict[str, Weights] = {
    "gravity": np.cos,
    "gravity_cosine": np.sin,
    "added_sine": lambda angle: np.cos(angle) - 1.0,
    "added_cosine": np.sin,
}
# Relative error of an interpolated column: 1e-3 in the log density if a term is a thousand times
# the noise in 10^5 samples.
ACCURACY = 1e-8


class Interpolation:
    """Chebyshev nodes of one unknown shape, and the range in which interpolation is accurate."""

    def __init__(self, index: int, low: float, high: float, count: int, *, log: bool) -> None:
        self.index = index  # of the shape among the parameters
        inverse: Callable[[Any], Any]
        self._scale: Callable[[Any], Any]
        self._scale, inverse = (np.log, np.exp) if log else (np.asarray, np.asarray)
        self._middle, self._half = 0.5 * (low + high), 0.5 * (high - low) or 1.0
        points = chebyshev.chebpts1(count)
        self.low, self.high = float(inverse(low)), float(inverse(high))
        self.nodes = inverse(self._middle + self._half * points)
        # (K, K): from values at the nodes to coefficients of Chebyshev polynomials
        self._coefficients = np.linalg.inv(chebyshev.chebvander(points, count - 1))
        # (K, r): columns at nodes are collinear, so few combinations suffice
        self._combinations = np.eye(count)

    @classmethod
    def over(
        cls,
        index: int,
        draws: Array,
        support: tuple[float, float],
        column: Callable[[float], Array],
    ) -> Interpolation:
        """Choose range and nodes for draws ``(n,)`` of the shape; a too wide range shrinks."""
        log = support[0] == 0.0 and not np.isfinite(support[1])
        t = np.log(draws[draws > 0.0]) if log else draws
        ends = (-np.inf, np.inf) if log else support
        middle = float(np.median(t))
        reach = 1.3 * float(np.abs(t - middle).max())
        while reach > 1e-5 * np.ptp(t):
            low, high = max(middle - reach, ends[0]), min(middle + reach, ends[1])
            for count in (8, 12, 16, 24, 32):
                shape = cls(index, low, high, count, log=log)
                at_nodes = np.stack([column(float(x)) for x in shape.nodes])
                if shape._error(column, at_nodes) < ACCURACY:
                    left, singular, _ = np.linalg.svd(at_nodes, full_matrices=False)
                    shape._combinations = left[:, singular > 0.1 * ACCURACY * singular[0]]
                    return shape
            reach *= 0.75
        return cls(index, middle, middle, 1, log=log)

    def _error(self, column: Callable[[float], Array], at_nodes: Array) -> float:
        """Return the largest relative error at the range's ends and between nodes."""
        between = 0.5 * (self.nodes[1:] + self.nodes[:-1])
        tested = np.concatenate([[self.low], between, [self.high]])
        exact = np.stack([column(float(x)) for x in tested])
        error = self._node_weights(tested) @ at_nodes - exact
        size = np.maximum(np.linalg.norm(exact, axis=1), 1e-300)
        return float(np.max(np.linalg.norm(error, axis=1) / size))

    def functions(self, column: ShapedColumn) -> Functions:
        """Return combinations ``(r, samples)`` of the columns at the nodes."""
        return lambda o: np.asarray(
            self._combinations.T @ np.stack([column(o, float(x)) for x in self.nodes])
        )

    def covers(self, values: Array) -> Flags:
        """Flag parameter vectors ``(n, n_parameters)`` with the shape in the range."""
        shape = values[:, self.index]
        return np.asarray((shape >= self.low) & (shape <= self.high))

    def weights(self, values: Array) -> Array:
        """Return the weights ``(n, r)`` of these combinations for parameter vectors."""
        return np.asarray(self._node_weights(values[:, self.index]) @ self._combinations)

    def _node_weights(self, shape: Array) -> Array:
        """Weights ``(n, K)`` of values at the nodes for shapes ``(n,)``."""
        with np.errstate(all="ignore"):  # outside the range any will do
            x = (self._scale(shape) - self._middle) / self._half
            powers = chebyshev.chebvander(x, self.nodes.size - 1)
        return np.asarray(powers @ self._coefficients)


class _Group(NamedTuple):
    """Columns of :func:`bayesfric.estimates.torque.columns`, each times some functions."""

    functions: Functions
    weights: Weights
    front: Array  # (n_parameters, columns) coefficients in front of and behind the gearbox
    behind: Array
    used: tuple[int, ...]  # columns that exist


class LinearTorque:
    """Columns and coefficients of a mechanism's torque, near draws ``(n, n_parameters)``."""

    def __init__(
        self, chain: Joint, form: TorqueForm, observations: Sequence[Signals], draws: Array
    ) -> None:
        self.chain, self._draws, self._loss = chain, draws, form.loss
        self._thinned = [
            _piece(o, slice(None, None, max(1, o.q.size // 20_000))) for o in observations
        ]
        self._at = {name: i for i, name in enumerate(chain.names)}
        self._angle = self._at.get("load.gravity_angle", -1)
        self._gain = self._at["drive.gain"] if chain.gain else -1
        self._square = self._at.get(f"{form.loss}.load_square", -1)
        load_names: tuple[str, ...] = ()
        if any(o.inputs.known_load for o in observations):
            load_names = ("added_load", *(_TURNED if self._angle >= 0 else ()))
        self._names = (*form.names1, *load_names)
        self._known = np.zeros((2, len(self._names)))  # in front of and behind the gearbox
        self._known[int(bool(form.loss)), len(form.names1) :] = 1.0
        self.shapes: list[Interpolation] = []
        self._shaped: tuple[int, ...] = ()  # columns that are functions alone
        self._groups = list(self._all_groups(form.front, form.behind))
        one_sample = _piece(observations[0], slice(1))
        group_columns = [
            (g, j)
            for g, group in enumerate(self._groups)
            for j in group.used
            for _ in group.functions(one_sample)
        ]
        self.names1 = tuple(self._names[j] for _, j in group_columns)
        self._leg_columns = [
            i
            for i, (g, j) in enumerate(group_columns)
            if self._groups[g].behind[:, j].any() or (g == 0 and self._known[1, j])
            if form.loss
        ]
        self.names2 = tuple(self.names1[i] for i in self._leg_columns)
        # functions of speed, and their share of mu_1 and mu_2, constant first
        self._losses = list(self._all_losses())
        self.functions_of_speed = len(self.functions(observations[0], 0, 1))
        n2 = len(self.names2)
        two_losses = bool(form.loss) and f"{form.loss}.load" not in self._at
        self.rest = two_losses and any(bool((o.qd == 0.0).any()) for o in observations)
        self._pairs = np.triu_indices(n2) if self._square >= 0 else (np.zeros(0, int),) * 2
        self.size = 1 + len(self.names1) + n2 * (2 * self.functions_of_speed - 1)
        self.size += self._pairs[0].size + (n2 if self.rest else 0)

    def _all_groups(
        self, front_terms: Mapping[str, list[Term]], behind_terms: Mapping[str, list[Term]]
    ) -> Iterator[_Group]:
        """Yield plain columns, those of unknown shape, and those with a Stribeck rise."""
        chain, parameters = self.chain, self.chain.parameters
        front, behind = np.zeros((2, len(parameters), len(self._names)))
        for matrix, terms in ((front, front_terms), (behind, behind_terms)):
            for name, entries in terms.items():
                for i, factor in entries:
                    matrix[i, self._names.index(name)] += factor
        shaped = {
            self._names.index(p.name): p for p in parameters if p.row.role == "own" and p.row.shape
        }
        self._shaped = tuple(shaped)
        plain = tuple(j for j in range(len(self._names)) if j not in shaped)
        yield _Group(_ones, lambda values: np.ones((len(values), 1)), front, behind, plain)
        for j, p in shaped.items():
            column = _shaped_column(chain, p)
            shape = self._interpolation(f"{p.owner}.{p.row.shape}", column)
            yield _Group(shape.functions(column), shape.weights, front, behind, (j,))
        for element in chain.elements:
            for functions, weights in self._rise(element.name, "stribeck_ratio"):
                rising = [
                    i
                    for i, p in enumerate(parameters)
                    if p.owner == element.name and p.row.role == "own" and p.row.rises
                ]
                kinds = {k for i in rising for k, _ in filled_columns(chain, parameters[i])}
                used = tuple(j for j, k in enumerate(self._names) if k in kinds)
                rises = np.zeros((len(parameters), 1))
                rises[rising] = 1.0
                yield _Group(functions, weights, front * rises, behind * rises, used)

    def _rise(self, element: str, slot: str) -> Iterator[tuple[Functions, Weights]]:
        """Yield functions and weights of an element's Stribeck rise, if it has one."""
        power = self._at.get(f"{element}.stribeck_exponent", -1)
        exponent = 2.0 if power < 0 else float(self._draws[0, power])
        reach = self.chain.reaches[element]

        def column(o: Signals, velocity: float) -> Array:
            return np.asarray(np.exp(-(np.abs(reach * o.qd / velocity) ** exponent)))

        for i, p in enumerate(self.chain.parameters):
            if p.owner == element and slot in slots_of(p):
                shape = self._interpolation(f"{element}.stribeck_velocity", column)
                yield shape.functions(column), lambda v: v[:, [i]] * shape.weights(v)  # noqa: B023
                return

    def _interpolation(self, name: str, column: ShapedColumn) -> Interpolation:
        """Choose nodes for an unknown shape by its name, shared by all its terms."""
        index = self._at[name]
        for shape in self.shapes:
            if shape.index == index:
                return shape
        p = self.chain.parameters[index]
        shape = Interpolation.over(
            index,
            self._draws[:, index],
            (p.lower, p.upper),
            lambda value: np.concatenate([column(o, value) for o in self._thinned]),
        )
        self.shapes.append(shape)
        return shape

    def _all_losses(self) -> Iterator[tuple[Functions, Weights, Weights]]:
        """Yield functions that the load losses are sums of, as in ``kernels.load_losses``."""
        if not self._loss:
            yield _ones, _zero, _zero
            return
        element = [e.name for e in self.chain.elements].index(self._loss)
        shares = self.chain.tables(np.eye(len(self._at))).elements[:, element]
        reach = self.chain.reaches[self._loss]

        def share(slot: int) -> Weights:
            return lambda values: values @ shares[:, [slot]]

        def times(a: Callable[[T], Array], b: Callable[[T], Array]) -> Callable[[T], Array]:
            return lambda x: a(x) * b(x)

        steady = [(_ones, share(kernels.LOAD_DRIVE), share(kernels.LOAD_BACK))]
        by_direction = kernels.LOAD_DRIVE_DIFFERENCE, kernels.LOAD_BACK_DIFFERENCE
        if shares[:, by_direction].any():
            drive, back = by_direction
            steady.append((lambda o: np.sign(o.qd)[None], share(drive), share(back)))
        yield from steady
        for rise, weights in self._rise(self._loss, "stribeck_load_ratio"):
            for functions, drives, backs in steady:
                yield times(rise, functions), times(weights, drives), times(weights, backs)
        if shares[:, kernels.LOAD_SPEED].any():
            grows = share(kernels.LOAD_SPEED)
            yield lambda o: np.abs(reach * o.qd)[None], grows, grows

    def coefficients(self, values: Array) -> tuple[Array, Array, Array, Flags]:
        """Compute the coefficients of parameter vectors ``(n, n_parameters)``, SI units.

        ``lambda_1 = 1 + (mu_1 - mu_2)/2`` and ``lambda_2 = (mu_1 + mu_2)/2``, for each function of
        speed. Returns

        - coefficients of all columns ``(n, K)``: one for the measured torque, minus Theta1, then
          minus Theta2 and minus the remaining lambda_1 with each function of speed, minus those of
          the squared load, and, at standstill, minus (1 - lambda_1) l. Columns times this are
          residuals;
        - load parameters l ``(n, n2)``: sign(psi2 l) is the direction of the load's torque;
        - ``lambda_2`` ``(n, m)`` with each function of speed;
        - whether unknown shapes are in their ranges, ``(n,)``.
        """
        n, k1 = len(values), len(self.names1)
        motor, leg = (self._multiplied(values, side) for side in (0, 1))
        behind = leg[:, self._leg_columns]
        inside = np.ones(n, dtype=np.bool_)
        for shape in self.shapes:
            inside &= shape.covers(values)
        drive = np.concatenate([drive(values) for _, drive, _ in self._losses], axis=1)
        back = np.concatenate([back(values) for _, _, back in self._losses], axis=1)
        excess, lambda2 = 0.5 * (drive - back), 0.5 * (drive + back)
        parts = [
            np.ones((n, 1)),
            -(motor + leg) - excess[:, :1] * leg,
            -(lambda2[:, :, None] * behind[:, None, :]).reshape(n, -1),
            -(excess[:, 1:, None] * behind[:, None, :]).reshape(n, -1),
        ]
        if self._square >= 0:
            i, j = self._pairs
            before = self.chain.ratio / self.chain.reaches[self._loss]
            twice = np.where(i == j, 1.0, 2.0) * before
            parts.append(-values[:, [self._square]] * twice * behind[:, i] * behind[:, j])
        if self.rest:
            parts.append(excess[:, :1] * behind)
        together = np.concatenate(parts, axis=1)
        if self._gain >= 0:
            gain = values[:, [self._gain]]
            # none divides terms of the recorded torque itself
            divided = np.ones(self.size, dtype=np.bool_)
            divided[: 1 + k1] = [False, *(not name.startswith("drive.") for name in self.names1)]
            together[:, divided] /= gain
            lambda2 = lambda2 / gain
        return together, behind, lambda2, inside

    def _multiplied(self, values: Array, side: int) -> Array:
        """Compute coefficients of ``psi1``, in front of (0) or behind the gearbox (1)."""
        parts = []
        for g, group in enumerate(self._groups):
            products = values @ (group.front, group.behind)[side]
            if g == 0:
                products = products + self._known[side]
                if self._angle >= 0:
                    for name, factor in _TURNS.items():
                        if name in self._names:
                            products[:, self._names.index(name)] *= factor(values[:, self._angle])
            weights = group.weights(values)
            parts.append(
                (products[:, group.used, None] * weights[:, None, :]).reshape(len(values), -1)
            )
        return np.concatenate(parts, axis=1)

    def columns(self, o: Signals, begin: int, end: int) -> tuple[Array, Array]:
        """Compute ``psi1`` ``(n1, n)`` and ``psi2`` ``(n2, n)`` of samples, before the filter."""
        piece = _piece(o, slice(begin, end))
        base = np.ones((len(self._names), end - begin))
        direct = [
            j for j, name in enumerate(self._names) if j not in self._shaped and name not in _TURNED
        ]
        base[direct] = columns(self.chain, piece, [self._names[j] for j in direct])
        if _TURNED[0] in self._names:  # a known mass at an unknown angle
            load = self.chain.load
            weight = load.gravity * piece.inputs.load(load.motion)[1] / self.chain.ratio
            base[self._names.index(_TURNED[0])] = weight * np.sin(piece.q)
            base[self._names.index(_TURNED[1])] = weight * np.cos(piece.q)
        psi1 = np.concatenate(
            [
                (base[list(group.used), None] * group.functions(piece)[None]).reshape(
                    -1, end - begin
                )
                for group in self._groups
            ]
        )
        return psi1, psi1[self._leg_columns]

    def functions(self, o: Signals, begin: int, end: int) -> Array:
        """Compute functions of speed ``(m, n)`` of the load-dependent friction, constant first."""
        piece = _piece(o, slice(begin, end))
        return np.concatenate([functions(piece) for functions, _, _ in self._losses])

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
        for o in self._thinned:
            total += (self.columns(o, 0, o.q.size)[1] ** 2).mean(axis=1)
        rms = np.sqrt(total / len(self._thinned))
        return np.where(np.isfinite(rms) & (rms > 0.0), rms, 1.0)


def linear_torque(
    chain: Joint, observations: Sequence[Signals], draws: Array | None = None
) -> LinearTorque | None:
    """Write the torque as linear for known directions of power, if possible."""
    values = np.empty((0, len(chain.names))) if draws is None else draws
    form = torque_form(chain, any_shape=True)
    exponents = [p.quantity == "stribeck_exponent" for p in chain.parameters]
    if form is None or (any(exponents) and np.ptp(values[:, exponents], axis=0).any()):
        return None
    return LinearTorque(chain, form, observations, values)


def _ones(o: Signals) -> Array:
    return np.ones((1, o.qd.size))


def _zero(values: Array) -> Array:
    return np.zeros((len(values), 1))


def _shaped_column(chain: Joint, p: Parameter) -> ShapedColumn:
    reach = chain.reaches[p.owner]

    def column(o: Signals, shape: float) -> Array:
        assert p.row.column is not None
        state = State(reach * o.q, reach * o.qd, 0.0, np.sign(o.qd), o.stamps, 0.0, 0.0)
        return np.asarray(p.row.column(state, shape) * (reach / chain.ratio))

    return column


def _piece(o: Signals, part: slice) -> Signals:
    return replace(o, q=o.q[part], qd=o.qd[part], qdd=o.qdd[part], stamps=o.stamps[part])
