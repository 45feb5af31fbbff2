"""Formulas that columns and kernels write down of themselves are what these give."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bayesfric.export.written_law import Traced, Unwritten, statements, torque_of
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.quantities import CYCLES, QUANTITIES, State
from bayesfric.recordings.measurement import AT_ROOM

from ..report.conftest import EVERYTHING
from .joints import EVERYTHING as SLOTS

COLUMNS = {
    row.name: row
    for row in (*QUANTITIES.values(), *(q for wave in CYCLES.values() for q in wave(7)))
    if row.column is not None and row.role == "own"
}


NUMPY = {"fabs": np.abs, "fmax": np.maximum, "fmin": np.minimum, "atan": np.arctan}
NUMPY |= {"pow": np.power, **vars(np)}


def formula_of(row):
    """Write a column down in the names of a state."""
    torque = torque_of(
        row, State(*map(Traced, State._fields)), *[Traced("shape")] * bool(row.shape)
    )
    return torque.formula if isinstance(torque, Traced) else torque


def value(formula, at):
    """Work a formula out with NumPy's own functions."""
    return eval(str(formula), NUMPY, at)


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


@pytest.mark.parametrize("chain", [SLOTS, EVERYTHING], ids=["slots", "terms"])
def test_statements_are_the_model(chain):
    rng = np.random.default_rng(2)
    vector = rng.uniform(0.1, 0.6, len(chain.names))
    q, qd, qdd = motion = rng.normal(size=(3, 20))
    at = {"q": q, "v": qd, "a": qdd, "s": np.sign(qd)}
    for name, formula in statements(chain, vector):
        if name:
            at[name] = value(formula, at)
    torque = inverse_torque(chain, vector, *motion, inputs=AT_ROOM, time=np.zeros(20))
    assert at["measured"] == pytest.approx(torque, rel=1e-12)
