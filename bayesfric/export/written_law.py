"""The law of a joint, its inverse model, as statements of C or Python.

No term is written twice. The compiled kernels' own code runs with names in place of numbers:
what they assign becomes a statement of the same name. A column of the table of quantities, a
function of a :class:`~bayesfric.mechanism.quantities.State` in NumPy's functions, gives its own
formula when it is called with a state that only remembers what is done to it. Formulas are of both
languages, but for ``sign`` and ``where``, which the files define.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections import Counter
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
Formula = float | str
Statements = list[tuple[str, str]]  # name and formula, in order; a comment has no name

# NumPy's operations as formulas.
_WRITTEN = {
    "add": "({} + {})",
    "subtract": "({} - {})",
    "multiply": "({} * {})",
    "divide": "({} / {})",
    "negative": "(-{})",
    "positive": "{}",
    "square": "({0} * {0})",
    "greater": "({} > {})",
    "power": "pow({}, {})",
    "absolute": "fabs({})",
    "maximum": "fmax({}, {})",
    "minimum": "fmin({}, {})",
    "arctan": "atan({})",
    "where": "where({}, {}, {})",
    "sign": "sign({})",
} | {x: f"{x}({{}})" for x in "sqrt exp expm1 log log1p sin cos tan tanh".split()}
_NAME = r"(?<![\w.])[a-z_]\w*(?!\w*\()"  # of a variable
_NUMBER = r"(?<![\w.])\d+\.?\d*(?:e[-+]?\d+)?"


class Unwritten(Exception):
    """Raised with the name of what has no formula."""


class Traced(NDArrayOperatorsMixin):
    """A symbolic number: what NumPy's operations do to it makes a formula.

    An operation that not every language has, or a decision by its value, raises
    :class:`Unwritten`.
    """

    def __init__(self, formula: str) -> None:
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
    if operation not in _WRITTEN:
        raise Unwritten(operation)
    of = [_formula(x) for x in inputs]
    if operation in ("subtract", "divide") and of[1] == (operation == "divide"):
        return inputs[0]
    if operation == "add" and 0.0 in of:
        return inputs[1 - of.index(0.0)]
    if operation == "multiply" and (0.0 in of or 1.0 in of):
        return 0.0 if 0.0 in of else inputs[1 - of.index(1.0)]
    return Traced(_WRITTEN[operation].format(*of))


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
    body = ast.parse(inspect.getsource(kernels)).body
    functions = [node for node in body if isinstance(node, ast.FunctionDef)]
    for function in functions:
        function.decorator_list.clear()
    module = _Recorder().visit(ast.Module([*functions], []))
    return compile(ast.fix_missing_locations(module), kernels.__file__, "exec")


def statements(joint: Joint, vector: Array) -> Statements:
    """Write down the measured torque of a joint at one vector ``(d,)``, as ``measured``.

    It starts from ``q``, ``v``, ``a`` and ``s``, at 20 degC and time zero, without a delay.
    """
    lines: Statements = []
    uses = Counter("qvas")

    def put(name: str, value: Any) -> Any:
        """Assign a formula to a name, numbered where that is used already."""
        if isinstance(value, tuple):
            return tuple(map(put, name.split(", "), value))
        if not isinstance(value, Traced) or re.fullmatch(_NAME, value.formula):
            return value
        for known, formula in lines:
            if formula == value.formula:
                return Traced(known)
        uses[name] += 1
        name += str(uses[name]) if uses[name] > 1 else ""
        lines.append((name, value.formula))
        return Traced(name)

    def state(reach: float) -> State:
        """State at ``reach`` times the speed of the joint, at time zero."""
        names = {"position": "q", "speed": "v", "acceleration": "a"}
        moving = [put(name, reach * Traced(x)) for name, x in names.items()]
        return State(*moving, Traced("s"), 0.0)

    def carried(place: int, at: State) -> Any:
        """Sum up the terms without a slot at one place, but for those with a signal."""
        total: Any = 0.0
        for term in joint.carried:
            if term.place == place and not term.row.signal:
                shape = vector[[term.shape]] if term.shape >= 0 else ()
                try:
                    total = total + vector[term.index] * _torque_of(term.row, at, *shape)
                except Unwritten:
                    raise Unwritten(joint.names[term.index]) from None
        return total

    run: dict[str, Any] = dict(vars(kernels))
    run |= {"put": put, "where": _where, "math": np, "float": lambda x: x}
    exec(_code(), run)
    (elements,), (load,), _ = joint.tables(vector[None])
    q, at = Traced("q"), state(1.0)
    lines.append(("", "load"))
    weight = run["gravity_torque"](load, np.sin(q), np.cos(q))
    torque = load[kernels.LOAD_INERTIA] * at.acceleration + weight
    torque = put("torque", torque + carried(len(elements), at))
    for k in range(len(elements) - 1, -1, -1):
        element, name = elements[k], joint.elements[k].name
        lines.append(("", name))
        at = state(joint.reaches[name])
        torque = put("torque", torque / element[kernels.RATIO])
        risen = run["rises"](element, at.speed)
        moving = at.direction, at.speed, at.acceleration
        torque = run["element_torque"](element, torque, *moving, risen)
        torque = put("torque", torque + carried(k, at))
    measured = (torque + load[kernels.OFFSET]) / load[kernels.GAIN]
    lines += [("", "as measured"), ("measured", str(_formula(measured)))]
    # compilers warn of statements that do not lead to the result
    used, wanted = [], {"measured"}
    for name, formula in reversed(lines):
        if not name or name in wanted:
            used.append((name, formula))
            wanted |= {*re.findall(_NAME, formula)} if name else set()
    return used[::-1]


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


def _text(formula: str, language: Language) -> str:
    """Write a formula without needless brackets, its numbers or functions as the language does."""
    text = ast.unparse(ast.parse(formula, mode="eval"))
    if language == "c":
        return re.sub(_NUMBER, r"REAL(\g<0>)", text)
    text = re.sub(r"\bf(max|min)\(", r"\1(", text)
    return re.sub(r"\b(?!sign|where|max|min)(\w+)\(", r"math.\1(", text)


def unwritten(joint: Joint) -> str | None:
    """Name a term that has no formula or depends on time; ``None`` where there is none."""
    try:
        statements(joint, np.ones(len(joint.names)))
    except Unwritten as error:
        return str(error)
    of_time = (x.name for x in joint.terms if "time" in re.findall(_NAME, str(formula_of(x.row))))
    return next(of_time, None)


def law(joint: Joint, vector: Array, language: Language) -> dict[str, Any]:
    """Write the law of a joint at one parameter vector ``(d,)``.

    The ``full`` one, the ``ideal`` one without losses and cogging, and the ``offset``, torque at
    standstill without load and losses.
    """
    if (name := unwritten(joint)) is not None:
        problem = "is a custom term, of time or with functions that the export does not support"
        raise BadInput(name, problem, "export another format, or leave the term out")
    load = joint.tables(vector[None]).load[0]
    ideal = [p.row.stores or p.row.circular or p.owner in ("", "drive") for p in joint.parameters]
    laws = {"full": vector, "ideal": np.where(ideal, vector, 0.0)}
    return {"offset": repr(float(load[kernels.OFFSET] / load[kernels.GAIN]))} | {
        part: [(x, _text(f, language) if x else f) for x, f in statements(joint, values)]
        for part, values in laws.items()
    }
