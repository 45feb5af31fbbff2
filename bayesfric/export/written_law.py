"""The law of a joint, its inverse model, as statements of C or Python.

No term is written twice. The compiled kernels' own code runs with names in place of numbers, and
gives a statement for each element. A column of the table of quantities, a
function of a :class:`~bayesfric.mechanism.quantities.State` in NumPy's functions, gives its own
formula when it is called with a state that only remembers what is done to it. Formulas are of both
languages, but for ``sign`` and ``where``, which the files define.
"""

from __future__ import annotations

import ast
import inspect
import re
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from bayesfric.base.errors import BadInput
from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import Quantity, State
from bayesfric.recordings.arrays import Array

Language = Literal["python", "c"]

# NumPy's operations as formulas.
_OPERATORS = {"add": "+", "subtract": "-", "multiply": "*", "divide": "/", "greater": ">"}
_ALIKE = ("sign", "sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "tanh")
_WRITTEN = {name: f"({{}} {sign} {{}})" for name, sign in _OPERATORS.items()}
_WRITTEN |= {name: f"{name}({{}})" for name in _ALIKE}
_WRITTEN |= {"negative": "(-{})", "positive": "{}", "square": "({0} * {0})", "power": "pow({}, {})"}
_WRITTEN |= {"absolute": "fabs({})", "maximum": "fmax({}, {})", "minimum": "fmin({}, {})"}
_WRITTEN |= {"arctan": "atan({})"}


class Unwritten(Exception):
    """Raised with the name of what has no formula."""


class Traced(NDArrayOperatorsMixin):
    """A symbolic number: NumPy's operations make a formula of it, or raise :class:`Unwritten`."""

    def __init__(self, formula: str) -> None:
        self.formula = formula

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """Write an operation; ``x + 0``, ``x - 0``, ``x 1`` and ``x/1`` change nothing."""
        name = ufunc.__name__
        if method != "__call__" or options or name not in _WRITTEN:
            raise Unwritten(name)
        of = [_formula(x) for x in inputs]
        if name == "multiply" and 0.0 in of:
            return 0.0
        neutral = {"add": 0.0, "subtract": 0.0, "multiply": 1.0, "divide": 1.0}.get(name)
        if neutral is not None and neutral == of[1]:
            return inputs[0]
        if name in ("add", "multiply") and neutral == of[0]:
            return inputs[1]
        return Traced(_WRITTEN[name].format(*of))

    def __bool__(self) -> bool:
        raise Unwritten("a choice")


def _formula(x: Any) -> float | str:
    if isinstance(x, Traced):
        return x.formula
    if isinstance(x, np.ndarray) and x.ndim == 0:  # np.ones_like(...)
        x = x.item()
    if isinstance(x, int | float | np.integer | np.floating):
        return float(x)
    raise Unwritten(type(x).__name__)


def _where(test: Any, yes: Any, no: Any) -> Any:
    """Evaluate, or write down, a conditional expression of Python."""
    if not isinstance(test, Traced):
        return yes if test else no
    of = test.formula, _formula(yes), _formula(no)
    return yes if of[1] == of[2] else Traced("where({}, {}, {})".format(*of))


class _Choices(ast.NodeTransformer):
    """Rewrite choices, ``a if test else b``, to ``where(test, a, b)``."""

    def visit_IfExp(self, node: ast.IfExp) -> ast.Call:
        self.generic_visit(node)
        choice = [node.test, node.body, node.orelse]
        return ast.Call(ast.Name("where", ast.Load()), choice, [])


@cache
def _kernels() -> dict[str, Any]:
    """Run the source of the kernels, undecorated, so that it takes names in place of numbers."""
    body = ast.parse(inspect.getsource(kernels)).body
    functions = [node for node in body if isinstance(node, ast.FunctionDef)]
    for function in functions:
        function.decorator_list.clear()
    module = ast.fix_missing_locations(_Choices().visit(ast.Module([*functions], [])))
    run = {**vars(kernels), "where": _where, "math": np, "float": lambda x: x}
    exec(compile(module, kernels.__file__, "exec"), run)
    return run


def statements(joint: Joint, vector: Array) -> list[tuple[str, str]]:
    """Write down the measured torque of a joint at one vector ``(d,)``, as ``measured``.

    Names and formulas in order; a comment has no name. It starts from ``q``, ``v``, ``a``, ``s``,
    at 20 degC and time zero, without a delay.
    """
    run, custom = _kernels(), [term.name for term in joint.terms]
    lines: list[tuple[str, str]] = []
    (elements,), (load,), _ = joint.tables(vector[None])
    q, v, a, s = map(Traced, "qvas")

    def carried(place: int, reach: float) -> Any:
        """Sum up the terms without a slot at one place, but for those with a signal."""
        total: Any = 0.0
        for term in joint.carried:
            if term.place != place or term.row.signal:
                continue
            name = joint.names[term.index]
            # there is no formula of time: None supports no operation
            time = None if name in custom else 0.0
            at = State(reach * q, reach * v, reach * a, s, time)
            shape = vector[[term.shape]] if term.shape >= 0 else ()
            try:
                torque = torque_of(term.row, at, *shape)
            except Unwritten:
                raise Unwritten(name) from None
            total = total + vector[term.index] * torque
        return total

    def put(torque: Any, name: str, comment: str = "") -> Any:
        formula = str(_formula(torque))
        lines.extend([("", comment)] * bool(comment))
        if formula.isidentifier() and name != "measured":
            return torque
        lines.append((name, formula))
        return Traced(name)

    weight = run["gravity_torque"](load, np.sin(q), np.cos(q))
    inertia = load[kernels.LOAD_INERTIA] * a
    torque = put(inertia + weight + carried(len(elements), 1.0), "torque", "load")
    for k in range(len(elements) - 1, -1, -1):
        element, name = elements[k], joint.elements[k].name
        reach = joint.reaches[name]
        torque = put(torque / element[kernels.RATIO], f"output_{k}", name)
        risen = run["rises"](element, reach * v)
        passed = run["element_torque"](element, torque, s, reach * v, reach * a, risen)
        torque = put(passed + carried(k, reach), f"input_{k}")
    put((torque + load[kernels.OFFSET]) / load[kernels.GAIN], "measured", "as measured")
    return lines


def torque_of(row: Quantity, at: State, *shape: Any) -> Any:
    """Write the torque of a row for a coefficient of one at a state of :class:`Traced`."""
    assert row.column is not None
    try:
        torque = row.column(at, *shape)
        return torque if isinstance(torque, Traced) else _formula(torque)
    except (TypeError, ValueError, AttributeError) as error:  # math.sin(...), m.position[0]
        raise Unwritten(str(error)) from None


def _text(formula: str, language: Language) -> str:
    """Write a formula without needless brackets, its numbers or functions as the language does."""
    text = ast.unparse(ast.parse(formula, mode="eval"))
    if language == "c":
        return re.sub(r"(?<![\w.])\d+\.?\d*(?:e[-+]?\d+)?", r"REAL(\g<0>)", text)
    text = re.sub(r"\bf(max|min)\(", r"\1(", text)
    return re.sub(r"\b(?!sign|where|max|min)(\w+)\(", r"math.\1(", text)


def law(
    joint: Joint, vector: Array, language: Language, required: bool = True
) -> dict[str, Any] | None:
    """Write the law of a joint at one parameter vector ``(d,)``.

    The ``full`` one, the ``ideal`` one without losses and cogging, and the ``offset``, torque at
    standstill without load and losses. ``None`` of a law without a formula that is not required.
    """
    load = joint.tables(vector[None]).load[0]
    ideal = [p.row.stores or p.row.circular or p.owner in ("", "drive") for p in joint.parameters]
    laws = {"full": vector, "ideal": np.where(ideal, vector, 0.0)}
    try:
        parts = {
            part: [(x, _text(f, language) if x else f) for x, f in statements(joint, values)]
            for part, values in laws.items()
        }
    except Unwritten as error:
        if not required:
            return None
        problem = "is a custom term, of time or with functions that the export does not support"
        hint = "export another format, or leave the term out"
        raise BadInput(str(error), problem, hint) from None
    return {"offset": repr(float(load[kernels.OFFSET] / load[kernels.GAIN])), **parts}
