"""Formulas that columns write down of themselves are what the columns give."""

import math
import re
from importlib.resources import files

import numpy as np
import pytest

from bayesfric.mechanism.quantities import CYCLES, QUANTITIES, State
from bayesfric.report.answers.formula import OPERATIONS, Unwritten, formula_of, mentions

COLUMNS = {
    row.name: row
    for row in (*QUANTITIES.values(), *(q for wave in CYCLES.values() for q in wave(7)))
    if row.column is not None and row.role == "own" and row.name != "offset"
}


def value(formula, at):
    """Work a formula out with NumPy's own functions."""
    if isinstance(formula, float):
        return formula
    if isinstance(formula, str):
        return at[formula]
    return getattr(np, formula[0])(*(value(one, at) for one in formula[1:]))


@pytest.mark.parametrize("name", COLUMNS)
def test_a_formula_is_the_column(name):
    row, rng = COLUMNS[name], np.random.default_rng(3)
    formula = formula_of(row.column, shaped=bool(row.shape))
    state = State(**{field: rng.normal(size=50) for field in State._fields})
    state = state._replace(direction=np.sign(state.speed), time=np.abs(state.time))
    shape = (0.7,) if row.shape else ()
    expected = np.broadcast_to(row.column(state, *shape), (50,))
    found = value(formula, state._asdict() | {"shape": 0.7})
    assert np.broadcast_to(found, (50,)) == pytest.approx(expected, rel=1e-14)


def test_the_page_knows_every_operation_by_its_name():
    script = files("bayesfric.report.page") / "templates" / "calculator.js"
    (table,) = re.findall(r"const operations = \{(.*?)\n  \};", script.read_text("utf-8"), re.S)
    assert set(re.findall(r"(\w+): ", table)) == OPERATIONS


def test_losses_depend_on_speed_or_direction():
    losing = {
        n for n, row in COLUMNS.items() if mentions(formula_of_row(row), ("speed", "direction"))
    }
    keeping = {
        "inertia",
        "first_moment",
        "spring",
        "spring_cubic",
        "cogging_sin_7",
        "cogging_cos_7",
    }
    assert set(COLUMNS) - losing == keeping


def formula_of_row(row):
    return formula_of(row.column, shaped=bool(row.shape))


@pytest.mark.parametrize(
    "column",
    [
        lambda m: math.sin(m.position),
        lambda m: np.where(m.speed > 0.0, 1.0, 2.0),
        lambda m: np.add.reduce(m.speed),
        lambda m: m.speed if m.speed > 0.0 else 0.0,
        lambda _: "1",
        lambda m: m.position[0],
    ],
)
def test_what_cannot_be_written_is_refused(column):
    with pytest.raises(Unwritten):
        formula_of(column)
