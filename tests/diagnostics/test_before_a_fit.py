"""What makes any fit doubtful, on motions and torques that are known exactly."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.diagnostics.before_a_fit import (
    alternatives,
    best_share,
    doubts_before,
    few_outputs,
    little_explained,
    other_units,
    strange_velocity,
)
from bayesfric.diagnostics.policy import LEAST_OUTPUTS
from bayesfric.estimates.point_estimate import EstimatedValue
from bayesfric.mechanism.joint import PRESETS
from tests.axis import AXIS, VALUES

PENDULUM = bf.Joint([bf.Element("motor", inertia=True, viscous=True)], bf.Load(first_moment=True))
SWUNG = {"motor.inertia": 0.05, "motor.viscous": 0.1, "load.first_moment": 0.3}
EXACT = {"sigma": 0.0, "amplitude": 1.2}


def added(o, extra):
    """One recording with more torque than its model has."""
    torque = o.torque + extra
    return replace(o, torque=torque, compared=torque, measured=o.filter.apply(torque))


def totals(**values):
    rows = [
        EstimatedValue(name.replace("__", "."), "", "", "", value, sd, robust)
        for name, (value, sd, robust) in values.items()
    ]
    return SimpleNamespace(values=rows)


@pytest.mark.parametrize("sigma", [0.01, 0.3])
def test_the_best_share_is_that_of_dense_least_squares(make_observation, sigma):
    observations = [
        make_observation(AXIS, VALUES, sigma=sigma, seed=k, n=900 + 100 * k) for k in (1, 2)
    ]
    rows = [
        np.stack([o.qdd, o.qd, np.sign(o.qd), np.sin(o.q), np.ones_like(o.q)], axis=1)
        for o in observations
    ]
    x, y = np.concatenate(rows), np.concatenate([o.measured for o in observations])
    left = y - x @ np.linalg.lstsq(x, y)[0]
    share, residual = best_share(AXIS, observations)
    assert share == pytest.approx(1.0 - np.var(left) / np.var(y))
    np.testing.assert_allclose(residual, left, atol=1e-9)


def test_what_is_left_unexplained_is_doubted_where_it_is_no_white_noise(make_observation):
    """From a fifth of the variance on."""
    o = make_observation(AXIS, VALUES, **EXACT)
    slow = np.sin(2.0 * np.pi * 9.0 * o.stamps)
    white = np.random.default_rng(1).standard_normal(o.q.size)
    for extra, doubted in ((0.6 * slow, False), (0.85 * slow, True), (1.0 * white, False)):
        observations = [added(o, o.measured.std() * extra)]
        share = best_share(AXIS, observations)[0]
        assert (share < 0.8) == (np.ptp(extra) > 1.5)
        doubts = little_explained(AXIS, observations)
        assert [x["share"] for x in doubts] == [share] * doubted
        assert [x["units"] for x in doubts] == [other_units(AXIS, observations)] * doubted


def test_presets_of_the_ratio_that_have_gravity_are_named_where_there_is_none(
    make_observation,
):
    observations = [make_observation(AXIS, VALUES)]
    weighing = {
        n: p.chain() for n, p in PRESETS.items() if "first_moment" in p.chain().load.choices
    }
    for ratio in (1.0, 50.0):
        bare = bf.Joint([bf.Element("motor", inertia=True, ratio=ratio)], bf.Load())
        told = alternatives(bare, observations, 0.5)["presets"]
        assert told == [name for name, chain in weighing.items() if chain.ratio == ratio]
        assert told
        # not the one that is in use
        mine = replace(bare, made_from=told[0])
        assert told[0] not in alternatives(mine, observations, 0.5)["presets"]
    assert alternatives(AXIS, observations, 0.5)["presets"] == []  # which has gravity
    screw = bf.Joint([bf.Element("motor", inertia=True, motion="linear")], bf.Load(motion="linear"))
    assert alternatives(screw, observations, 0.5) == {
        "units": [],
        "presets": [],
    }  # which needs none


@pytest.mark.parametrize("right", ["rad", "deg", "turn"])
def test_the_unit_that_a_position_was_read_in_wrongly_is_the_first(make_observation, right):
    """Its gravity tells; a right one is not doubted, whichever way it was read."""
    o = make_observation(PENDULUM, SWUNG, **EXACT)
    times = {"rad": 1.0, "deg": np.pi / 180.0, "turn": 2.0 * np.pi}[right]
    # numbers that are in the right unit, taken for radians
    moving = {key: getattr(o, key) / times for key in ("q", "qd", "qdd", "speed")}
    wrong = [replace(o, smooth=np.zeros_like(o.q), **moving)]
    rows = other_units(PENDULUM, wrong)
    if right == "rad":
        assert rows == []
        return
    assert (rows[0]["is"], rows[0]["taken"]) == (right, "rad")
    shares = [row["share"] for row in rows]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] == pytest.approx(1.0)
    # all that are named leave less than half of what is unexplained now
    now = best_share(PENDULUM, wrong)[0]
    assert all(1.0 - share < 0.5 * (1.0 - now) for share in shares)
    assert other_units(PENDULUM, wrong, 1.0) == []


def test_too_few_outputs_say_how_long_would_do():
    def observations(*outputs):
        t = np.linspace(3.0, 5.0, 50)
        return [SimpleNamespace(measured=np.zeros(n), stamps=t) for n in outputs]

    assert list(few_outputs(observations(10, LEAST_OUTPUTS - 5), 5)) == []
    (doubt,) = few_outputs(observations(10, LEAST_OUTPUTS - 6), 5)
    assert doubt["wanted"] == 5 + LEAST_OUTPUTS
    assert doubt["seconds"] == 4.0 * (5 + LEAST_OUTPUTS) / (4 + LEAST_OUTPUTS)


def named(name, **settings):
    return SimpleNamespace(name=name, settings=settings)


def test_what_was_noted_of_recordings_is_told_of_them():
    observations = [
        named("a", velocity_factor=0.0, feedback="sign"), named("b"), named("c", feedback="sign"),
        named("d", feedback="position", velocity_factor=57.3),
        named("e", band_doubted=9.0, band_narrower=4.0, inertia_narrower=1.3),
        named("f", band_doubted=7.0, band_narrower=3.0, inertia_narrower=1.9),
    ]  # fmt: skip
    factors = [(x["recording"], x["factor"]) for x in strange_velocity(observations)]
    assert factors == [("a", 0.0), ("d", 57.3)]
    assert doubts_before(totals(), observations) == [
        {"kind": "feedback", "law": "sign", "recordings": ["a", "c"]},
        {"kind": "feedback", "law": "position", "recordings": ["d"]},
        {"kind": "attenuated", "bands": {"e": [9.0, 4.0], "f": [7.0, 3.0]}, "times": 1.9},
    ]
    assert doubts_before(totals(), observations[1:2]) == []


def test_losses_and_inertias_below_zero_by_three_sds_are_doubted():
    """The larger sd counts; what may have either sign, or bends a curve, is none."""
    rows = doubts_before(
        totals(
            inertia=(-3.1, 1.0, 0.5), viscous=(-3.1, 0.5, 1.0), coulomb=(-2.9, 1.0, 0.5),
            difference=(-9.0, 1.0, 1.0), offset=(-9.0, 1.0, 1.0), quadratic=(-9.0, 1.0, 1.0),
            gravity=(-9.0, 1.0, 1.0), motor__viscous=(-3.1, 1.0, np.nan),
            motor__coulomb=(-9.0, 1.0, np.inf), joint__viscous_positive=(-9.0, 1.0, 2.0),
            gearbox__load=(-9.0, 1.0, 1.0), load__spring=(-9.0, 1.0, 1.0),
        ),
        [],
    )  # fmt: skip
    below = {"inertia": -3.1, "viscous": -3.1, "joint.viscous_positive": -9.0}
    assert rows == [{"kind": "negative", "values": below}]
