"""Formulas of a joint's torque, from which C and Python code is generated.

No term is written twice. The compiled kernels' own code runs with names in place of numbers:
what they assign becomes a statement of the same name. A column of the table of quantities, a
function of a :class:`~bayesfric.mechanism.quantities.State` in NumPy's functions, gives its own
formula when it is called with a state that only remembers what is done to it.
"""

from __future__ import annotations

import ast
import inspect
from collections import Counter
from functools import cache
from types import CodeType
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from bayesfric.mechanism import kernels
from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.quantities import Quantity, State
from bayesfric.recordings.arrays import Array

# A number, a name, or an operation and what it is of.
Formula = float | str | list[Any]

# What every language has, by NumPy's names.
OPERATIONS = frozenset(
    (
        "add", "subtract", "multiply", "divide", "negative", "positive", "absolute", "sign",
        "maximum", "minimum", "power", "square", "sqrt", "exp", "expm1", "log", "log1p",
        "sin", "cos", "tan", "arctan", "tanh", "greater", "where",
    )
)  # fmt: skip
# Position, speed and acceleration of the joint, and the sign of its speed.
MOTION = ("q", "v", "a", "s")


class Unwritten(Exception):
    """Raised with the name of what has no formula."""


class Traced(NDArrayOperatorsMixin):
    """A symbolic number: NumPy's :data:`OPERATIONS` on it make a formula.

    Another operation, or a decision by its value, raises :class:`Unwritten`.
    """

    def __init__(self, formula: Formula) -> None:
        self.formula = formula

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if method != "__call__" or options:
            raise Unwritten(ufunc.__name__)
        return _operation(ufunc.__name__, *inputs)

    def __bool__(self) -> bool:
        raise Unwritten("a choice")


def _formula(x: Any) -> Formula:
    if isinstance(x, Traced):
        return x.formula
    if isinstance(x, np.ndarray) and x.ndim == 0:  # np.ones_like(...)
        x = x.item()
    if isinstance(x, int | float | np.integer | np.floating):
        return float(x)
    raise Unwritten(type(x).__name__)


def _operation(operation: str, *inputs: Any) -> Any:
    """Build an operation, simplified: ``x + 0``, ``x - 0``, ``x 1``, ``x/1`` and ``x 0``."""
    if operation not in OPERATIONS:
        raise Unwritten(operation)
    of = [_formula(x) for x in inputs]
    if operation in ("subtract", "divide") and of[1] == (operation == "divide"):
        return inputs[0]
    if operation == "add" and 0.0 in of:
        return inputs[1 - of.index(0.0)]
    if operation == "multiply" and (0.0 in of or 1.0 in of):
        return 0.0 if 0.0 in of else inputs[1 - of.index(1.0)]
    return Traced([operation, *of])


def _where(test: Any, yes: Any, no: Any) -> Any:
    """Evaluate, or write down, a conditional expression of Python."""
    if not isinstance(test, Traced):
        return yes if test else no
    return yes if _formula(yes) == _formula(no) else _operation("where", test, yes, no)


class _Recorder(ast.NodeTransformer):
    """Rewrite assignments to ``put(name, value)`` and choices to ``where(...)``."""

    def visit_Assign(self, node: ast.Assign) -> ast.Assign:
        self.generic_visit(node)
        names = ast.Constant(ast.unparse(node.targets[0]).strip("()"))
        node.value = ast.Call(ast.Name("put", ast.Load()), [names, node.value], [])
        return node

    def visit_IfExp(self, node: ast.IfExp) -> ast.Call:
        self.generic_visit(node)
        choice = [node.test, node.body, node.orelse]
        return ast.Call(ast.Name("where", ast.Load()), choice, [])


@cache
def _code() -> CodeType:
    """Compile the source of the kernels, undecorated, to run with names in place of numbers."""
    tree = ast.parse(inspect.getsource(kernels))
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    for function in functions:
        function.decorator_list.clear()
    module = _Recorder().visit(ast.Module([*functions], []))
    return compile(ast.fix_missing_locations(module), kernels.__file__, "exec")


class Statements:
    """Statements that compute the torque of a joint from :data:`MOTION`, in order.

    Temperature is 20 degC and time zero, and there is no delay.
    """

    def __init__(self) -> None:
        self.all: list[tuple[str, Formula]] = []
        self._uses = Counter(MOTION)
        self.kernels: dict[str, Any] = dict(vars(kernels))
        self.kernels |= {"put": self.put, "where": _where, "math": np, "float": lambda x: x}
        exec(_code(), self.kernels)

    def put(self, name: str, value: Any) -> Any:
        """Assign a formula to a name, numbered where that is used already."""
        if isinstance(value, tuple):
            return tuple(map(self.put, name.split(", "), value))
        if not isinstance(value, Traced) or isinstance(value.formula, str):
            return value
        for known, formula in self.all:
            if formula == value.formula:
                return Traced(known)
        self._uses[name] += 1
        name += str(self._uses[name]) if self._uses[name] > 1 else ""
        self.all.append((name, value.formula))
        return Traced(name)

    def torque(self, chain: Chain, vector: Array) -> Any:
        """Compute the torque at the motor, without gain and offset of what is measured."""
        (elements,), (load,), _ = chain.tables(vector[None])
        self.remark("load")
        at = self._at(1.0)
        q, _, a, _ = map(Traced, MOTION)
        weight = self.kernels["gravity_torque"](load, 0.0, np.sin(q), np.cos(q))
        torque = load[kernels.LOAD_INERTIA] * a + weight
        torque = self.put("torque", torque + self._carried(chain, vector, len(chain.elements), at))
        for k in range(len(chain.elements) - 1, -1, -1):
            element, name = elements[k], chain.elements[k].name
            self.remark(name)
            at = self._at(chain.reaches[name])
            torque = self.put("torque", torque / element[kernels.RATIO])
            moving = at.direction, at.speed, at.acceleration
            torque = self.kernels["element_torque"](element, torque, *moving)
            torque = self.put("torque", torque + self._carried(chain, vector, k, at))
        return torque

    def _at(self, reach: float) -> State:
        """State at ``reach`` times the speed of the joint, at time zero."""
        q, v, a, s = map(Traced, MOTION)
        position, speed = self.put("position", reach * q), self.put("speed", reach * v)
        return State(position, speed, self.put("acceleration", reach * a), s, 0.0)

    def _carried(self, chain: Chain, vector: Array, place: int, at: State) -> Any:
        """Sum up the terms without a slot at one place, but for those with a signal."""
        total: Any = 0.0
        for term in chain.carried:
            if term.place == place and not term.row.signal:
                shape = vector[[term.shape]] if term.shape >= 0 else ()
                try:
                    total = total + vector[term.index] * torque_of(term.row, at, *shape)
                except Unwritten:
                    raise Unwritten(chain.names[term.index]) from None
        return total

    def remark(self, text: str) -> None:
        """Add a heading for the next statements."""
        self.all.append(("", text))

    def add(self, name: str, value: Any) -> None:
        """Append a named result, a number or a formula."""
        self.all.append((name, _formula(value)))

    def used(self, result: str) -> list[tuple[str, Formula]]:
        """Statements that lead to ``result``, in order: compilers warn of others."""
        statements, wanted = [], {result}
        for name, formula in reversed(self.all):
            if not name or name in wanted:
                statements.append((name, formula))
                wanted |= names_in(formula) if name else set()
        return statements[::-1]


def torque_of(row: Quantity, at: State, *shape: Any) -> Any:
    """Return the torque of a row at a state of :class:`Traced` for a coefficient of one."""
    assert row.column is not None
    try:
        torque = row.column(at, *shape)
        return torque if isinstance(torque, Traced) else _formula(torque)
    except (TypeError, ValueError, AttributeError) as error:  # math.sin(...), m.position[0]
        raise Unwritten(str(error)) from None


def formula_of(row: Quantity) -> Formula:
    """Return the formula of a row's torque for a coefficient of one, in a state's names."""
    at = State(*map(Traced, State._fields))
    return _formula(torque_of(row, at, *((Traced("shape"),) if row.shape else ())))


def names_in(formula: Formula) -> set[str]:
    """Names that a formula is made of."""
    if isinstance(formula, list):
        return set().union(*map(names_in, formula[1:]))
    return {formula} if isinstance(formula, str) else set()


def of_time(row: Quantity) -> bool:
    """Whether a term changes with temperature or time; raises :class:`Unwritten`."""
    return row.signal == "temperature" or (
        row.role == "own" and row.column is not None and "time" in names_in(formula_of(row))
    )
