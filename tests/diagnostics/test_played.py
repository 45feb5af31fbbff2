"""How a replicate is made: its motion, its torque, and how its sensors read it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import bayesfric as bf
from bayesfric.diagnostics import replicates as made_by
from bayesfric.diagnostics.replicates import (
    _measure,
    _quantise,
    fixed_processing,
    replicate_motion,
    replicates,
)
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.filters import lay_windows
from bayesfric.recordings.measurement import Inputs, Signal
from bayesfric.recordings.source import Processing
from tests.axis import swing
from tests.conftest import made_observation, made_recording

PERIOD, N, RATIO = 0.002, 1500, 10.0
LINES = ((0.6, 1.0), (1.7, 0.2))
TRUTH = {"motor.inertia": 2e-3, "motor.viscous": 4e-3, "load.first_moment": 0.4, "offset": 0.03}
TOLD = {
    "lowpass": 40.0, "order": 3, "band": 15.0, "noise_seen": 1e-4, "delay": 0.0,
    "decimate": 5, "dead_zone": 0.1, "trim": 0.02, "motion": "refined",
}  # fmt: skip


def joint(**more):
    motor = bf.Element("motor", inertia=True, viscous=True, ratio=RATIO)
    return bf.Joint([motor], bf.Load(first_moment=True), offset=True, **more)


def bench(chain=None, settings=TOLD, segments=((0, 900), (900, N)), late=0.0, **values):
    """A recording whose motion and torque are known exactly."""
    chain, time = chain or joint(), 1.0 + PERIOD * np.arange(N)
    known = {"drive.gain": 1.0, chain.delay_name: late} | TRUTH | values
    values = chain.vector({name: known[name] for name in chain.names})
    inputs = Inputs(torque_rate=Signal(time, np.sin(time)))
    taken = lay_windows(np.ones(1), segments, 5, np.ones(N, bool))
    q, qd, qdd = swing(time, LINES)
    plain = inverse_torque(joint(), joint().vector(TRUTH), q, qd, qdd)
    o = made_observation(
        "one", time, (q, qd, qdd), plain, taken, 5 * PERIOD, inputs, settings=settings
    )
    return chain, values, made_recording(time, q, plain, PERIOD, segments=segments), o


@pytest.mark.parametrize("late", [None, 0.008])
@pytest.mark.parametrize("phase", [0.0, 0.4, -0.3])
def test_a_twin_moves_as_recorded_by_the_torque_that_this_needs(late, phase):
    """At other instants; exactly, by derivatives of the motion; recorded earlier by a delay."""
    chain, values, recording, o = bench(joint(delay=late is not None), late=late or 0.0)
    then = o.stamps - phase * PERIOD
    q, qd, torque = replicate_motion(chain, values, recording, o, phase)
    for found, exact in zip((q, qd), swing(then, LINES), strict=False):
        np.testing.assert_allclose(found, exact, atol=1e-6 * np.abs(exact).max())
    inner = np.r_[30:870, 930 : N - 30]
    size = np.abs(torque).max()
    exact = exact_torque(then + (late or 0.0))
    np.testing.assert_allclose(torque[inner], exact[inner], atol=1e-5 * size)


def exact_torque(time):
    return inverse_torque(joint(), joint().vector(TRUTH), *swing(time, LINES))


@pytest.mark.parametrize("few", [1, 2, 3, 4, 7])
def test_a_short_segment_is_one_polynomial(few):
    chain, values, recording, o = bench(segments=((0, 900), (900, 900 + few), (900 + few, N)))
    q, *_ = replicate_motion(chain, values, recording, o, 0.0)
    np.testing.assert_allclose(q, o.q, atol=1e-9)


def test_instants_of_twins_lie_anywhere_between_those_of_the_recording(monkeypatch):
    """Half a sample to either side, evenly, by Kolmogorov's test."""
    chain, values, recording, o = bench()
    phases = []

    def noted(*given):
        phases.append(given[-1])
        return (np.full(N, np.nan),) * 3

    monkeypatch.setattr(made_by, "replicate_motion", noted)
    many = values * np.linspace(0.5, 1.5, 301)[:, None]
    seeds = np.random.SeedSequence(1).spawn(301)
    processing = Processing(lowpass="10 Hz")
    assert set(replicates(chain, many, recording, o, processing, seeds)) == {None}
    assert stats.kstest(phases, "uniform", (-0.5, 1.0)).pvalue > 1e-3


def test_twins_are_filtered_as_the_recording_was():
    *_, o = bench()
    found = fixed_processing(Processing(lowpass="10 Hz", order=2), o)
    assert (found.lowpass, found.decimate, found.dead_zone, found.trim) == (40.0, 5, 0.1, 0.02)
    assert found.order == 2


# Sensors


@pytest.mark.parametrize("noise", [0.0, 1e-3, 5e-3])
@pytest.mark.parametrize("step", [0.0, 4e-3])
def test_what_is_read_lies_on_steps_and_has_the_noise_that_was_seen(step, noise):
    """Of noise the steps are part; of a step alone the error is a twelfth of its square."""
    rng, n = np.random.default_rng(1), 20000
    recorded = np.cumsum(rng.uniform(-1.0, 1.0, 500))
    recorded = 0.3 + step * np.round(recorded / step) if step else recorded
    true = np.sin(np.linspace(0.0, 40.0, n))
    offsets = []
    for seed in range(4):
        found = _quantise(recorded, true, noise, np.random.default_rng(seed))
        error = found - true
        variance = max(noise**2, step**2 / 12.0)
        # the sd of a variance of n is sqrt(2/n) or less
        assert np.var(error) == pytest.approx(variance, rel=5.0 * np.sqrt(2.0 / n), abs=1e-20)
        assert abs(error.mean()) < 5.0 * np.sqrt(variance / n) + 1e-12
        if step:
            counts = (found - found[0]) / step
            np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
            offsets.append((found[0] - recorded[0]) / step % 1.0)
    # the steps lie anywhere
    assert np.unique(np.round(offsets, 6)).size == (4 if step else 0)


@pytest.mark.parametrize("measured", [False, True])
def test_a_measured_speed_has_the_noise_and_the_position_none(measured):
    """Nothing is left of what a maker did to torque or speed: that of a replicate is exact."""
    *_, recording, o = bench()
    rng = np.random.default_rng(2)
    smooth = np.pi * np.cumsum(rng.uniform(size=N))  # of no steps
    recording = replace(recording, position=smooth, velocity=smooth if measured else None)
    motion = o.q, o.qd, o.torque
    settings = o.settings | {"noise_seen": 0.05}
    found = _measure(replace(recording, held=True), replace(o, settings=settings), motion, rng)
    noisy, exact = (found.velocity, found.position) if measured else (found.position, None)
    assert np.std(noisy - (o.qd if measured else o.q)) == pytest.approx(0.05, rel=0.1)
    if measured:
        np.testing.assert_allclose(exact, o.q, atol=1e-9)
    else:
        assert found.velocity is None
    np.testing.assert_array_equal(found.torque, o.torque)
    assert (found.held, found.torque_lag, found.velocity_lag) == (False, None, None)
    # of a motion that cannot be there is nothing to read
    assert _measure(recording, o, (o.q, o.qd, np.full(N, np.nan)), rng) is None
