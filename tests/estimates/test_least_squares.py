"""Least squares, eq. (11): closed-form totals, exact recovery."""

import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.estimates.least_squares import least_squares, starting_values
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import PRESETS, Joint

KNEE, AXIS, SERVO = (PRESETS[n] for n in ("rabbit-knee", "motor-axis", "servo-pendulum"))


def test_closed_form_totals_where_alpha_is_one(make_observation):
    chain = KNEE.chain()
    v = KNEE.values | {"gearbox.load_drive": 0.0, "gearbox.load_back": 0.0}
    totals = least_squares(chain, [make_observation(chain, v, sigma=0.0, factor=4)])
    n = chain.ratio
    expected = {
        "total.inertia": v["motor.inertia"] + v["load.inertia"] / n**2,
        "total.viscous": v["motor.viscous"] + v["joint.viscous"] / n**2,
        "total.coulomb": (v["motor.coulomb_positive"] + v["motor.coulomb_negative"]) / 2
        + (v["joint.coulomb_positive"] + v["joint.coulomb_negative"]) / (2 * n),
        "total.offset": (v["motor.coulomb_positive"] - v["motor.coulomb_negative"]) / 2
        + (v["joint.coulomb_positive"] - v["joint.coulomb_negative"]) / (2 * n),
        "total.gravity": 9.80665 * v["load.first_moment"] / n,
    }
    for name, value in expected.items():
        assert totals[name].value == pytest.approx(value, rel=1e-9), name
    assert totals.residual_rms < 1e-12


def test_sds_are_those_of_repeated_noise(make_observation):
    chain = AXIS.chain()
    noisy = make_observation(chain, AXIS.values, sigma=0.02, n=400, seed=0)
    claimed = least_squares(chain, [noisy])
    o = make_observation(chain, AXIS.values, sigma=0.0, n=400, seed=0)
    rng = np.random.default_rng(1)
    estimates = []
    for _ in range(400):
        noisy = o.measured + 0.02 * rng.standard_normal(o.measured.size)
        x = np.stack([o.qdd, o.qd, np.sign(o.qd), np.ones_like(o.q)], axis=1)
        estimates.append(np.linalg.lstsq(x, noisy, rcond=None)[0])
    spread = np.std(estimates, axis=0)
    # relative error of a sd from 400 repeats is 1/sqrt(800), of the claimed one 1/sqrt(800) too
    for value, sd in zip(claimed.values, spread, strict=True):
        assert value.sd / sd == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / 800.0)), value.name


def test_a_known_mass_tells_the_gain(make_observation):
    chain = SERVO.chain()
    bare = type(chain)(
        elements=(chain.elements[0],),
        load=type(chain.load)(gravity_angle=True),
        gain=True,
    )
    v = {k: x for k, x in SERVO.values.items() if k in bare.names} | {"drive.gain": 0.8}
    v["load.gravity_angle"] = 0.0
    o = make_observation(bare, v, sigma=0.0, added_mass=0.49, radius=0.1)
    totals = least_squares(bare, [o])
    assert totals["total.added_load"].value == pytest.approx(1.0 / 0.8, rel=1e-9)
    assert starting_values(bare, totals, 0.1, 0.5)["drive.gain"] == pytest.approx(0.8, rel=1e-9)


def test_a_motion_that_tells_nothing_is_refused(make_observation):
    chain = AXIS.chain()
    o = make_observation(chain, AXIS.values)
    still = type(o)(**{**vars(o), "qd": np.full_like(o.qd, 2.0), "qdd": np.zeros_like(o.qdd)})
    # constant speed: viscous, constant loss and offset are one constant, inertia nothing
    totals = least_squares(chain, [still])
    assert all(np.isinf(v.sd) for v in totals.values)


def test_what_one_direction_of_motion_cannot_tell_is_left_open(make_observation):
    """Moving one way only, constant loss and offset are one number; the rest is known."""
    chain = AXIS.chain()
    o = make_observation(chain, AXIS.values, sigma=0.0)
    speed = np.abs(o.qd) + 0.1
    torque = 0.01 * o.qdd + 0.05 * speed + 0.2 + 0.02
    one_way = type(o)(**{**vars(o), "qd": speed, "measured": o.filter.apply(torque)})
    totals = least_squares(chain, [one_way])
    assert totals["motor.inertia"].value == pytest.approx(0.01, rel=1e-6)
    assert totals["motor.viscous"].value == pytest.approx(0.05, rel=1e-6)
    assert np.isfinite(totals["motor.inertia"].sd)
    assert np.isinf(totals["motor.coulomb"].sd)
    assert np.isinf(totals["offset"].sd)


def test_fewer_outputs_than_totals_are_refused(make_observation):
    o = make_observation(AXIS.chain(), AXIS.values)
    few = type(o)(**{**vars(o), "measured": o.measured[:3]})
    with pytest.raises(BadInput, match="cannot determine"):
        least_squares(AXIS.chain(), [few])


@pytest.mark.parametrize("preset", PRESETS)
def test_split_totals_add_up_to_the_totals(preset, make_observation):
    """A start must reproduce what it was split from, load losses aside."""
    chain = PRESETS[preset].chain()
    v = {
        k: (0.0 if ".load" in k and "gearbox" in k else x)
        for k, x in PRESETS[preset].values.items()
    }
    o = make_observation(chain, v, sigma=0.0)
    start = starting_values(chain, least_squares(chain, [o]), 0.0, 0.5)
    again = make_observation(chain, start, sigma=0.0)
    size = np.sqrt(np.mean(o.measured**2))
    assert np.sqrt(np.mean((again.measured - o.measured) ** 2)) < 0.05 * size


def test_a_total_without_a_part_of_the_motor_is_shared_by_the_others(make_observation):
    parts = Element("gearbox", viscous=True, ratio=2.0), Element("joint", viscous=True)
    chain = Joint((Element("motor", inertia=True), *parts), Load(inertia=True))
    true = {"motor.inertia": 0.01, "gearbox.viscous": 0.2, "joint.viscous": 0.3}
    o = make_observation(chain, true | {"load.inertia": 0.02}, sigma=0.0)
    start = starting_values(chain, least_squares(chain, [o]), 0.0, 0.5)
    # both at the input of the gearbox, whose ratio a friction of the joint passes twice
    assert start["gearbox.viscous"] + start["joint.viscous"] / 4.0 == pytest.approx(0.2 + 0.3 / 4.0)
