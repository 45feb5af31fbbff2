"""A replicate is a recording like the one it repeats: same motion, same sensor, exact torque."""

from dataclasses import replace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.diagnostics.replicates import fixed_processing, replicates
from bayesfric.fit.model import Model
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.filters import finest_step
from bayesfric.recordings.measurement import Signal
from bayesfric.recordings.observation import observe
from tests.diagnostics.bench import TRUTH, axis, draws_about, model

VALUES = np.array([TRUTH[name] for name in axis().names])


@pytest.fixture(scope="module")
def made():
    return model()


def replayed(made, values, recording=None, observation=None):
    recording = recording or made.recordings[0]
    seeds = np.random.SeedSequence(1).spawn(len(values))
    processing = made.config.tables.processing
    return list(
        replicates(
            made.chain, values, recording, observation or made.observations[0], processing, seeds
        )
    )


def test_a_replay_keeps_to_the_recorded_motion(made):
    recorded = made.observations[0]
    for seen in replayed(made, draws_about(VALUES, 0.1)):
        assert np.std(seen.q - recorded.q) < 0.02 * np.std(recorded.q)
        assert seen.filter.n_outputs == pytest.approx(recorded.filter.n_outputs, rel=0.05)


def test_the_torque_of_a_replay_is_what_made_its_motion(made):
    """Behind the filters the inverse model finds it again, but for steps of the encoder."""
    for values, seen in zip(draws_about(VALUES), replayed(made, draws_about(VALUES)), strict=True):
        torque = inverse_torque(made.chain, values, seen.q, seen.qd, seen.qdd, inputs=seen.inputs)
        left = seen.measured - seen.filter.apply(torque)
        assert np.std(left) < 0.01 * np.std(seen.measured)


def test_a_replay_is_read_in_the_steps_of_the_recording(made):
    recording = made.recordings[0]
    step = finest_step(recording.position)
    assert step == pytest.approx(2 * np.pi / 8192 / 50)
    bare = made.config.tables.processing.model_copy(update={"lowpass": 0.0, "decimate": 10})
    told = {"lowpass": 0.0}
    observation = made.observations[0]
    observation = replace(observation, settings=observation.settings | told)
    seeds = np.random.SeedSequence(1).spawn(1)
    (seen,) = replicates(made.chain, VALUES[None], recording, observation, bare, seeds)
    counts = (seen.q - seen.q[0]) / step
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)


def test_each_segment_is_replayed_from_its_own_state(made):
    recording, processing = made.recordings[0], made.config.tables.processing
    halves = replace(recording, segments=((0, 2400), (2400, recording.time.size)))
    observation = made.observations[0]
    (seen,) = replicates(
        made.chain,
        VALUES[None],
        halves,
        replace(observation, segment_of=(observation.filter.starts >= 2400).astype(int)),
        fixed_processing(processing, observation),
        np.random.SeedSequence(1).spawn(1),
    )
    assert seen.settings["n_segments"] == 2
    assert np.std(seen.q - observation.q) < 0.02 * np.std(observation.q)


def test_a_gain_of_the_drive_divides_the_torque():
    made = model(joint=axis(gain=True))
    values = np.array([[{**TRUTH, "drive.gain": g}[n] for n in made.chain.names] for g in (1, 2)])
    # of the same random numbers
    (one,), (other,) = replayed(made, values[:1]), replayed(made, values[1:])
    np.testing.assert_array_equal(one.q, other.q)
    np.testing.assert_allclose(one.torque, 2.0 * other.torque, atol=1e-9 * np.std(one.torque))


def test_a_measured_velocity_is_replayed_too(made):
    recording, observation = made.recordings[0], made.observations[0]
    rng = np.random.default_rng(2)
    velocity = observation.qd + 1e-3 * rng.standard_normal(observation.qd.size)
    fast = replace(recording, velocity=velocity)
    seen_so = observe(fast, made.config.tables.processing)
    (seen,) = replayed(made, VALUES[None], fast, seen_so)
    assert seen.settings["noise_seen"] == pytest.approx(seen_so.settings["noise_seen"], rel=0.2)
    assert np.std(seen.qd - seen_so.qd) < 0.1 * np.std(seen_so.qd)


def test_a_joint_of_little_inertia_and_much_friction_has_its_motion():
    """A geared wrist: simulated under any torque that is a little off it jerks and sticks."""
    light = axis()
    t = np.arange(5000) / 500.0
    q = 0.3 * np.sin(2 * np.pi * 0.7 * t) + 0.1 * np.sin(2 * np.pi * 1.9 * t)
    qd, qdd = np.gradient(q, t), np.gradient(np.gradient(q, t), t)
    values = VALUES * np.where([n == "motor.inertia" for n in light.names], 1e-3, 1.0)
    torque = inverse_torque(light, values, q, qd, qdd)
    torque += 0.1 * np.std(torque) * np.random.default_rng(1).standard_normal(t.size)
    wrist = Model(light, bf.Recording.from_arrays(t, q, torque, side="joint"))
    recorded = wrist.observations[0]
    for seen in replayed(wrist, draws_about(values, 0.05)):
        assert np.std(seen.q - recorded.q) < 0.01 * np.std(recorded.q)
        assert np.std(seen.qdd) == pytest.approx(np.std(recorded.qdd), rel=0.01)


def test_parameters_without_a_torque_have_no_twin_and_spoil_no_other(made):
    values = draws_about(VALUES)
    values[1, made.chain.names.index("motor.viscous")] = np.nan
    found = replayed(made, values)
    assert [seen is None for seen in found] == [False, True, False, False]


def test_a_torque_beside_the_motion_is_sampled_when_the_motion_is(made):
    """Other inputs of a replicate are sampled at its instants: no loss is needed for them."""
    o, recording = made.observations[0], made.recordings[0]
    load = Signal(o.stamps, 5.0 * np.sin(2 * np.pi * 3.0 * o.stamps))
    recording = replace(recording, inputs=replace(recording.inputs, load_torque=load))
    pushed = replace(o, inputs=recording.inputs)
    for seen in replayed(made, np.tile(VALUES, (4, 1)), recording, pushed):
        torque = inverse_torque(
            made.chain, VALUES, seen.q, seen.qd, seen.qdd, inputs=seen.inputs, time=seen.stamps
        )
        assert np.std(seen.measured - seen.filter.apply(torque)) < 2e-3 * np.std(seen.measured)
