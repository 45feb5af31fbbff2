"""A replicate is a recording like the one it repeats: same motion, same sensor, exact torque."""

from dataclasses import replace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.diagnostics.replicates import replicate_motion, replicates
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.filters import finest_step, lay_windows
from bayesfric.recordings.measurement import Inputs, Signal
from bayesfric.recordings.signals import observe
from tests.axis import swing
from tests.conftest import made_observation, made_recording
from tests.diagnostics.bench import TRUTH, axis, draws_about, model

VALUES = np.array([TRUTH[name] for name in axis().names])


@pytest.fixture(scope="module")
def bench():
    return model()


def simulated(bench, values, recording=None, observation=None):
    recording, observation = recording or bench.recordings[0], observation or bench.observations[0]
    seeds = np.random.SeedSequence(1).spawn(len(values))
    processing = bench.config.tables.processing
    return list(replicates(bench.chain, values, recording, observation, processing, seeds))


def residual(chain, values, o):
    """Share of a replicate's torque that the inverse model does not make behind its filters."""
    torque = inverse_torque(chain, values, o.q, o.qd, o.qdd, inputs=o.inputs, time=o.stamps)
    return np.std(o.measured - o.filter.apply(torque)) / np.std(o.measured)


def test_the_torque_of_a_replicate_is_that_of_its_motion(bench):
    """But for steps of the encoder."""
    vectors = draws_about(VALUES)
    for values, replicate in zip(vectors, simulated(bench, vectors), strict=True):
        assert residual(bench.chain, values, replicate) < 0.01


def test_a_replicate_has_the_encoder_steps_of_the_recording(bench):
    recording, o = bench.recordings[0], bench.observations[0]
    step = finest_step(recording.position)
    assert step == pytest.approx(2 * np.pi / 8192 / 50)
    unfiltered = bench.config.tables.processing.model_copy(update={"lowpass": 0.0, "decimate": 10})
    o = replace(o, settings=o.settings | {"lowpass": 0.0})
    seeds = np.random.SeedSequence(1).spawn(1)
    (replicate,) = replicates(bench.chain, VALUES[None], recording, o, unfiltered, seeds)
    counts = (replicate.q - replicate.q[0]) / step
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)


def test_a_replicate_has_a_measured_velocity(bench):
    recording, o = bench.recordings[0], bench.observations[0]
    velocity = o.qd + 1e-3 * np.random.default_rng(2).standard_normal(o.qd.size)
    recording = replace(recording, velocity=velocity)
    o = observe(recording, bench.config.tables.processing)
    (replicate,) = simulated(bench, VALUES[None], recording, o)
    noise = [x.settings["noise_seen"] for x in (replicate, o)]
    assert noise[0] == pytest.approx(noise[1], rel=0.2)
    assert np.std(replicate.qd - o.qd) < 0.1 * np.std(o.qd)


def test_parameters_without_a_torque_have_no_replicate(bench):
    values = draws_about(VALUES)
    values[1, bench.chain.names.index("motor.viscous")] = np.nan
    missing = [replicate is None for replicate in simulated(bench, values)]
    assert missing == [False, True, False, False]


def test_other_inputs_are_sampled_when_the_motion_is(bench):
    o, recording = bench.observations[0], bench.recordings[0]
    load = Signal(o.stamps, 5.0 * np.sin(2 * np.pi * 3.0 * o.stamps))
    recording = replace(recording, inputs=replace(recording.inputs, load_torque=load))
    loaded = replace(o, inputs=recording.inputs)
    for replicate in simulated(bench, np.tile(VALUES, (4, 1)), recording, loaded):
        assert residual(bench.chain, VALUES, replicate) < 2e-3


# Motion and torque, exactly

PERIOD, N, RATIO = 0.002, 1500, 10.0
LINES = ((0.6, 1.0), (1.7, 0.2))
EXACT = {"motor.inertia": 2e-3, "motor.viscous": 4e-3, "load.first_moment": 0.4, "offset": 0.03}


def geared(**more):
    motor = bf.Element("motor", inertia=True, viscous=True, ratio=RATIO)
    return bf.Joint([motor], bf.Load(first_moment=True), offset=True, **more)


def exact_torque(time):
    return inverse_torque(geared(), geared().vector(EXACT), *swing(time, LINES))


def exact(segments=((0, 900), (900, N)), late=None):
    """A recording whose motion and torque are known exactly."""
    chain, time = geared(delay=late is not None), 1.0 + PERIOD * np.arange(N)
    known = {"drive.gain": 1.0, chain.delay_name: late} | EXACT
    values = chain.vector({name: known[name] for name in chain.names})
    windows, motion = lay_windows(np.ones(1), segments, 5, np.ones(N, bool)), swing(time, LINES)
    torque, inputs = exact_torque(time), Inputs(torque_rate=Signal(time, np.sin(time)))
    o = made_observation("one", time, motion, torque, windows, 5 * PERIOD, inputs)
    return chain, values, made_recording(time, o.q, torque, PERIOD, segments=segments), o


@pytest.mark.parametrize("late", [None, 0.008])
@pytest.mark.parametrize("phase", [0.0, 0.4, -0.3])
def test_a_replicate_has_the_recorded_motion_and_the_torque_of_it(late, phase):
    """At other instants; exactly, by derivatives of the motion; recorded earlier by a delay."""
    chain, values, recording, o = exact(late=late)
    then = o.stamps - phase * PERIOD
    q, qd, torque = replicate_motion(chain, values, recording, o, phase)
    for result, true in zip((q, qd), swing(then, LINES), strict=False):
        np.testing.assert_allclose(result, true, atol=1e-6 * np.abs(true).max())
    inner = np.r_[30:870, 930 : N - 30]
    size = np.abs(torque).max()
    true = exact_torque(then + (late or 0.0))
    np.testing.assert_allclose(torque[inner], true[inner], atol=1e-5 * size)


@pytest.mark.parametrize("few", [1, 2, 3, 4, 7])
def test_a_short_segment_is_one_polynomial(few):
    chain, values, recording, o = exact(segments=((0, 900), (900, 900 + few), (900 + few, N)))
    q, *_ = replicate_motion(chain, values, recording, o, 0.0)
    np.testing.assert_allclose(q, o.q, atol=1e-9)
