"""Gravity of the other sign: the joint hangs where it stood, in every path through the model."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.point_estimate import Estimate, Estimation, Knowledge
from bayesfric.identifiability.next_recording import _equilibrium
from bayesfric.mechanism.configuration import ElementOptions, LoadOptions, MechanismOptions
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import PRESETS

ANGLE = "load.gravity_angle"
KNEE, SERVO = PRESETS["rabbit-knee"], PRESETS["servo-pendulum"]
SINGLE = MechanismOptions(
    preset="rabbit-knee", elements={"gearbox": ElementOptions(load_loss="one")}
).joint()
SINGLE_VALUES = {name: KNEE.values.get(name, 0.2) for name in SINGLE.names}
CASES = {
    "two losses": (KNEE.chain(), KNEE.values),
    "one loss": (SINGLE, SINGLE_VALUES),
    "angle": (SERVO.chain(), SERVO.values),
}


def upside_down(chain):
    return replace(chain, load=replace(chain.load, gravity=-chain.load.gravity))


@pytest.fixture(params=CASES)
def case(request):
    chain, values = CASES[request.param]
    return chain, upside_down(chain), values


def test_a_configuration_takes_either_sign_and_no_zero():
    assert LoadOptions(gravity=-9.8).gravity == -9.8
    for bad in (0.0, float("inf"), float("nan")):
        with pytest.raises(ValidationError):
            LoadOptions(gravity=bad)


def test_it_hangs_where_gravity_pulls_it_back(case):
    _, turned, values = case
    x = turned.vector(values)
    rest = _equilibrium(turned, x, 0.4)
    torque = inverse_torque(turned, x, [rest - 0.1, rest, rest + 0.1], np.zeros(3), np.zeros(3))
    assert torque[0] < 0.0 < torque[2]
    assert torque[1] == pytest.approx(0.0, abs=1e-12)


def test_estimates_find_it(case, make_observation):
    _, turned, values = case
    o = make_observation(turned, values, sigma=0.0, n=1000, factor=2, amplitude=2.0)
    known = {"load.first_moment": values["load.first_moment"]}
    found = input_error(turned, [o], Knowledge(fixed=known), Estimation(starts=2))
    assert isinstance(found, Estimate)
    assert found.residual_rms < 1e-6
    for name, value in found.point:
        assert value == pytest.approx(values[name], rel=1e-3, abs=1e-9), name
    if ANGLE in turned.names:
        free = input_error(turned, [o], Knowledge(), Estimation(starts=2))
        assert dict(free.point)["load.first_moment"] == pytest.approx(known.popitem()[1], rel=1e-3)
