"""What a position resolves, where a torque has power: recordings whose spectra are known."""

import numpy as np
import pytest

from bayesfric.recordings.filters import WIDEST, finest_step, resolve
from bayesfric.recordings.signals import observe
from bayesfric.recordings.source import Processing
from tests.conftest import made_recording

FS, N = 500.0, 10_000


def swing(fs=FS, seconds=20.0, noise=0.0, step=0.0, torque=None, frequency=0.8, seed=1):
    t = np.arange(round(fs * seconds)) / fs
    q = np.sin(2 * np.pi * frequency * t) + np.random.default_rng(seed).normal(0.0, noise, t.size)
    if step:
        q = np.round(q / step) * step
    if torque is None:  # power at all frequencies
        torque = np.random.default_rng(seed + 1).normal(size=t.size)
    return made_recording(t, q, torque, 1.0 / fs)


@pytest.mark.parametrize(("counts", "ratio"), [(4096, 1), (8192, 50), (2**20, 50)])
def test_a_step_is_found_though_no_two_positions_are_one_apart(counts, ratio):
    """At 30 rad/s of the joint 2^20 counts behind a ratio of 50 pass by the hundred thousand."""
    step = 2 * np.pi / counts / ratio
    t = np.arange(5000) / FS
    q = 10.0 * np.sin(2 * np.pi * 0.3 * t) + 3.0 * np.sin(2 * np.pi * 1.1 * t)
    read = np.round(q / step) * step
    assert finest_step(read) == pytest.approx(step, rel=1e-5)
    assert finest_step(2.0 * read + 0.3) == pytest.approx(2.0 * step, rel=1e-5)
    if counts == 2**20:
        assert np.diff(np.unique(read)).min() > 5 * step


def test_the_ratio_is_that_of_motion_and_noise_in_the_band():
    """White noise of sd s has a second derivative of s^2 (2/fs) (2 pi)^4 B^5/5 in a band B."""
    noise, band, w = 1e-3, 10.0, 2 * np.pi * 0.8
    resolution = resolve(swing(noise=noise), band)
    # some two thousand independent periodogram values above 0.3 fs, averaged by half dozens
    for sd in (noise, 1e-5):
        assert resolve(swing(noise=sd)).noise == pytest.approx(sd, rel=0.1)
    density = noise**2 * 2 / FS
    acceleration = np.sqrt(w**4 / 2 / (density * (2 * np.pi) ** 4 * band**5 / 5))
    # the band ends between two averaged frequencies, 15 % apart, to the power 2.5; the noise
    # is known to a tenth
    assert resolution.acceleration_ratio == pytest.approx(acceleration, rel=0.5)


def test_the_band_ends_where_the_position_resolves_no_acceleration():
    resolution = resolve(swing(noise=1e-3))
    assert resolution.reason == "position"
    assert 0.8 < resolution.band < 6.0
    # ten times less noise, more band; none, all that the sampling rate allows
    assert resolution.band < resolve(swing(noise=1e-4)).band
    free = resolve(swing())
    assert (free.band, free.reason) == (WIDEST * FS, "sampling")


def test_the_band_ends_where_the_torque_has_no_power():
    t = np.arange(N) / FS
    torque = np.sin(2 * np.pi * 0.8 * t) + 0.2 * np.sin(2 * np.pi * 2.0 * t)
    resolution = resolve(swing(torque=torque, noise=2e-4))
    assert resolution.reason == "torque"
    assert 2.0 <= resolution.band < 2.6
    # where the position is clean, what balances beyond tells something too
    assert resolve(swing(torque=torque)).reason == "sampling"


def test_a_short_recording_keeps_enough_outputs():
    t = np.arange(1500) / FS
    slow = swing(seconds=3.0, torque=np.sin(2 * np.pi * 0.8 * t), noise=1e-3)
    seen = observe(slow, Processing(dead_zone=0, trim=0))
    assert seen.settings["band_by"] == "length"
    assert seen.measured.size >= 50


def test_an_acceleration_that_is_noise_is_warned_of():
    noisy, fine = swing(noise=3e-3), swing(noise=1e-5)
    wide = Processing(lowpass=50.0)
    (warning,) = observe(noisy, wide).warnings
    assert "noise" in warning
    assert "acceleration" in warning
    assert observe(fine, wide).warnings == ()
    # the band that is chosen needs none
    assert observe(noisy, Processing()).warnings == ()


def test_an_inertia_is_not_lost_in_the_noise_of_its_acceleration():
    """0.1.0 compared up to a twentieth of the sampling rate whatever the position resolved."""
    rng = np.random.default_rng(3)
    t = np.arange(N) / FS
    q, a = np.zeros(N), np.zeros(N)
    for f, phase in zip((0.3, 0.8, 1.1), rng.uniform(0, 2 * np.pi, 3), strict=True):
        w = 2 * np.pi * f
        q += np.sin(w * t + phase)
        a -= w**2 * np.sin(w * t + phase)
    measured = made_recording(t, q + rng.normal(0, 2e-3, N), 0.5 * a, 1.0 / FS)

    def inertia(processing):
        seen = observe(measured, processing)
        column = seen.filter.apply(seen.qdd)
        return float(column @ seen.measured / (column @ column))

    # 312 B^5 (2 sigma^2/fs) = 48 against 1300 rad2/s4 of motion: 4 % less at 25 Hz
    assert inertia(Processing(lowpass=50.0, dead_zone=0)) < 0.5 * 0.98
    assert inertia(Processing(dead_zone=0)) == pytest.approx(0.5, rel=5e-3)
