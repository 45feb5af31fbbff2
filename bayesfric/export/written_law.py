"""The law of a joint as statements of C or Python: its inverse model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.law import Formula, Statements, Unwritten, of_time
from bayesfric.recordings.arrays import Array

Language = Literal["python", "c"]


@dataclass(frozen=True)
class Law:
    """Statements ``(name, value)`` that compute ``measured``; a comment has no name.

    They start from ``q``, ``v``, ``a`` and the direction ``s``.
    """

    full: tuple[tuple[str, str], ...]
    ideal: tuple[tuple[str, str], ...]  # without losses and cogging
    offset: str  # torque at standstill without load and losses


# Text, precedence and lowest precedence of the operands by operation.
_WRITTEN: dict[str, tuple[str, int, Sequence[int]]] = {
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
# Functions with other names than in NumPy.
_PYTHON = {"absolute": "abs", "maximum": "max", "minimum": "min", "power": "math.pow"}
_C = {"absolute": "fabs", "maximum": "fmax", "minimum": "fmin", "power": "pow"}
_BOTH = {"arctan": "atan"}


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
    name = _BOTH.get(operation, operation)
    if language == "python":
        if operation == "where":
            return "({1} if {0} else {2})".format(*parts)
        return f"{_PYTHON.get(operation, f'math.{name}')}({', '.join(parts)})"
    if operation == "where":
        return "({} ? {} : {})".format(*parts)
    return f"{_C.get(operation, name)}({', '.join(parts)})"


def _statements(chain: Joint, vector: Array, language: Language) -> tuple[tuple[str, str], ...]:
    load = chain.tables(vector[None]).load[0]
    statements = Statements()
    torque = statements.torque(chain, vector)
    statements.remark("as measured")
    statements.add("measured", (torque + load[kernels.OFFSET]) / load[kernels.GAIN])
    return tuple(
        (name, _text(formula, language) if name else str(formula))
        for name, formula in statements.used("measured")
    )


def unwritten(chain: Joint) -> str | None:
    """Name a term that has no formula or depends on time; ``None`` where there is none."""
    try:
        Statements().torque(chain, np.ones(len(chain.names)))
    except Unwritten as error:
        return str(error)
    return next((term.name for term in chain.terms if of_time(term.row)), None)


def law(chain: Joint, vector: Array, language: Language) -> Law:
    """Write the law of a joint at one parameter vector ``(d,)``."""
    if (name := unwritten(chain)) is not None:
        problem = "is a custom term, of time or with functions that the export does not support"
        raise BadInput(name, problem, "export another format, or leave the term out")
    load = chain.tables(vector[None]).load[0]
    ideal = [p.row.stores or p.row.circular or p.owner in ("", "drive") for p in chain.parameters]
    return Law(
        _statements(chain, vector, language),
        _statements(chain, np.where(ideal, vector, 0.0), language),
        repr(float(load[kernels.OFFSET] / load[kernels.GAIN])),
    )
