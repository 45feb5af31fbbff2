"""What no motion tells apart, with the terms that repeat or pull back: said before sampling."""

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.mechanism.inverse import inverse_torque
from tests.axis import swing

VALUES = {
    "motor.inertia": 0.05,
    "motor.coulomb": 0.2,
    "motor.viscous": 0.1,
    "load.first_moment": 0.3,
}


def identified(load, more, amplitude):
    """Look at an exact motion of a motor that swings a load without a gear."""
    joint = bf.Joint(
        [bf.Element("motor", inertia=True, coulomb="symmetric", viscous=True)],
        load=bf.Load(first_moment=True, **load),
    )
    time = np.arange(4000) * 0.002
    lines = ((0.4, 0.8), (1.1, 0.4), (2.7, 0.15))
    q, qd, qdd = swing(time, [(f, amplitude * a) for f, a in lines])
    torque = inverse_torque(joint, joint.vector(VALUES | more), q, qd, qdd, time=time)
    torque += 0.01 * np.random.default_rng(1).standard_normal(time.size)
    return bf.Model(joint, bf.Recording.from_arrays(time, q, torque)).identification()


def test_a_ripple_once_a_turn_is_gravity():
    more = {"load.cogging_sin_1": 0.05, "load.cogging_cos_1": 0.02}
    result = identified({"cogging": (1,)}, more, 1.0)
    (row,) = result.directions
    assert row.kind == "null"
    assert set(row.exponents) == {"load.first_moment", "load.cogging_sin_1"}
    # the cosine gravity does not have
    assert np.isfinite(result.frame.loc["load.cogging_cos_1", "data_sd"])


@pytest.mark.parametrize(("amplitude", "identified_by_data"), [(0.15, False), (1.5, True)])
def test_a_spring_is_gravity_as_long_as_the_swing_is_small(amplitude, identified_by_data):
    result = identified({"spring": True}, {"load.spring": 0.2}, amplitude)
    sd = result.frame.loc["load.spring", "data_sd"]
    # of a small swing the sine is the angle but for its sixth of a cube
    assert (sd < 0.01) == identified_by_data
    assert [row.kind for row in result.directions] == ([] if identified_by_data else ["weak"])
