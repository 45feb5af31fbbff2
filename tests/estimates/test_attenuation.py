"""A band in which noise of the acceleration takes part of the inertia is found, and no other."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

import bayesfric as bf
from bayesfric.estimates.attenuation import _fit_band
from bayesfric.mechanism.forward import simulate
from tests.axis import AXIS, VALUES

pytestmark = pytest.mark.usefixtures("nothing_explained")

RATE, FINE = 200.0, 20


def swinging(shaken, seed, duration=10.0):
    """SIMULATED: near its own rhythm, where gravity and inertia cancel and little torque is left.

    Stamps wander by ``shaken`` s (sd), from one to the next but little: that is noise of the
    position that grows with speed, and none where positions are looked at for their noise.
    """
    rng = np.random.default_rng(seed)
    step = 1.0 / (RATE * FINE)
    time = np.arange(round((duration + 0.2) / step)) * step
    own = np.sqrt(9.81 * VALUES["load.first_moment"] / VALUES["motor.inertia"])
    torque = np.sin(0.85 * own * time) + 0.3 * np.sin(0.31 * own * time + 1.0)
    motion = simulate(AXIS, AXIS.vector(VALUES), torque, step, substeps=1)
    stamps = np.arange(round(duration * RATE)) / RATE + 0.1
    wander = gaussian_filter1d(rng.standard_normal(stamps.size), 2.0)
    position = np.interp(stamps + shaken * wander / wander.std(), time, motion.q)
    torque = np.interp(stamps, time, torque) + 0.02 * rng.standard_normal(stamps.size)
    return bf.Recording.from_arrays(stamps - 0.1, position, torque, name=f"swinging-{seed}")


def inertia(model):
    """By plain least squares, over the true one."""
    return model.estimate("least-squares").loc["motor.inertia", "value"] / VALUES["motor.inertia"]


@pytest.mark.parametrize("seed", range(4))
def test_the_band_ends_where_the_acceleration_is_noise(seed):
    recording = swinging(0.001, seed)
    asked = bf.Model(AXIS, recording, processing={"decimate": 10})
    chosen = bf.Model(AXIS, recording)
    (o,) = chosen.observations
    assert o.settings["band_by"] == "model"
    assert any("band: ends at" in step for step in o.steps)
    lost, left = 1.0 - inertia(asked), abs(1.0 - inertia(chosen))
    # the noise's power in a band grows at least with its width to the third, the motion's does not
    assert lost > 0.3
    assert left < 0.5 * lost
    # what was asked for is left as it is, and doubted
    (doubt,) = [one for one in bf.check(asked).record["doubts"] if one["kind"] == "attenuated"]
    ((used, narrower),) = doubt["bands"].values()
    assert used == pytest.approx(RATE / 20)
    assert narrower < used
    # with the torque's rate beside the totals, and without: they are near each other
    assert doubt["times"] == pytest.approx(inertia(chosen) / inertia(asked), rel=0.5)


def test_white_noise_and_encoders_leave_the_band_alone():
    """Chance narrows few: 1.7 sds of both bands are 3 or more of what differs between them."""
    for seed in range(20):
        model = bf.Model(AXIS, swinging(0.0, seed))
        assert model.observations[0].settings["band_by"] == "sampling"
        assert not [one for one in bf.check(model).record["doubts"] if one["kind"] == "attenuated"]


def test_what_a_band_shows_is_least_squares_beside_what_a_delay_would_leave():
    """Totals, and the change of the measured torque a second; the residual's power a hertz."""
    recording = swinging(0.0, 3)
    model = bf.Model(AXIS, recording, processing={"decimate": 5, "lowpass": "30 Hz"})
    (o,) = model.observations
    (found,) = (_fit_band(AXIS, r, o) for r in model.recordings)
    rate = np.gradient(o.torque, 1.0 / RATE)
    by = {
        "motor.inertia": o.qdd, "motor.viscous": o.qd, "motor.coulomb": np.sign(o.qd),
        "load.first_moment": np.sin(o.q), "offset": np.ones(o.q.size), "delay": rate,
    }  # fmt: skip
    x = np.stack([o.filter.apply(column) for column in by.values()], axis=1)
    value, (squares,), *_ = np.linalg.lstsq(x, o.measured, rcond=None)
    free = o.measured.size - 6
    spread = np.sqrt(squares / free * np.linalg.inv(x.T @ x)[0, 0])
    # derivatives of the torque differ by what lies between samples
    assert found.inertia == pytest.approx(value[0], abs=0.1 * spread)
    assert found.sd == pytest.approx(spread, rel=0.02)
    assert found.free == free
    assert found.band == pytest.approx(0.5 / o.period)
    assert found.left == pytest.approx(squares / free / found.band, rel=0.02)
    few = bf.Model(AXIS, recording, processing={"decimate": 40, "lowpass": "2.5 Hz"})
    assert _fit_band(AXIS, few.recordings[0], few.observations[0]) is None
    massless = bf.Joint([bf.Element("motor", coulomb="symmetric", viscous=True)])
    assert _fit_band(massless, model.recordings[0], o) is None
