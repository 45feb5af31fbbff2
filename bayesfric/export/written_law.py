"""The law of a joint, its inverse model, as statements of C or Python.

No term is written twice. The compiled kernels' own code runs with names in place of numbers:
what they assign becomes a statement of the same name. A column of the table of quantities, a
function of a :class:`~bayesfric.mechanism.quantities.State` in NumPy's functions, gives its own
formula when it is called with a state that only remembers what is done to it.
"""

from __future__ import annotations

import ast
import inspect
from collections import Counter
from dataclasses import dataclass
from functools import cache
from types import CodeType
from typing import Any, Literal

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from bayesfric.base.errors import BadInput
from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import Quantity, State
from bayesfric.recordings.arrays import Array

Language = Literal["python", "c"]
# A number, a name, or an operation and what it is of.
Formula = float | str | list[Any]

# Operations by NumPy's names: text, precedence and lowest precedence of the operands.
_WRITTEN: dict[str, tuple[str, int, tuple[int, ...]]] = {
    "add": ("{} + {}", 1, (1, 1)),
    "subtract": ("{} - {}", 1, (1, 2)),
    "multiply": ("{} * {}", 2, (2, 2)),
    "divide": ("{} / {}", 2, (2, 3)),
    "negative": ("-{}", 2, (3,)),
    "positive": ("+{}", 2, (3,)),
    "square": ("{0} * {0}", 2, (3,)),
    "greater": ("{} > {}", 0, (1, 1)),
    "sign": ("(({0} > 0) - ({0} < 0))", 3, (1,)),
}
# Functions by NumPy's names, as Python and C call them; "where" has its own form in either.
_FUNCTIONS = {
    name: (f"math.{name}", name)
    for name in ("sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "tanh")
} | {
    "absolute": ("abs", "fabs"),
    "maximum": ("max", "fmax"),
    "minimum": ("min", "fmin"),
    "power": ("math.pow", "pow"),
    "arctan": ("math.atan", "atan"),
    "where": ("({1} if {0} else {2})", "({0} ? {1} : {2})"),
}


@dataclass(frozen=True)
class Law:
    """Statements ``(name, value)`` that compute ``measured``; a comment has no name.

    They start from ``q``, ``v``, ``a`` and the direction ``s``.
    """

    full: tuple[tuple[str, str], ...]
    ideal: tuple[tuple[str, str], ...]  # without losses and cogging
    offset: str  # torque at standstill without load and losses


class Unwritten(Exception):
    """Raised with the name of what has no formula."""


class Traced(NDArrayOperatorsMixin):
    """A symbolic number: what NumPy's operations do to it makes a formula.

    An operation that not every language has, or a decision by its value, raises
    :class:`Unwritten`.
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
    if operation not in _WRITTEN and operation not in _FUNCTIONS:
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
    functions = [
        node
        for node in ast.parse(inspect.getsource(kernels)).body
        if isinstance(node, ast.FunctionDef)
    ]
    for function in functions:
        function.decorator_list.clear()
    module = _Recorder().visit(ast.Module([*functions], []))
    return compile(ast.fix_missing_locations(module), kernels.__file__, "exec")


class Statements:
    """Statements that compute the measured torque of a joint at one vector ``(d,)``, in order.

    They start from ``q``, ``v``, ``a`` and ``s``, at 20 degC and time zero, without a delay.
    """

    def __init__(self, joint: Joint, vector: Array) -> None:
        self.joint, self.vector = joint, vector
        self.all: list[tuple[str, Formula]] = []
        self._uses = Counter("qvas")
        run: dict[str, Any] = dict(vars(kernels))
        run |= {"put": self.put, "where": _where, "math": np, "float": lambda x: x}
        exec(_code(), run)
        (elements,), (load,), _ = joint.tables(vector[None])
        q, a = Traced("q"), Traced("a")
        self.all.append(("", "load"))
        at = self._at(1.0)
        weight = run["gravity_torque"](load, np.sin(q), np.cos(q))
        torque = load[kernels.LOAD_INERTIA] * a + weight
        torque = self.put("torque", torque + self._carried(len(elements), at))
        for k in range(len(elements) - 1, -1, -1):
            element, name = elements[k], joint.elements[k].name
            self.all.append(("", name))
            at = self._at(joint.reaches[name])
            torque = self.put("torque", torque / element[kernels.RATIO])
            moving = at.direction, at.speed, at.acceleration
            risen = run["rises"](element, at.speed)
            torque = run["element_torque"](element, torque, *moving, risen)
            torque = self.put("torque", torque + self._carried(k, at))
        self.all.append(("", "as measured"))
        measured = (torque + load[kernels.OFFSET]) / load[kernels.GAIN]
        self.all.append(("measured", _formula(measured)))

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

    def _at(self, reach: float) -> State:
        """State at ``reach`` times the speed of the joint, at time zero."""
        position, speed = (
            self.put("position", reach * Traced("q")),
            self.put("speed", reach * Traced("v")),
        )
        acceleration = self.put("acceleration", reach * Traced("a"))
        return State(position, speed, acceleration, Traced("s"), 0.0)

    def _carried(self, place: int, at: State) -> Any:
        """Sum up the terms without a slot at one place, but for those with a signal."""
        total: Any = 0.0
        for term in self.joint.carried:
            if term.place == place and not term.row.signal:
                shape = self.vector[[term.shape]] if term.shape >= 0 else ()
                try:
                    total = total + self.vector[term.index] * _torque_of(term.row, at, *shape)
                except Unwritten:
                    raise Unwritten(self.joint.names[term.index]) from None
        return total

    def used(self) -> list[tuple[str, Formula]]:
        """Statements that lead to the result, in order: compilers warn of others."""
        statements, wanted = [], {"measured"}
        for name, formula in reversed(self.all):
            if not name or name in wanted:
                statements.append((name, formula))
                wanted |= _names_in(formula) if name else set()
        return statements[::-1]

    def written(self, language: Language) -> tuple[tuple[str, str], ...]:
        """Give the statements as text."""
        return tuple((name, _text(f, language) if name else str(f)) for name, f in self.used())


def _torque_of(row: Quantity, at: State, *shape: Any) -> Any:
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
    return _formula(_torque_of(row, at, *((Traced("shape"),) if row.shape else ())))


def _names_in(formula: Formula) -> set[str]:
    if isinstance(formula, list):
        return set().union(*map(_names_in, formula[1:]))
    return {formula} if isinstance(formula, str) else set()


def _text(formula: Formula, language: Language, precedence: int = 0) -> str:
    """Write a formula, in brackets if it binds less than ``precedence``."""
    if isinstance(formula, str):
        return formula
    if isinstance(formula, float):
        return repr(formula) if language == "python" else f"REAL({formula!r})"
    operation, *operands = formula
    if operation in _WRITTEN:
        pattern, own_precedence, lowest = _WRITTEN[operation]
        text = pattern.format(
            *(_text(x, language, n) for x, n in zip(operands, lowest, strict=True))
        )
        return text if own_precedence >= precedence else f"({text})"
    parts = [_text(x, language) for x in operands]
    name = _FUNCTIONS[operation][language == "c"]
    return name.format(*parts) if operation == "where" else f"{name}({', '.join(parts)})"


def unwritten(joint: Joint) -> str | None:
    """Name a term that has no formula or depends on time; ``None`` where there is none."""
    try:
        Statements(joint, np.ones(len(joint.names)))
    except Unwritten as error:
        return str(error)
    of_time = (term.name for term in joint.terms if "time" in _names_in(formula_of(term.row)))
    return next(of_time, None)


def law(joint: Joint, vector: Array, language: Language) -> Law:
    """Write the law of a joint at one parameter vector ``(d,)``."""
    if (name := unwritten(joint)) is not None:
        problem = "is a custom term, of time or with functions that the export does not support"
        raise BadInput(name, problem, "export another format, or leave the term out")
    load = joint.tables(vector[None]).load[0]
    ideal = [p.row.stores or p.row.circular or p.owner in ("", "drive") for p in joint.parameters]
    return Law(
        Statements(joint, vector).written(language),
        Statements(joint, np.where(ideal, vector, 0.0)).written(language),
        repr(float(load[kernels.OFFSET] / load[kernels.GAIN])),
    )
