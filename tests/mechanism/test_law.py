"""Formulas that columns and kernels write down of themselves are what these give."""

import math
import re
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from bayesfric.mechanism import kernels
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.law import (
    OPERATIONS,
    Statements,
    Unwritten,
    Varying,
    formula_of,
    names_in,
)
from bayesfric.mechanism.quantities import CYCLES, QUANTITIES, State
from bayesfric.recordings.inputs import AT_ROOM

from ..report.conftest import EVERYTHING
from .joints import everything

COLUMNS = {
    row.name: row
    for row in (*QUANTITIES.values(), *(q for wave in CYCLES.values() for q in wave(7)))
    if row.column is not None and row.role == "own"
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
    formula = formula_of(row)
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
    losing = {n for n, row in COLUMNS.items() if {"speed", "direction"} & names_in(formula_of(row))}
    keeping = {
        "inertia",
        "first_moment",
        "spring",
        "spring_cubic",
        "cogging_sin_7",
        "cogging_cos_7",
        "offset",
    }
    assert set(COLUMNS) - losing == keeping


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
        formula_of(replace(QUANTITIES["viscous"], column=column))


@pytest.mark.parametrize("chain", [everything(), EVERYTHING], ids=["slots", "terms"])
def test_statements_are_the_model(chain):
    """With a name for every parameter, as a page works them out."""
    rng = np.random.default_rng(2)
    vectors = rng.uniform(0.1, 0.6, (20, len(chain.names)))
    q, qd, qdd = rng.normal(size=(3, 20))
    names = np.array([Varying(f"p{k}") for k in range(len(chain.names))], dtype=object)
    made = Statements()
    torque = made.torque(chain, names).formula
    at = {"q": q, "v": qd, "a": qdd, "s": np.sign(qd)}
    at |= {f"p{k}": x for k, x in enumerate(vectors.T)}
    for name, formula in made.used(torque):
        if name:
            at[name] = value(formula, at)
    load = chain.tables(vectors).load
    gain, offset = load[:, kernels.GAIN], load[:, kernels.OFFSET]
    motion = (q, qd, qdd)
    wanted = inverse_torque(chain, vectors, *motion, inputs=AT_ROOM, time=np.zeros(20))
    assert at[torque] == pytest.approx(gain * np.diag(wanted) - offset, rel=1e-12)
