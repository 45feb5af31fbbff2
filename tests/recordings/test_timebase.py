"""Gaps, jitter, resampling, clocks, and what becomes of units and sides."""

import h5py
import numpy as np
import pandas as pd
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.recordings.read import read_recordings
from bayesfric.recordings.signals import observe
from bayesfric.recordings.source import Processing, Recording

from .samples import measured, swing


def recorded(t, q, tau, *, ratio=1.0, motion="rotary", **keys):
    return measured(Recording.from_arrays(t, q, tau, **keys), ratio=ratio, motion=motion)


@pytest.mark.parametrize("rate", [None, "100 Hz"], ids=["stamps", "rate"])
def test_time_starts_at_zero(rate):
    t, q, tau = swing()
    recording = recorded(None if rate else t + 1194.987, q, tau, rate=rate)
    np.testing.assert_allclose(recording.time, t, atol=1e-9)
    assert recording.period == pytest.approx(0.01)
    assert recording.segments == ((0, 200),)


def test_gaps_make_segments():
    t, q, tau = swing(400)
    keep = np.ones(400, dtype=bool)
    keep[100:120] = False  # a gap
    keep[200:202] = False  # a short drop-out, no gap
    keep[300:320] = False
    keep[340:400] = False
    recording = recorded(t[keep], q[keep], tau[keep])
    assert [b - a for a, b in recording.segments] == [100, 180]
    assert any("left out" in warning and "20 samples" in warning for warning in recording.warnings)
    np.testing.assert_allclose(recording.torque, np.interp(recording.time, t, tau), atol=1e-3)


@pytest.mark.parametrize("keys", [{}, {"start": 20, "stop": 180}], ids=["all", "chosen"])
def test_a_long_recording_is_used_in_parts_all_over_it(keys):
    t, q, tau = swing(20_000)
    counter = 5.0 * q % (2.0 * np.pi)
    recording = measured(Recording.from_arrays(t, counter, tau, **keys), max_samples=8000)
    assert [b - a for a, b in recording.segments] == 8 * [1000]
    assert recording.time[[0, -1]] == pytest.approx([keys.get("start", 0), keys.get("stop", t[-1])])
    at = np.searchsorted(t, recording.time - 0.005)
    np.testing.assert_allclose(recording.time, t[at], atol=1e-9)
    np.testing.assert_array_equal(recording.torque, tau[at])
    # unwrapped before it is parted
    np.testing.assert_allclose(np.ptp(recording.position - 5.0 * q[at]), 0.0, atol=1e-9)


def test_resampling_a_smooth_signal_is_accurate():
    t = np.cumsum(np.random.default_rng(3).uniform(0.8e-3, 1.2e-3, 3000))
    t -= t[0]
    recording = recorded(t, np.sin(4 * t), np.cos(4 * t))
    assert recording.period == pytest.approx(float(np.median(np.diff(t))))
    np.testing.assert_allclose(np.diff(recording.time), recording.period, rtol=1e-9)
    np.testing.assert_allclose(recording.position, np.sin(4 * recording.time), atol=1e-6)
    np.testing.assert_allclose(recording.torque, np.cos(4 * recording.time), atol=1e-5)
    assert any("PCHIP" in step for step in recording.steps)


@pytest.mark.parametrize("factor", [1e-9, 1e6])
def test_implausible_periods_warn(factor):
    t, q, tau = swing()
    recording = recorded(factor * t, q, tau)
    assert any("unit of time" in warning for warning in recording.warnings)
    assert observe(recording, Processing()).measured.size > 0


def test_start_stop_and_exclude_count_from_the_first_stamp():
    t, q, tau = swing(400)
    recording = recorded(t + 7, q, tau, start=1, stop="3 s", exclude=[[1.5, 1.6], [9, 10]])
    assert recording.time[[0, -1]] == pytest.approx([1.0, 3.0])
    assert recording.time[recording.excluded][[0, -1]] == pytest.approx([1.5, 1.6])
    assert recording.excluded.sum() == 11
    assert any("[9, 10]" in warning for warning in recording.warnings)


def test_motor_side_is_divided_by_the_ratio():
    t, q, tau = swing()
    speed = np.gradient(q, t)
    recording = recorded(t, 100 * q, tau, velocity=100 * speed, side="motor", ratio=100.0)
    np.testing.assert_allclose(recording.position, q)
    np.testing.assert_allclose(recording.velocity, speed)


def slide(ratio, unit, side):
    """Position of a load that slides on a screw."""
    recording = Recording.from_arrays(*swing(), units={"position": unit}, side=side)
    drive = {"ratio": ratio, "motion": "linear", "motor_motion": "rotary"}
    return read_recordings(recording, processing=Processing(), **drive)[0].position


def test_a_screw_turns_and_slides():
    np.testing.assert_allclose(slide(2 * np.pi / 0.005, "turn", "motor"), 0.005 * swing()[1])
    for unit, side, problem in (("m", None, "side"), ("rad", "joint", "a length like")):
        with pytest.raises(BadInput, match=problem):
            slide(2.0, unit, side)


def test_current_and_voltage_become_torque():
    t, q, tau = swing()
    speed = 1.4 * np.pi * np.cos(1.4 * np.pi * t)
    kt, resistance, ratio = 0.05, 2.0, 10.0
    keys = {"side": "joint", "ratio": ratio, "torque_constant": "50 mN m/A"}
    current = recorded(t, q, None, current=1000 * tau / kt, units={"current": "mA"}, **keys)
    np.testing.assert_allclose(current.torque, tau)
    # in the motor's unit, whatever it was given in
    assert current.torque_constant == pytest.approx(kt)
    keys |= {"voltage": resistance * tau / kt + kt * ratio * speed, "resistance": "2 ohm"}
    np.testing.assert_allclose(recorded(t, q, None, velocity=speed, **keys).torque, tau, atol=1e-12)
    torque = recorded(t, q, None, **keys).torque
    np.testing.assert_allclose(torque[20:-20], tau[20:-20], atol=2e-4)


def test_twos_complement_and_further_column():
    t, q, _ = swing()
    signed, supply = np.tile([-3, -1, 0, 2, 5], 40), np.linspace(7, 8, 200)
    frame = pd.DataFrame({"t": t, "q": q, "tau": signed % 65536, "supply": supply})
    torque = {
        "column": "tau", "unit": "1/885", "twos_complement": 16, "times": "supply",
        "times_unit": "V", "constant": "0.5 N m/V", "sign": -1,
    }  # fmt: skip
    recording = measured(Recording.from_dataframe(frame, time="t", position="q", torque=torque))
    np.testing.assert_allclose(recording.torque, -0.5 * signed / 885 * supply)


def test_columns_with_time_stamps_of_their_own_are_paired_by_time(tmp_path):
    """Two groups of equal lengths, 20 ms apart: row by row a torque would come 20 ms late."""
    time = 0.004 * np.arange(500)
    with h5py.File(tmp_path / "run.h5", "w") as file:
        for column, late, signal in (("encoder/q", 0.0, np.sin), ("drive/tau", 0.02, np.cos)):
            file[f"{column.partition('/')[0]}/time"] = 7.0 + time + late
            file[column] = signal(5.0 * (time + late))
        file["drive/on"] = time >= 1.0
    columns = {"position": "encoder/q", "torque": "drive/tau", "valid": "drive/on"}
    recording = measured(Recording.from_file(tmp_path / "run.h5", time="encoder/time", **columns))
    assert recording.time.size == 495
    np.testing.assert_allclose(recording.position, np.sin(5.0 * recording.time))
    np.testing.assert_allclose(recording.torque, np.cos(5.0 * recording.time), atol=1e-4)
    np.testing.assert_array_equal(recording.excluded, recording.time < 1.02 - 1e-9)
    assert "'drive/time'" in recording.steps[0]
    with pytest.raises(BadInput, match=r"drive/time.*give time in place of rate"):
        measured(Recording.from_file(tmp_path / "run.h5", rate="250 Hz", **columns))
