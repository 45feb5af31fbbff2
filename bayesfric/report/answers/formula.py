"""A column of the torque as a formula that a page can work out: written down by itself.

A column is a function of a :class:`~bayesfric.mechanism.quantities.State` in NumPy's functions.
Called with a state that only remembers what is done to it, it gives its own formula, and no term
is written twice.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from bayesfric.mechanism.quantities import Column, State

# A number, the name of a field of a state (or `shape`), or an operation and what it is of.
Formula = float | str | list[Any]

# What the page's script knows by the same names, those of NumPy.
OPERATIONS = frozenset(
    (
        "add", "subtract", "multiply", "divide", "negative", "positive", "absolute", "sign",
        "maximum", "minimum", "power", "square", "sqrt", "exp", "expm1", "log", "log1p",
        "sin", "cos", "tan", "arctan", "tanh",
    )
)  # fmt: skip
SHAPE = "shape"


class Unwritten(Exception):
    """A page's script cannot work this out; the argument says what."""


class _Traced(NDArrayOperatorsMixin):
    """A number that remembers how it came about."""

    def __init__(self, formula: Formula) -> None:
        self.formula = formula

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if method != "__call__" or options or ufunc.__name__ not in OPERATIONS:
            raise Unwritten(ufunc.__name__)
        return _Traced([ufunc.__name__, *map(_formula, inputs)])


def _formula(x: Any) -> Formula:
    if isinstance(x, _Traced):
        return x.formula
    if isinstance(x, int | float | np.integer | np.floating):
        return float(x)
    raise Unwritten(type(x).__name__)


def formula_of(column: Column, *, shaped: bool = False) -> Formula:
    """Write a column down.

    Parameters
    ----------
    column
        Torque for a coefficient of one, a function of a state.
    shaped
        Whether it takes the value of a parameter that shapes it besides.

    Raises
    ------
    Unwritten
        If it does what the script of a page does not know.
    """
    state = State(**{name: _Traced(name) for name in State._fields})
    try:
        return _formula(column(state, _Traced(SHAPE)) if shaped else column(state))
    except (TypeError, ValueError, AttributeError) as error:  # math.sin(...), m.position[0]
        raise Unwritten(str(error)) from None


def mentions(formula: Formula, names: Collection[str]) -> bool:
    """Tell whether a formula depends on one of some fields of a state."""
    if isinstance(formula, list):
        return any(mentions(one, names) for one in formula[1:])
    return formula in names
