"""A band in which noise of the acceleration takes part of the inertia is found, and no other."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

import bayesfric as bf
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
    requested = bf.Model(AXIS, recording, processing={"decimate": 10})
    chosen = bf.Model(AXIS, recording)
    (o,) = chosen.observations
    assert o.settings["band_by"] == "model"
    assert any("band: ends at" in step for step in o.steps)
    lost, left = 1.0 - inertia(requested), abs(1.0 - inertia(chosen))
    # the noise's power in a band grows at least with its width to the third, the motion's does not
    assert lost > 0.3
    assert left < 0.5 * lost
    # what was asked for is left as it is, and doubted
    (doubt,) = [row for row in bf.check(requested).record["doubts"] if row["kind"] == "attenuated"]
    ((used, narrower),) = doubt["bands"].values()
    assert used == pytest.approx(RATE / 20)
    assert narrower < used
    # with the torque's rate beside the totals, and without: they are near each other
    assert doubt["times"] == pytest.approx(inertia(chosen) / inertia(requested), rel=0.5)


def test_white_noise_and_encoders_leave_the_band_alone():
    """Chance narrows few: 1.7 sds of both bands are 3 or more of what differs between them."""
    for seed in range(20):
        model = bf.Model(AXIS, swinging(0.0, seed))
        assert model.observations[0].settings["band_by"] == "sampling"
        assert not [row for row in bf.check(model).record["doubts"] if row["kind"] == "attenuated"]
