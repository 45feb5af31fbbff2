"""A position that is recorded late: forward and inverse model mean the same by it."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.mechanism.forward import simulate, simulate_segments
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import PRESETS
from bayesfric.recordings.filters import derivative, later
from bayesfric.recordings.measurement import Inputs, Signal
from tests import axis

PERIOD = 1e-3
TIME = np.arange(4000) * PERIOD
AXIS = replace(axis.AXIS, gain=True, delay=True)
VALUES = {**axis.VALUES, "drive.gain": 1.1, "drive.delay": 0.0013}


def torque(time):
    return 2.0 * np.sin(2 * np.pi * 1.1 * time) + 1.2 * np.sin(2 * np.pi * 3.3 * time + 1.0)


@pytest.mark.parametrize("delay", [0.0, 0.0013, -0.0021, 0.02])
def test_the_motion_is_that_of_the_torque_of_before(delay):
    late = simulate(AXIS, AXIS.vector(VALUES | {"drive.delay": delay}), torque(TIME), PERIOD, qd0=1)
    prompt = replace(AXIS, delay=False)
    values = [VALUES[name] for name in prompt.names]
    same = simulate(prompt, values, torque(TIME - delay), PERIOD, qd0=1)
    # of what was before the first sample, or comes after the last, nothing is known
    ends = slice(0, None) if delay < 0.01 else slice(0, 1)
    np.testing.assert_allclose(late.q[ends], same.q[ends], atol=5e-4)
    np.testing.assert_array_equal(late.torque, torque(TIME))


@pytest.mark.parametrize("name", ["axis", "rabbit-knee"])
def test_inverse_of_forward_is_the_torque(name):
    if name == "axis":
        chain, values, scale = AXIS, VALUES, 1.0
    else:
        chain = replace(PRESETS[name].chain(), delay=True)
        values, scale = {**PRESETS[name].values, "drive.delay": 0.0007}, 0.3
    given = scale * torque(TIME)
    motion = simulate(chain, chain.vector(values), given, PERIOD)
    d = values["drive.delay"]
    earlier = later(given, d / PERIOD)
    rate = derivative(earlier, ((0, TIME.size),), PERIOD, 8)
    inputs = Inputs(torque_rate=Signal(TIME, rate))
    q, qd, qdd = motion.q, motion.qd, motion.qdd
    found = inverse_torque(chain, chain.vector(values), q, qd, qdd, inputs=inputs, time=TIME)
    moving = ~motion.sticking & (np.abs(qd) > 1e-3)
    np.testing.assert_allclose(found[moving], (earlier + d * rate)[moving], atol=1e-9)


def test_each_vector_has_its_own():
    vectors = np.stack([AXIS.vector(VALUES | {"drive.delay": d}) for d in (0.0, 0.0013, -0.002)])
    many = simulate_segments(AXIS, vectors, torque(TIME), PERIOD, [[0, 4000]], [0.0], [0.5])[0]
    for vector, q in zip(vectors, many, strict=True):
        one = simulate(AXIS, vector, torque(TIME), PERIOD, qd0=0.5, substeps=2)
        np.testing.assert_array_equal(q, one.q)


def test_what_does_not_know_the_torque_refuses():
    with pytest.raises(ValueError, match="hold no torque_rate"):
        inverse_torque(AXIS, AXIS.vector(VALUES), [0.0], [1.0], [0.0])
