"""How a twin is made: what holds it, what drives it, and how its sensors read it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import bayesfric as bf
from bayesfric.diagnostics.twins import (
    _finely,
    _Held,
    _seen,
    _sensed,
    modelled_driver,
    settled_as,
    spring_of,
    twins,
)
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.filters import lay_windows, lowpass
from bayesfric.recordings.inputs import Inputs, Signal
from bayesfric.recordings.processing import Processing
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


@pytest.mark.parametrize("band", [60.0, 15.0, 0.0])
@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_a_spring_is_critically_damped_and_three_times_as_fast_as_the_motion(band, offset):
    """But no faster than a fifth of the band; of the inertia that the motor feels."""
    chain, values, _, o = bench(settings=TOLD | {"band": band}, offset=offset)
    w = 2 * np.pi * min(3.0 * o.pace, 0.2 * band if band else np.inf)
    assert 0.2 * 15.0 < 3.0 * o.pace < 0.2 * 60.0
    assert spring_of(chain, values, o) == pytest.approx((2e-3 * w**2, 2.0 * 2e-3 * w))


@pytest.mark.parametrize("more", [{}, {"delay": True}, {"gain": True}])
@pytest.mark.parametrize("driven", ["modelled", "recorded"])
def test_a_held_joint_moves_as_recorded_under_the_torque_that_makes_it_move(more, driven):
    """Exactly, from the state that each segment begins with; recorded earlier by a delay."""
    late = 0.008 if "delay" in more else 0.0
    told = TOLD | {"lowpass": 0.0, "band": 0.0, "delay": 0.006}
    chain, values, recording, o = bench(joint(**more), told, late=late)
    if "delay" in more:  # was recorded earlier by what the recording's own delay is
        o = replace(o, torque=exact_torque(o.stamps + 0.006))
    driver = modelled_driver(chain, values, recording, o) if driven == "modelled" else None
    spring = spring_of(chain, values, o)
    q, qd, torque = _Held(chain, recording, o, spring, driver).simulated(values, 0.0)
    np.testing.assert_allclose(q, o.q, atol=2e-4)
    np.testing.assert_allclose(qd, o.qd, atol=2e-3)
    inner = np.r_[30:870, 930 : N - 30]
    size = np.abs(torque).max()
    np.testing.assert_allclose(
        torque[inner], exact_torque(o.stamps + late)[inner], atol=5e-3 * size
    )


def exact_torque(time):
    return inverse_torque(joint(), joint().vector(TRUTH), *swing(time, LINES))


def test_a_drive_that_makes_more_torque_than_it_says_holds_as_hard():
    """Of twice everything with twice the gain motion and measured torque are the same."""
    chain, values, recording, o = bench(joint(gain=True), TOLD | {"lowpass": 0.0, "band": 0.0})
    twice = values * np.where([n == "drive.gain" for n in chain.names], 1.0, 2.0)
    twice = np.where([n == "drive.gain" for n in chain.names], 2.0, twice)
    pulled = replace(o, torque=o.torque + 0.1 * np.sin(9.0 * o.stamps))
    held = _Held(chain, recording, pulled, spring_of(chain, values, o), None)
    for one, other in zip(held.simulated(values, 0.0), held.simulated(twice, 0.0), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)


def test_what_holds_pulls_a_joint_of_other_parameters_back():
    """And what it pulls is in the torque: the inverse model of those parameters finds it."""
    chain, values, recording, o = bench(settings=TOLD | {"lowpass": 0.0, "band": 0.0})
    heavy = values * np.where([n == "load.first_moment" for n in chain.names], 1.5, 1.0)
    spring = spring_of(chain, values, o)
    q, qd, torque = _Held(chain, recording, o, spring, None).simulated(heavy, 0.0)
    assert 1e-3 < np.std(q - o.q) < 0.3 * np.std(o.q)
    left = slice(100, 800)
    found = inverse_torque(chain, heavy, q, qd, np.gradient(qd, PERIOD))
    np.testing.assert_allclose(torque[left], found[left], atol=2e-3 * np.abs(found).max())
    # by the spring's law, of the motor's motion
    stiff, damp = spring
    pull = RATIO * (stiff * (o.q - q) + damp * (o.qd - qd))
    np.testing.assert_allclose(torque[left] - o.torque[left], pull[left], atol=1e-9)


@pytest.mark.parametrize("phase", [0.4, -0.3])
def test_a_twin_is_sampled_at_other_instants(phase):
    """So many samples late: its motion, in the middle of a part, is that of then."""
    chain, values, recording, o = bench(settings=TOLD | {"lowpass": 0.0, "band": 0.0})
    held = _Held(chain, recording, o, spring_of(chain, values, o), None)
    q, *_ = held.simulated(values, phase)
    then = swing(o.stamps - phase * PERIOD, LINES)[0]
    inner = slice(600, 850)
    assert np.abs(q - then)[inner].max() < 0.1 * np.abs(o.q - then)[inner].max()


def test_instants_of_twins_lie_anywhere_between_those_of_the_recording(monkeypatch):
    """Half a sample to either side, evenly, by Kolmogorov's test; one spring holds them all."""
    chain, values, recording, o = bench()
    phases, springs = [], []

    def simulated(self, one, phase):  # noqa: ARG001
        phases.append(phase)
        springs.append(self._spring)
        return (np.full(N, np.nan),) * 3

    monkeypatch.setattr(_Held, "simulated", simulated)
    many = values * np.linspace(0.5, 1.5, 301)[:, None]
    seeds = np.random.SeedSequence(1).spawn(301)
    processing = Processing(lowpass="10 Hz")
    assert set(twins(chain, many, recording, o, processing, seeds)) == {None}
    assert stats.kstest(phases, "uniform", (-0.5, 1.0)).pvalue > 1e-3
    assert springs == [pytest.approx(spring_of(chain, values, o))] * 301


@pytest.mark.parametrize(("band", "cutoff"), [(15.0, 19.5), (0.0, 52.0), (300.0, 200.0)])
def test_a_modelled_driver_ends_above_the_band(band, cutoff):
    """At 1.3 times it, or the position's filter; at 0.4 of the rate at most."""
    chain, values, recording, o = bench(joint(delay=True), TOLD | {"band": band}, late=0.05)
    noisy = replace(o, qdd=o.qdd + 30.0 * np.random.default_rng(1).standard_normal(N))
    exact = inverse_torque(joint(), joint().vector(TRUTH), noisy.q, noisy.qd, noisy.qdd)
    found = modelled_driver(chain, values, recording, noisy)
    smooth = lowpass(exact, recording.segments, 500.0, cutoff, 3)
    np.testing.assert_allclose(found, smooth, atol=1e-9)


def test_where_no_torque_is_modelled_the_recorded_one_drives():
    chain, values, recording, o = bench(settings=TOLD | {"band": 0.0, "lowpass": 0.0})
    qdd = o.qdd.copy()
    qdd[700] = np.nan
    compared = o.compared + 5.0
    holed = replace(o, qdd=qdd, compared=compared, settings=o.settings | {"band": 1e9})
    found = modelled_driver(chain, values, recording, holed)
    exact = np.where(np.arange(N) == 700, compared, o.torque)
    smooth = lowpass(exact, recording.segments, 500.0, 200.0, 3)
    np.testing.assert_allclose(found, smooth, atol=1e-6)


def test_twins_are_filtered_as_the_recording_was():
    *_, o = bench()
    found = settled_as(Processing(lowpass="10 Hz", order=2), o)
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
        found = _sensed(recorded, true, noise, np.random.default_rng(seed))
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
    """Nothing is left of what a maker did to torque or speed: that of a twin is exact."""
    *_, recording, o = bench()
    rng = np.random.default_rng(2)
    smooth = np.pi * np.cumsum(rng.uniform(size=N))  # of no steps
    recording = replace(recording, position=smooth, velocity=smooth if measured else None)
    motion = o.q, o.qd, o.torque
    settings = o.settings | {"noise_seen": 0.05}
    found = _seen(replace(recording, held=True), replace(o, settings=settings), motion, rng)
    noisy, exact = (found.velocity, found.position) if measured else (found.position, None)
    assert np.std(noisy - (o.qd if measured else o.q)) == pytest.approx(0.05, rel=0.1)
    if measured:
        np.testing.assert_allclose(exact, o.q, atol=1e-9)
    else:
        assert found.velocity is None
    np.testing.assert_array_equal(found.torque, o.torque)
    assert (found.held, found.torque_lag, found.velocity_lag) == (None, None, None)
    # of a motion that cannot be there is nothing to read
    assert _seen(recording, o, (np.full(N, np.nan), o.qd, o.torque), rng) is None


def test_between_samples_a_torque_is_a_cubic():
    t = np.arange(30.0)
    fine = np.arange(29 * 5 + 1) / 5.0
    np.testing.assert_allclose(_finely(t**3 - 7.0 * t), fine**3 - 7.0 * fine, atol=1e-8)
    # of fewer than four samples it is the one polynomial through them
    for n in (1, 2, 3, 4):
        fine = np.arange((n - 1) * 5 + 1) / 5.0
        exact = 2.0 * fine ** (n - 1) - 1.0
        np.testing.assert_allclose(
            _finely(2.0 * np.arange(n, dtype=float) ** (n - 1) - 1.0), exact, atol=1e-9
        )
