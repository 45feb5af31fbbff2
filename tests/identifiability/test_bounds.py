"""Which noise identify's sds are for, and what a bound does to them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import bayesfric as bf
from bayesfric.commands.identify import identify_text
from bayesfric.identifiability.identification import _cut

AXIS = bf.Joint.preset("motor-axis")


def model(memory, seed=1, joint=AXIS, **more):
    """A SIMULATED axis or pendulum whose torque has noise that remembers, taken for white."""
    made = replace(joint).simulate(
        {}, rate=200, duration=20.0, excitation="multisine", amplitude=1.0, torque_noise=0.0
    )
    white = np.random.default_rng(seed).standard_normal(len(made))
    noise = 0.03 * np.sqrt(1.0 - memory**2) * lfilter([1.0], [1.0, -memory], white)
    t, q, torque = (made[name].to_numpy() for name in ("time", "position", "torque"))
    recording = bf.Recording.from_arrays(t, q, torque + noise, name="run")
    options = {"noise": {"model": "white"}, "processing": {"band": "10 Hz", "dead_zone": 0}}
    return bf.Model(joint, recording, **(options | more))


def test_a_normal_halved_at_a_bound_is_what_draws_beyond_it_leave():
    rng = np.random.default_rng(2)
    root = rng.standard_normal((3, 3))
    draws = rng.standard_normal((400_000, 3)) @ root.T
    expected = np.cov(draws[draws[:, 1] > 0.0].T)
    found = _cut(root @ root.T, [None, "lower", None])
    # an entry of the covariance of n draws is known to about sqrt(2/n) of the sds' product, 0.3 %
    sds = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        found / np.outer(sds, sds), expected / np.outer(sds, sds), atol=0.012
    )
    np.testing.assert_array_equal(_cut(root @ root.T, [None] * 3), root @ root.T)


def test_the_footnote_says_which_noise_the_sds_are_for():
    """Only of white noise are they an estimate's."""
    seen = model(0.97)
    text = "\n".join(identify_text(seen.identification(), seen))
    assert "(white)" in text
    assert "estimate weighs all residuals alike" not in text
    remembers = model(0.97, noise={"model": "auto"})
    text = "\n".join(identify_text(remembers.identification(), remembers))
    assert "(AR(" in text
    assert "estimate weighs all residuals alike" in text


def test_a_limit_is_not_called_determined():
    """Without a load loss in the recording its alphas stand at one: what fit calls the bounds'."""
    pendulum = bf.Joint.preset("servo-pendulum")
    values = {"gearbox.load": 0.0, "motor.coulomb": 0.1}
    made = pendulum.simulate(values, rate=200, duration=10.0, excitation="multisine",
                             amplitude=1.0, torque_noise=0.05, seed=3)  # fmt: skip
    t, q, torque = (made[name].to_numpy() for name in ("time", "position", "torque"))
    # an efficiency above one, which is none, is asked for: the loss is held at zero
    lifted = torque - 0.02 * np.abs(torque) * np.sign(np.gradient(q, t))
    found = bf.Model(pendulum, bf.Recording.from_arrays(t, q, lifted)).identification()
    (loss,) = (p for p in found.parameters if p.name == "gearbox.load")
    assert loss.on_bound == "lower"
    named = {one.name: one for one in found.combinations}
    assert named["gearbox.alpha_drive"].on_bound == "lower"
    # of half a normal 1 - 2/pi of the variance is left, and less is missing of what goes along
    left = np.sqrt(1.0 - 2.0 / np.pi)
    whole = np.hypot(1.0 / loss.data_sd, 1.0 / loss.prior_sd) ** -1
    assert loss.expected_sd == pytest.approx(left * whole, rel=1e-3)
    drive = named["total_drive.gravity_size"]
    assert left * 0.99 < drive.expected_sd / drive.data_sd < 0.99
    determined = [one.name for one in found.determined]
    assert "total_drive.gravity_size" in determined
    assert not any("alpha" in name or "efficiency" in name for name in determined)
