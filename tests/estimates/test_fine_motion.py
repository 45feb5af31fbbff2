"""The motion above the encoder's low-pass: when it turns round, and what torque it takes."""

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.estimates.least_squares import least_squares
from bayesfric.estimates.processing import fine_motion
from bayesfric.mechanism.experiment import current_loop, multisine
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.filters import lowpass
from tests.axis import AXIS, VALUES

RATE, FINE, COUNTS = 500.0, 20, 4096


def simulated(seed):
    """SIMULATED finely: friction takes a third of the torque; exact speed at the samples, too."""
    rng = np.random.default_rng(seed)
    step = 1.0 / (RATE * FINE)
    time = np.arange(round(10.0 * RATE) * FINE) * step
    command = multisine(time, 0.63, (0.31, 0.73, 1.37, 2.9, 5.3), seed=seed)
    torque = current_loop(command, step, 0.003)
    motion = simulate(AXIS, AXIS.vector(VALUES), torque, step, substeps=1)
    counts = np.round(motion.q[::FINE] * COUNTS / (2 * np.pi))
    noise = 0.003 * rng.standard_normal(counts.size)
    columns = time[::FINE], counts * 2 * np.pi / COUNTS, torque[::FINE] + noise
    recording = bf.Recording.from_arrays(*columns, name=f"bench-{seed}")
    return bf.Model(AXIS, recording), motion.qd[::FINE]


@pytest.fixture(scope="module")
def bench():
    return simulated(8)


def turns(speed):
    """Places, in samples, where a speed ``(N,)`` changes its sign."""
    k = np.flatnonzero(speed[1:] * speed[:-1] < 0.0)
    return k + speed[k] / (speed[k] - speed[k + 1])


def test_it_turns_round_when_the_joint_does(bench):
    """Friction lets a low-passed speed cross zero late, where it brakes more than it speeds up."""
    model, exact = bench
    (encoder,), (fine,) = model.encoder, model.observations
    true = turns(exact)[2:-2]
    late = {}
    for name, speed in (("encoder", encoder.qd), ("fine", fine.qd)):
        places = turns(speed)
        nearest = places[np.abs(places - true[:, None]).argmin(axis=1)] - true
        late[name] = np.median(np.abs(nearest))
    assert late["fine"] < 0.3 * late["encoder"]
    assert late["fine"] < 1.0


def test_above_the_low_pass_the_model_takes_the_measured_torque(bench):
    """Well above it; of all but what sticks, which no acceleration tells."""
    model, _ = bench
    (encoder,), (fine,), (recording,) = model.encoder, model.observations, model.recordings
    settings = encoder.settings
    left = {}
    for name, o in (("encoder", encoder), ("fine", fine)):
        torque = inverse_torque(
            AXIS, AXIS.vector(VALUES), o.q, o.qd, o.qdd, inputs=o.inputs, time=o.stamps
        )
        rest = fine.compared - torque
        above = rest - lowpass(
            rest, recording.segments, RATE, 2.0 * float(settings["lowpass"]), int(settings["order"])
        )
        left[name] = np.median(np.abs(above)[50:-50])
    assert left["fine"] < 0.2 * left["encoder"]


def test_below_the_low_pass_it_is_the_encoders(bench):
    model, _ = bench
    (encoder,), (fine,), (recording,) = model.encoder, model.observations, model.recordings
    end, order = float(encoder.settings["lowpass"]), int(encoder.settings["order"])
    both = [
        lowpass(o.qdd, recording.segments, RATE, 0.5 * end, order)[100:-100]
        for o in (encoder, fine)
    ]
    assert np.std(both[1] - both[0]) < 1e-2 * np.std(both[0])


@pytest.mark.parametrize(
    "processing",
    [
        {"differentiation": "central"},  # as in published analyses
        {"decimate": 1},  # no filter parts what is compared from the rest
        {"lowpass": "10 Hz", "decimate": 20},  # the band ends above half of the low-pass
    ],
)
def test_what_the_encoder_alone_is_to_tell_stays(bench, processing):
    model, _ = bench
    other = bf.Model(AXIS, model.given, processing=processing)
    np.testing.assert_array_equal(other.observations[0].qd, other.encoder[0].qd)


def test_a_joint_without_inertia_keeps_its_motion(bench):
    model, _ = bench
    (encoder,), (recording,) = model.encoder, model.recordings
    massless = bf.Joint([bf.Element("motor", coulomb="symmetric", viscous=True)])
    assert fine_motion(massless, np.array([0.1, 0.1]), recording, encoder) is encoder


def test_the_inertia_is_where_it_belongs():
    """SIMULATED, eight recordings: 2 to 3 sds too large by the encoder's motion alone."""
    z = {"encoder": [], "fine": []}
    for seed in range(20, 28):
        model, _ = simulated(seed)
        for name, observations in (("encoder", model.encoder), ("fine", model.observations)):
            estimate = least_squares(AXIS, observations)
            z[name].append((estimate["motor.inertia"].value - 0.05) / estimate["motor.inertia"].sd)
    assert np.mean(z["encoder"]) > 1.5
    # the mean of eight standard normals has an sd of 0.35
    assert abs(np.mean(z["fine"])) < 1.05
