"""The whole law of a joint as statements of C or Python: the inverse model, written out."""

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
    """Statements ``(name, value)`` that work out ``measured``; a remark has no name.

    They start from ``q``, ``v``, ``a`` and the direction ``s``. ``ideal`` are those of the torque
    without losses and cogging: inertia, gravity, springs and the offset, which alone is ``offset``.
    """

    whole: tuple[tuple[str, str], ...]
    ideal: tuple[tuple[str, str], ...]
    offset: str


# Of an operation its text, how tightly that binds, and how tightly what it is of must.
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
# Functions that are not called as NumPy's are.
_PYTHON = {"absolute": "abs", "maximum": "max", "minimum": "min", "power": "math.pow"}
_C = {"absolute": "fabs", "maximum": "fmax", "minimum": "fmin", "power": "pow"}
_BOTH = {"arctan": "atan"}


def _text(formula: Formula, language: Language, tightly: int = 0) -> str:
    """Write a formula, in brackets unless it binds so tightly."""
    if isinstance(formula, str):
        return formula
    if isinstance(formula, float):
        return repr(formula) if language == "python" else f"REAL({formula!r})"
    operation, *of = formula
    if operation in _WRITTEN:
        pattern, binds, needs = _WRITTEN[operation]
        text = pattern.format(*(_text(x, language, n) for x, n in zip(of, needs, strict=True)))
        return text if binds >= tightly else f"({text})"
    parts = [_text(x, language) for x in of]
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
    made = Statements()
    torque = made.torque(chain, vector)
    made.remark("as measured")
    made.add("measured", (torque + load[kernels.OFFSET]) / load[kernels.GAIN])
    return tuple(
        (name, _text(formula, language) if name else str(formula))
        for name, formula in made.used("measured")
    )


def unwritten(chain: Joint) -> str | None:
    """Name a term of a joint that cannot be written out; ``None`` where there is none."""
    try:
        Statements().torque(chain, np.ones(len(chain.names)))
    except Unwritten as error:
        return str(error)
    return next((term.name for term in chain.terms if of_time(term.row)), None)


def law(chain: Joint, vector: Array, language: Language) -> Law:
    """Write a joint out at one parameter vector ``(d,)``.

    Raises
    ------
    BadInput
        If it has a term of one's own that has no formula, or one of time.
    """
    if (name := unwritten(chain)) is not None:
        what = "is a term of one's own, of time or in functions that the export does not know"
        raise BadInput(name, what, "export another format, or leave the term out")
    load = chain.tables(vector[None]).load[0]
    lossless = [
        p.row.stores or p.row.circular or p.owner in ("", "drive") for p in chain.parameters
    ]
    return Law(
        _statements(chain, vector, language),
        _statements(chain, np.where(lossless, vector, 0.0), language),
        repr(float(load[kernels.OFFSET] / load[kernels.GAIN])),
    )
