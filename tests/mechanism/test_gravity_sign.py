"""Gravity of the other sign: the joint hangs where it stood, in every path through the model."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.point_estimate import Estimate, Estimation, Knowledge
from bayesfric.identifiability.next_recording import _equilibrium
from bayesfric.inference.coordinates import choose_coordinates
from bayesfric.inference.fitting import make_target, read_priors
from bayesfric.mechanism.configuration import ElementOptions, LoadOptions, MechanismOptions
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import PRESETS

from .joints import signal

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


def test_inverse_and_forward_are_those_half_a_turn_on(case):
    chain, turned, values = case
    x = chain.vector(values)
    q, qd, qdd = np.random.default_rng(1).normal(size=(3, 200))
    torque = inverse_torque(chain, x, q + np.pi, qd, qdd)
    np.testing.assert_allclose(inverse_torque(turned, x, q, qd, qdd), torque, atol=1e-12)
    push = 0.3 * signal(2e-3)
    above = simulate(turned, x, push, 2e-3, q0=0.1)
    below = simulate(chain, x, push, 2e-3, q0=0.1 + np.pi)
    np.testing.assert_allclose(above.q, below.q - np.pi, atol=1e-9)
    np.testing.assert_allclose(above.qd, below.qd, atol=1e-9)


def test_it_hangs_where_gravity_pulls_it_back(case):
    _, turned, values = case
    x = turned.vector(values)
    rest = _equilibrium(turned, x, 0.4)
    torque = inverse_torque(turned, x, [rest - 0.1, rest, rest + 0.1], np.zeros(3), np.zeros(3))
    assert torque[0] < 0.0 < torque[2]
    assert torque[1] == pytest.approx(0.0, abs=1e-12)


def test_likelihoods_agree_and_coordinates_round_trip(case, make_observation):
    _, turned, values = case
    o = make_observation(turned, values, n=800, factor=2, amplitude=2.0)
    priors = read_priors(turned, {}, [o])
    assert priors["load.first_moment"].upper > 0.0
    target = make_target(turned, [o], priors, "shared")
    x = np.concatenate([[values[name] for name in target.free], [0.01]])
    rows = x * (1.0 + 0.02 * np.random.default_rng(2).standard_normal((50, x.size)))
    u = target.from_parameters(rows)
    back, jacobian = target.to_parameters(u)
    np.testing.assert_allclose(back, rows, rtol=1e-8)
    assert np.isfinite(jacobian).all()
    prepared = target.precomputed(u)
    np.testing.assert_allclose(prepared(u), target(u), rtol=1e-7)
    # numbers of the coordinates are those of the same joint under gravity's usual sign
    usual = choose_coordinates(upside_down(turned), priors)
    k = len(target.free)
    np.testing.assert_allclose(usual.from_parameters(rows[:, :k]), u[:, :k], rtol=1e-12)


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
