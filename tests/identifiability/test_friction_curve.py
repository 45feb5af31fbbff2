"""Friction curves: what they must be at no load, along the ridge, and around the truth."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.identifiability.friction_curve import (
    band,
    covered,
    friction_curves,
    friction_torque,
)
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.inverse import inverse_torque, load_reach
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.mechanism.scaling import scalings
from tests.report.conftest import build

KNEE = PRESETS["rabbit-knee"].chain()
TRUTH = KNEE.vector(PRESETS["rabbit-knee"].values)
SPEED = np.concatenate([np.linspace(-100, -1, 9), np.linspace(1, 100, 9)])


@pytest.fixture(scope="module")
def knee():
    return build()


@pytest.fixture(scope="module")
def curves(knee):
    return friction_curves(knee)


def friction(chain, values, load=0.0, *, open_scale=True):
    return friction_torque(
        chain,
        np.atleast_2d(values),
        SPEED,
        np.broadcast_to(load, SPEED.shape),
        open_scale=open_scale,
    )


def test_at_no_load_it_is_the_total_constant_and_viscous_loss():
    total = {q.name: float(q.values[0]) for q in derive(KNEE, TRUTH[None], 1.0)}
    positive, negative = (total[f"total_drive.coulomb_{s}"] for s in ("positive", "negative"))
    # speed in rad/s of the motor, as the total viscous loss wants it
    viscous = total["total_drive.viscous"] * np.abs(SPEED)
    expected = np.where(SPEED > 0, positive, negative) + viscous
    np.testing.assert_allclose(friction(KNEE, TRUTH)[0], expected, rtol=1e-12)


@pytest.mark.parametrize("open_scale", [True, False])
def test_it_is_the_inverse_models_torque_without_the_load(open_scale):
    """A leg held at q weighs g ml sin(q); lifting and lowering it at one speed."""
    p = PRESETS["rabbit-knee"].values
    q = np.linspace(-1.4, 1.4, 18)
    torque = inverse_torque(KNEE, TRUTH, q, SPEED / 50.0, np.zeros(18))
    weight = 9.80665 * p["load.first_moment"] * np.sin(q) / 50.0
    if open_scale:
        weight = weight * (2.0 + p["gearbox.load_drive"] - p["gearbox.load_back"]) / 2.0
    sign = np.sign(SPEED)
    loss = friction(KNEE, TRUTH, sign * weight, open_scale=open_scale)[0]
    np.testing.assert_allclose(loss, sign * (torque - weight), rtol=1e-11)


@pytest.mark.parametrize("factor", [0.75, 1.3])
def test_the_ridge_leaves_it_alone(knee, factor):
    (scaling,) = scalings(KNEE)
    both = np.stack([TRUTH, scaling.scaled(TRUTH, factor)])
    for load in (-0.3, -0.05, 0.0, 0.02, 0.4):
        first, second = friction(KNEE, both, load)
        np.testing.assert_allclose(second, first, rtol=1e-10)
    # but over the torque of the load itself it would not be left alone
    first, second = friction(KNEE, both, 0.4, open_scale=False)
    assert np.abs(second / first - 1).min() > 0.02
    # and recordings lie at the same places all along the ridge
    first, second = (covered(knee.chain, knee.observations, x, open_scale=True) for x in both)
    np.testing.assert_allclose(second, first, rtol=1e-10, atol=1e-14)


def test_a_single_mu_needs_no_mean_and_a_gain_of_the_drive_changes_no_friction():
    """Parameters are those of the joint, whatever the drive makes of its torque."""
    preset = PRESETS["servo-pendulum"]
    chain = preset.chain()
    values = chain.vector(preset.values)[None]
    first, second = (load_reach(chain, values, open_scale=is_open) for is_open in (True, False))
    np.testing.assert_allclose(first, second, rtol=1e-14)
    with_gain = replace(chain, gain=True)
    first, second = (
        friction(
            with_gain,
            with_gain.vector(preset.values | {"drive.gain": gain}),
            np.linspace(-1, 1, 18),
        )
        for gain in (1.0, 0.7)
    )
    np.testing.assert_array_equal(second, first)


def test_the_stribeck_rise_shows():
    chain = Joint(
        (Element("motor", coulomb="symmetric", viscous=True, stribeck=True),), Load(inertia=True)
    )
    values = [0.3, 0.01, 0.5, 2.0, 0.1]
    p, v = dict(zip(chain.names, values, strict=True)), np.abs(SPEED)
    rise = 1 + p["motor.stribeck_ratio"] * np.exp(-((v / p["motor.stribeck_velocity"]) ** 2))
    expected = p["motor.coulomb"] * rise + p["motor.viscous"] * v
    np.testing.assert_allclose(friction(chain, values)[0], expected, rtol=1e-13)


# -- bands of a fit


def test_the_band_holds_the_truth(knee, curves):
    """Draws are spread evenly around the truth, so that medians are it within their error."""
    draws = knee.chain_draws()
    for curve in curves:
        true = friction_torque(KNEE, TRUTH[None], curve.speed, curve.load, open_scale=True)[0]
        moving = curve.speed != 0.0
        assert (curve.ends[0] < true)[moving].all()
        assert (true < curve.ends[2])[moving].all()
        values = friction_torque(KNEE, draws, curve.speed, curve.load, open_scale=True)
        # 1000 of the draws give the ends of the interval to 10 % of its width
        width = curve.ends[2] - curve.ends[0]
        for end, share in ((curve.ends[0], 0.05), (curve.ends[2], 0.95)):
            assert (np.abs(end - np.quantile(values, share, axis=0)) < 0.1 * width)[moving].all()


def test_places_are_where_the_recordings_ran(knee, curves):
    speed = 50.0 * np.concatenate([o.speed for o in knee.observations])
    for curve in curves:
        assert curve.speed.min() >= speed.min() - 1e-9
        assert curve.speed.max() <= speed.max() + 1e-9
        assert np.isnan(curve.median[curve.speed == 0.0]).all()
    assert float(curves[0].load[0]) == 0.0
    assert {np.sign(c.load[0]) for c in curves} == {-1.0, 0.0, 1.0}


def test_what_is_as_wide_as_before_is_not_determined(knee):
    def at_50(x):
        return friction_torque(KNEE, x, np.array([50.0]), np.zeros(1), open_scale=True)

    (low, median, high), determined = band(knee, at_50)
    assert low < median < high
    assert determined.all()
    rng, posterior = np.random.default_rng(1), knee.posterior
    drawn = [prior.draw(posterior.log_density.size, rng) for prior in posterior.priors]
    draws = np.stack(drawn, axis=1).reshape(posterior.draws.shape)
    before = replace(knee, posterior=replace(posterior, draws=draws))
    assert not band(before, at_50)[1].any()
