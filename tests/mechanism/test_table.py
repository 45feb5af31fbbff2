"""What the table of quantities says of a row follows from the row's column: by units, by energy."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pint
import pytest

from bayesfric.estimates.least_squares import least_squares
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import (
    CYCLES,
    QUANTITIES,
    TOTALS,
    State,
    TypicalSizes,
    scales_with_torque,
    turned,
)
from tests.mechanism.joints import KNEE

ROWS = {
    row.name: row
    for row in (*QUANTITIES.values(), *(q for wave in CYCLES.values() for q in wave(3)))
}
# what the table tells of a coefficient, of what its column is made of, and of nothing else
SIMPLE = {n: r for n, r in ROWS.items() if r.column is not None and r.role == "own"}
MOTIONS = "rotary", "linear"


def states(n=60, seed=1):
    rng = np.random.default_rng(seed)
    speed = 3.0 * rng.standard_normal(n)
    return State(
        rng.standard_normal(n),
        speed,
        20.0 * rng.standard_normal(n),
        np.sign(speed),
        5.0 * rng.random(n),
        rng.standard_normal(n),
        9.8 * rng.standard_normal(n),
    )


def column(row, state):
    return np.broadcast_to(row.column(state, *((0.7,) if row.shape else ())), state.speed.shape)


@cache  # takes half a second, which every process that collects tests would spend
def units():
    return pint.UnitRegistry()


def unit_of(text):
    return units().Unit(text) if text else units().dimensionless


def grows(scaled, base, factor):
    """The power of a factor that a column grows with; nothing where there is none."""
    shown = np.abs(base) > 1e-12
    if (scaled[shown] * base[shown] <= 0.0).any():
        return None
    powers = np.log(scaled[shown] / base[shown]) / math.log(factor)
    return round(float(powers.mean()), 6) if np.ptp(powers) < 1e-9 else None


def moved(state, r):
    return state._replace(
        position=r * state.position, speed=r * state.speed, acceleration=r * state.acceleration
    )


@pytest.mark.parametrize("name", SIMPLE)
def test_a_power_is_how_the_column_grows_with_the_motion(name):
    row, base = SIMPLE[name], states()
    power = grows(column(row, moved(base, 1.7)), column(row, base), 1.7)
    assert row.power == (None if row.shape or row.signal else power)


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("name", SIMPLE)
def test_a_unit_times_its_column_is_a_torque(name, motion):
    """The column's own unit by what it does when seconds, and metres, are others."""
    row, base = SIMPLE[name], states()
    if motion == "linear" and not row.unit(motion):
        assert name == "first_moment"  # a weight that slides is a constant
        return
    if row.signal == "torque_rate":
        known = units().Unit("N m / s") if motion == "rotary" else units().Unit("N/s")
    elif name == "first_moment":
        known = units().Unit("m / s**2")
    else:
        slower = base._replace(
            speed=base.speed / 2.0, acceleration=base.acceleration / 4.0, time=2.0 * base.time
        )
        if row.shape == "warming_time":  # it takes twice as many of seconds half as long
            scaled = row.column(slower, 1.4)
        else:  # a power is given at a speed of one
            scaled = column(row, base if name == "power" else slower)
        known = units().second ** grows(scaled, column(row, base), 2.0)
        if motion == "linear" and name != "power" and not any(x in name for x in ("sin", "cos")):
            known *= units().metre ** grows(column(row, moved(base, 2.0)), column(row, base), 2.0)
        if row.signal == "temperature":
            known *= units().kelvin
    whole = unit_of(row.unit(motion)) * known
    wanted = units().Unit("N m") if motion == "rotary" else units().newton
    assert whole.dimensionality == wanted.dimensionality


def sizes(motion, force, metre, second):
    """TypicalSizes in units of which one is so many of the SI's, all else alike."""
    angle = metre if motion == "linear" else 1.0
    effort = force if motion == "linear" else force * metre
    return TypicalSizes(
        3.0 * effort,
        2.0 * angle / second,
        7.0 * angle / second**2,
        9.8 * metre / second**2,
        lean=0.6,
        position=angle,
        duration=20.0 * second,
    )


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("name", [n for n, r in ROWS.items() if r.spread or r.tries])
def test_what_is_likely_of_a_quantity_goes_with_its_unit(name, motion):
    """A spread, and values to try, are the same whatever the units they are worked out in."""
    row = ROWS[name]
    if motion == "linear" and name == "first_moment":
        return
    scale = 2.0, 3.0, 5.0
    powers = unit_of(row.unit(motion)).dimensionality
    # newtons take up the mass
    mass, length, time = (powers.get(f"[{x}]", 0) for x in ("mass", "length", "time"))
    factor = scale[0] ** mass * scale[1] ** (length - mass) * scale[2] ** (time + 2 * mass)
    for likely in filter(None, (row.spread, row.tries)):
        here, there = (np.array(likely(sizes(motion, *x))) for x in ((1.0, 1.0, 1.0), scale))
        np.testing.assert_allclose(there, here * factor, rtol=1e-12)
        assert (here > 0.0).all()
        assert (here <= row.upper).all()
        assert (np.diff(np.atleast_1d(here)) > 0.0).all()


@pytest.mark.parametrize("name", ROWS)
def test_what_cannot_be_negative_loses_energy_or_stores_it(name):
    """And stored energy comes back: a closed swing takes none."""
    row = ROWS[name]
    assert row.lower < row.upper
    for value in filter(lambda x: x is not None, (row.default, row.start)):
        assert row.lower <= value <= row.upper
    if row.role == "form" or row.signal:
        return
    if row.lower == 0.0 and not row.stores:
        base = states()
        assert (column(row, base) * base.speed >= 0.0).all()
        assert (column(row, base) * base.speed > 0.0).any()
    # what repeats over the angle no simulator has, and a constant torque is the motor's
    if row.option not in CYCLES and name != "offset":
        time = np.linspace(0.0, 2.0 * np.pi, 4001)
        q = 0.8 * np.sin(time) + 0.3 * np.cos(2.0 * time)
        qd, qdd = 0.8 * np.cos(time) - 0.6 * np.sin(2.0 * time), -0.8 * np.sin(time)
        qdd = qdd - 1.2 * np.cos(2.0 * time)
        state = State(q, qd, qdd, np.sign(qd), time, 1.0, 9.8 * np.sin(q + 0.3))
        work = np.trapezoid(column(row, state) * qd, time)
        assert row.stores == (abs(work) < 1e-6)


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("name", ROWS)
def test_a_wrong_torque_constant_multiplies_what_has_one_mass_in_its_unit(name, motion):
    text = ROWS[name].unit(motion)
    mass = unit_of(text).dimensionality.get("[mass]", 0)
    assert scales_with_torque(text) == (mass == 1)


def test_totals_that_are_positive_are_so_in_any_joint_that_loses_energy(make_observation):
    parts = (
        Element("motor", inertia=True, coulomb="by-direction", viscous="by-direction"),
        Element("joint", ratio=3.0, quadratic=True, viscous=True, coulomb="by-direction"),
    )
    chain = Joint(parts, Load(inertia=True, first_moment=True, gravity_angle=True), offset=True)
    rng = np.random.default_rng(4)
    signs = {}
    for seed in range(8):
        values = dict(zip(chain.names, rng.uniform(0.05, 1.0, len(chain.names)), strict=True))
        values |= {"load.gravity_angle": rng.uniform(-3, 3), "offset": rng.normal()}
        o = make_observation(chain, values, sigma=0.0, n=400, seed=seed, amplitude=2.0)
        for total in least_squares(chain, [o]).values:
            signs.setdefault(total.quantity, set()).add(np.sign(total.value))
    assert set(signs) == set(TOTALS) - {"difference", "added_load"}
    for name, values in signs.items():
        assert (TOTALS[name].lower == 0.0) == (values == {1.0}), name
    assert TOTALS["added_load"].lower == 0.0  # one over alpha


LOSSY = Joint(
    (
        Element("motor", inertia=True, viscous=True, coulomb="symmetric"),
        Element("belt", ratio=2.5, coulomb="by-direction", quadratic=True, load_loss="one"),
        Element("gearbox", ratio=6.0, inertia=True, viscous=True, load_loss="two"),
        Element("joint", ratio=1.2, viscous=True, coulomb="symmetric", quadratic=True),
    ),
    Load(inertia=True, first_moment=True),
)


@pytest.mark.parametrize("lossy", [True, False])
@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("side", ["drive", "back"])
def test_a_total_is_what_the_motor_feels_of_all_its_parts(side, way, lossy):
    """Torque with them less that without, beside a weight that says which side drives."""
    parts = LOSSY.elements if lossy else [replace(e, load_loss="none") for e in LOSSY.elements]
    chain = Joint(tuple(parts), LOSSY.load)
    rng = np.random.default_rng(5)
    x = dict(zip(chain.names, rng.uniform(0.1, 0.4, len(chain.names)), strict=True))
    x["load.first_moment"] = 300.0
    lifts = way if side == "drive" else -way
    q, qd, qdd = np.array([0.5 * np.pi * lifts]), np.array([0.02 * way]), np.array([0.05])
    n = chain.ratio
    totals = {d.name: d for d in derive(chain, chain.vector(x)[None], 1.0)}
    direction = "positive" if way > 0 else "negative"
    felt = {
        "inertia": ("inertia", n * qdd[0]),
        "viscous": ("viscous", n * qd[0]),
        "quadratic": ("quadratic", n**2 * qd[0] * abs(qd[0])),
        f"coulomb_{direction}": ("coulomb", way),
        "gravity": ("first_moment", lifts),
    }
    whole = inverse_torque(chain, chain.vector(x), q, qd, qdd)[0]
    for total, (kind, state) in felt.items():
        # what remains of the weight keeps the side
        rest = 0.5 if kind == "first_moment" else 0.0
        less = {k: v * (rest if f".{kind}" in k else 1.0) for k, v in x.items()}
        without = inverse_torque(chain, chain.vector(less), q, qd, qdd)[0]
        seen = (whole - without) / state / (1.0 - rest)
        derived = totals[f"total_{side}.{total}" if lossy else f"total.{total}"]
        assert derived.values[0] == pytest.approx(seen, rel=1e-7), total
        assert derived.gauge_free


def test_what_a_gearbox_does_not_have_is_nan():
    """Without losses no ratio of lambdas; where mu_2 is one, all power that comes back is lost."""
    chain = KNEE.chain()
    losses = {"gearbox.load_drive": np.array([0.0, 0.1, 0.1])}
    losses |= {"gearbox.load_back": np.array([0.0, 0.1, 1.0])}
    vectors = chain.vector({name: np.full(3, x) for name, x in KNEE.values.items()} | losses)
    derived = {d.name: d.values for d in derive(chain, vectors, 1.0)}
    assert np.isnan(derived["gearbox.lambda_ratio"]).tolist() == [True, False, False]
    assert derived["gearbox.lambda_1"][:2] == pytest.approx([1.0, 1.0])
    assert derived["gearbox.lambda_2"][:2] == pytest.approx([0.0, 0.1])
    assert np.isnan(derived["gearbox.alpha_back"]).tolist() == [False, False, True]


@pytest.mark.parametrize("towards", [0.0, 2.0, -9.0])
def test_an_angle_is_turned_to_the_nearest_of_its_turns(towards):
    angles = np.linspace(-20.0, 20.0, 400)
    nearest = turned(angles, towards)
    assert (np.abs(nearest - towards) <= np.pi + 1e-12).all()
    np.testing.assert_allclose(np.exp(1j * nearest), np.exp(1j * angles), atol=1e-12)
