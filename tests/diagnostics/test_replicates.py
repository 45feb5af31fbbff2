"""A replicate is a recording like the one it repeats: same motion, same sensor, exact torque."""

from dataclasses import replace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.diagnostics.replicates import replicate_motion, replicates
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.filters import finest_step, lay_windows
from bayesfric.recordings.measurement import Inputs, Signal
from bayesfric.recordings.observation import observe
from tests.axis import swing
from tests.conftest import made_observation, made_recording
from tests.diagnostics.bench import TRUTH, axis, draws_about, model

VALUES = np.array([TRUTH[name] for name in axis().names])


@pytest.fixture(scope="module")
def made():
    return model()


def simulated(made, values, recording=None, observation=None):
    recording = recording or made.recordings[0]
    seeds = np.random.SeedSequence(1).spawn(len(values))
    processing = made.config.tables.processing
    observation = observation or made.observations[0]
    return list(replicates(made.chain, values, recording, observation, processing, seeds))


def test_the_torque_of_a_replicate_is_that_of_its_motion(made):
    """Behind the filters the inverse model finds it again, but for steps of the encoder."""
    for values, seen in zip(draws_about(VALUES), simulated(made, draws_about(VALUES)), strict=True):
        torque = inverse_torque(made.chain, values, seen.q, seen.qd, seen.qdd, inputs=seen.inputs)
        left = seen.measured - seen.filter.apply(torque)
        assert np.std(left) < 0.01 * np.std(seen.measured)


def test_a_replicate_has_the_encoder_steps_of_the_recording(made):
    recording = made.recordings[0]
    step = finest_step(recording.position)
    assert step == pytest.approx(2 * np.pi / 8192 / 50)
    bare = made.config.tables.processing.model_copy(update={"lowpass": 0.0, "decimate": 10})
    observation = made.observations[0]
    observation = replace(observation, settings=observation.settings | {"lowpass": 0.0})
    seeds = np.random.SeedSequence(1).spawn(1)
    (seen,) = replicates(made.chain, VALUES[None], recording, observation, bare, seeds)
    counts = (seen.q - seen.q[0]) / step
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)


def test_a_replicate_has_a_measured_velocity(made):
    recording, observation = made.recordings[0], made.observations[0]
    rng = np.random.default_rng(2)
    velocity = observation.qd + 1e-3 * rng.standard_normal(observation.qd.size)
    fast = replace(recording, velocity=velocity)
    seen_so = observe(fast, made.config.tables.processing)
    (seen,) = simulated(made, VALUES[None], fast, seen_so)
    assert seen.settings["noise_seen"] == pytest.approx(seen_so.settings["noise_seen"], rel=0.2)
    assert np.std(seen.qd - seen_so.qd) < 0.1 * np.std(seen_so.qd)


def test_parameters_without_a_torque_have_no_replicate(made):
    values = draws_about(VALUES)
    values[1, made.chain.names.index("motor.viscous")] = np.nan
    result = simulated(made, values)
    assert [seen is None for seen in result] == [False, True, False, False]


def test_other_inputs_are_sampled_when_the_motion_is(made):
    o, recording = made.observations[0], made.recordings[0]
    load = Signal(o.stamps, 5.0 * np.sin(2 * np.pi * 3.0 * o.stamps))
    recording = replace(recording, inputs=replace(recording.inputs, load_torque=load))
    pushed = replace(o, inputs=recording.inputs)
    for seen in simulated(made, np.tile(VALUES, (4, 1)), recording, pushed):
        torque = inverse_torque(
            made.chain, VALUES, seen.q, seen.qd, seen.qdd, inputs=seen.inputs, time=seen.stamps
        )
        assert np.std(seen.measured - seen.filter.apply(torque)) < 2e-3 * np.std(seen.measured)


# Motion and torque, exactly

PERIOD, N, RATIO = 0.002, 1500, 10.0
LINES = ((0.6, 1.0), (1.7, 0.2))
EXACT = {"motor.inertia": 2e-3, "motor.viscous": 4e-3, "load.first_moment": 0.4, "offset": 0.03}
SETTINGS = {
    "lowpass": 40.0, "order": 3, "band": 15.0, "noise_seen": 1e-4, "delay": 0.0,
    "decimate": 5, "dead_zone": 0.1, "trim": 0.02, "motion": "refined",
}  # fmt: skip


def geared(**more):
    motor = bf.Element("motor", inertia=True, viscous=True, ratio=RATIO)
    return bf.Joint([motor], bf.Load(first_moment=True), offset=True, **more)


def bench(chain=None, settings=SETTINGS, segments=((0, 900), (900, N)), late=0.0, **values):
    """A recording whose motion and torque are known exactly."""
    chain, time = chain or geared(), 1.0 + PERIOD * np.arange(N)
    known = {"drive.gain": 1.0, chain.delay_name: late} | EXACT | values
    values = chain.vector({name: known[name] for name in chain.names})
    inputs = Inputs(torque_rate=Signal(time, np.sin(time)))
    taken = lay_windows(np.ones(1), segments, 5, np.ones(N, bool))
    q, qd, qdd = swing(time, LINES)
    plain = inverse_torque(geared(), geared().vector(EXACT), q, qd, qdd)
    o = made_observation(
        "one", time, (q, qd, qdd), plain, taken, 5 * PERIOD, inputs, settings=settings
    )
    return chain, values, made_recording(time, q, plain, PERIOD, segments=segments), o


@pytest.mark.parametrize("late", [None, 0.008])
@pytest.mark.parametrize("phase", [0.0, 0.4, -0.3])
def test_a_replicate_has_the_recorded_motion_and_the_torque_of_it(late, phase):
    """At other instants; exactly, by derivatives of the motion; recorded earlier by a delay."""
    chain, values, recording, o = bench(geared(delay=late is not None), late=late or 0.0)
    then = o.stamps - phase * PERIOD
    q, qd, torque = replicate_motion(chain, values, recording, o, phase)
    for result, exact in zip((q, qd), swing(then, LINES), strict=False):
        np.testing.assert_allclose(result, exact, atol=1e-6 * np.abs(exact).max())
    inner = np.r_[30:870, 930 : N - 30]
    size = np.abs(torque).max()
    exact = exact_torque(then + (late or 0.0))
    np.testing.assert_allclose(torque[inner], exact[inner], atol=1e-5 * size)


def exact_torque(time):
    return inverse_torque(geared(), geared().vector(EXACT), *swing(time, LINES))


@pytest.mark.parametrize("few", [1, 2, 3, 4, 7])
def test_a_short_segment_is_one_polynomial(few):
    chain, values, recording, o = bench(segments=((0, 900), (900, 900 + few), (900 + few, N)))
    q, *_ = replicate_motion(chain, values, recording, o, 0.0)
    np.testing.assert_allclose(q, o.q, atol=1e-9)
