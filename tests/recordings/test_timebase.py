"""Gaps, jitter, resampling, and what becomes of units and sides."""

import h5py
import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.recordings.observation import observe
from bayesfric.recordings.source import (
    Channel,
    Current,
    Position,
    Processing,
    Torque,
    Velocity,
    Voltage,
)

from .samples import read, source, swing


def save(folder, t, q, tau, **more):
    np.savez(folder / "run.npz", t=t, q=q, tau=tau, **more)


def from_npz(**changes):
    return source("run.npz", **changes)


@pytest.mark.parametrize("used", [{}, {"time": None, "rate": "100 Hz"}], ids=["stamps", "rate"])
def test_time_starts_at_zero(tmp_path, used):
    t, q, tau = swing()
    save(tmp_path, t + 1194.987, q, tau)
    recording = read(tmp_path, from_npz(**used))[0]
    np.testing.assert_allclose(recording.time, t, atol=1e-9)
    assert recording.period == pytest.approx(0.01)
    assert recording.segments == ((0, 200),)


def test_gaps_make_segments(tmp_path):
    t, q, tau = swing(400)
    keep = np.ones(400, dtype=bool)
    keep[100:120] = False  # a gap
    keep[200:202] = False  # a short drop-out, no gap
    keep[300:320] = False
    keep[340:400] = False
    save(tmp_path, t[keep], q[keep], tau[keep])
    recording = read(tmp_path, from_npz())[0]
    lengths = [b - a for a, b in recording.segments]
    assert lengths == [100, 180]
    assert any("left out" in warning and "20 samples" in warning for warning in recording.warnings)
    np.testing.assert_allclose(recording.torque, np.interp(recording.time, t, tau), atol=1e-3)


def test_resampling_a_smooth_signal_is_accurate(tmp_path):
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.8e-3, 1.2e-3, 3000))
    t -= t[0]
    save(tmp_path, t, np.sin(4 * t), np.cos(4 * t))
    recording = read(tmp_path, from_npz())[0]
    assert recording.period == pytest.approx(float(np.median(np.diff(t))))
    np.testing.assert_allclose(np.diff(recording.time), recording.period, rtol=1e-9)
    np.testing.assert_allclose(recording.position, np.sin(4 * recording.time), atol=1e-6)
    np.testing.assert_allclose(recording.torque, np.cos(4 * recording.time), atol=1e-5)
    assert any("PCHIP" in step for step in recording.steps)


@pytest.mark.parametrize(("times", "unit"), [(1, "ns"), (1e6, "s")])
def test_strange_periods_warn(tmp_path, times, unit):
    """Such a recording is read, however slow it is taken to be."""
    t, q, tau = swing()
    save(tmp_path, times * t, q, tau)
    recording = read(tmp_path, from_npz(time=Channel(column="t", unit=unit)))[0]
    assert any("unit of time" in warning for warning in recording.warnings)
    if times > 1:
        assert observe(recording, Processing()).measured.size > 0


def test_start_stop_and_exclude_count_from_the_first_stamp(tmp_path):
    t, q, tau = swing(400)
    save(tmp_path, t + 7, q, tau)
    recording = read(tmp_path, from_npz(start=1, stop="3 s", exclude=[[1.5, 1.6], [9, 10]]))[0]
    assert recording.time[[0, -1]] == pytest.approx([1.0, 3.0])
    assert recording.time[recording.excluded][[0, -1]] == pytest.approx([1.5, 1.6])
    assert recording.excluded.sum() == 11
    assert any("[9, 10]" in warning for warning in recording.warnings)


def test_motor_side_is_divided_by_the_ratio(tmp_path):
    t, q, tau = swing()
    save(tmp_path, t, 100 * q, tau, v=100 * np.gradient(q, t))
    used = from_npz(
        position=Position(column="q", unit="rad", side="motor", sign=-1),
        velocity=Velocity(column="v", unit="rad/s", side="motor"),
    )
    recording = read(tmp_path, used, ratio=100.0)[0]
    np.testing.assert_allclose(recording.position, -q)
    assert recording.velocity is not None
    np.testing.assert_allclose(recording.velocity, np.gradient(q, t))


def test_a_screw_turns_and_slides(tmp_path):
    t, q, tau = swing()
    save(tmp_path, t, q, tau)
    used = from_npz(position=Position(column="q", unit="turn", side="motor"))
    recording = read(tmp_path, used, ratio=2 * np.pi / 0.005, motion="linear")[0]
    np.testing.assert_allclose(recording.position, 0.005 * q)
    with pytest.raises(BadInput, match="side"):
        read(tmp_path, from_npz(), ratio=1.0, motion="linear")
    with pytest.raises(BadInput, match="a length like"):
        read(
            tmp_path,
            from_npz(position=Position(column="q", unit="rad", side="joint")),
            ratio=2.0,
            motion="linear",
        )


def test_current_and_voltage_become_torque(tmp_path):
    t, q, tau = swing()
    speed = 1.4 * np.pi * np.cos(1.4 * np.pi * t)
    kt, resistance, ratio = 0.05, 2.0, 10.0
    volts = resistance * tau / kt + kt * ratio * speed
    save(tmp_path, t, q, tau, i=1000 * tau / kt, u=volts, v=speed)
    position = Position(column="q", unit="rad", side="joint")
    current = Current(column="i", unit="mA", torque_constant="0.05 N m/A")
    voltage = Voltage(column="u", unit="V", torque_constant="50 mN m/A", resistance="2 ohm")
    velocity = Velocity(column="v", unit="rad/s", side="joint")
    by_current = from_npz(position=position, torque=None, current=current)
    np.testing.assert_allclose(read(tmp_path, by_current, ratio=ratio)[0].torque, tau)
    by_voltage = from_npz(position=position, torque=None, voltage=voltage, velocity=velocity)
    np.testing.assert_allclose(read(tmp_path, by_voltage, ratio=ratio)[0].torque, tau, atol=1e-12)
    without = from_npz(position=position, torque=None, voltage=voltage)
    found = read(tmp_path, without, ratio=ratio)[0].torque
    np.testing.assert_allclose(found[20:-20], tau[20:-20], atol=2e-4)


def test_twos_complement_and_further_column(tmp_path):
    t, q, _ = swing()
    signed = np.tile([-3, -1, 0, 2, 5], 40)
    save(tmp_path, t, q, signed % 65536, supply=np.linspace(7, 8, 200))
    torque = Torque(
        column="tau", unit="1/885", twos_complement=16, times="supply", times_unit="V",
        constant="0.5 N m/V", sign=-1,
    )  # fmt: skip
    found = read(tmp_path, from_npz(torque=torque))[0].torque
    np.testing.assert_allclose(found, -0.5 * signed / 885 * np.linspace(7, 8, 200))


def test_columns_with_time_stamps_of_their_own_are_paired_by_time(tmp_path):
    """Two groups of equal lengths, 20 ms apart: row by row a torque would come 20 ms late."""
    time = 0.004 * np.arange(500)
    with h5py.File(tmp_path / "run.h5", "w") as file:
        for group, name, late, signal in (
            ("encoder", "q", 0.0, np.sin),
            ("drive", "tau", 0.02, np.cos),
        ):
            file[f"{group}/time"] = 7.0 + time + late
            file[f"{group}/{name}"] = signal(5.0 * (time + late))
        file["drive/on"] = time >= 1.0
    used = source(
        "run.h5",
        time=Channel(column="encoder/time", unit="s"),
        position=Position(column="encoder/q", unit="rad"),
        torque=Torque(column="drive/tau", unit="N m"),
        valid="drive/on",
    )
    (recording,) = read(tmp_path, used)
    assert recording.time.size == 495
    np.testing.assert_allclose(recording.position, np.sin(5.0 * (recording.time + 0.02)))
    np.testing.assert_allclose(recording.torque, np.cos(5.0 * (recording.time + 0.02)), atol=1e-4)
    np.testing.assert_array_equal(recording.excluded, recording.time < 1.0 - 1e-9)
    assert "'drive/time'" in recording.steps[0]
    with pytest.raises(BadInput, match=r"drive/time.*give time in place of rate"):
        read(tmp_path, used.model_copy(update={"time": None, "rate": 250.0}))
