"""What reading tells: angles that wrap, other units, counts, limits, controllers' torques."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesfric.base.errors import BadInput
from bayesfric.recordings.checks import clipped, feedback, speed_mismatch, unwrapped
from bayesfric.recordings.signals import observe
from bayesfric.recordings.source import Processing, Recording
from tests.conftest import made_recording
from tests.recordings.samples import has, measured

T = 0.005 * np.arange(4000)
Q, V = np.sin(3 * T), 3 * np.cos(3 * T)
TURNING = 1.2 * T + 0.8 * np.sin(2 * np.pi * 0.4 * T)


def recorded(*, t=T, q=Q, tau=V, **channels):
    keys = {"time": "t", "position": "q", "torque": "tau"} | channels
    return measured(Recording.from_dataframe(pd.DataFrame({"t": t, "q": q, "tau": tau}), **keys))


@pytest.mark.parametrize(
    ("wrap", "unit"),
    [
        (lambda q: (q + np.pi) % (2 * np.pi) - np.pi, "rad"),
        (lambda q: np.degrees(q) % 360.0, "deg"),
        (lambda q: np.floor(q / (2 * np.pi) * 4096) % 4096, "turn/4096"),
    ],
)
def test_an_angle_that_wraps_is_unwrapped(wrap, unit):
    """0.1.0 differentiated the jumps: an inertia of -0.0009 without a warning."""
    recording = recorded(q=wrap(TURNING), units={"position": unit})
    apart = recording.position - TURNING
    # a turn is no motion; 4096 counts are rounded
    np.testing.assert_allclose(apart - apart[0], 0.0, atol=2 * np.pi / 4096 * 1.01)
    has(" ".join(recording.steps), "unwrapped")


@pytest.mark.parametrize(
    ("channels", "parts"),
    [
        ({"torque": "q"}, ["'q'", "position", "torque"]),
        ({"torque": 2}, ["position", "torque"]),
        ({"velocity": "tau"}, ["velocity", "torque"]),
    ],
)
def test_one_column_as_two_signals_is_refused(channels, parts):
    with pytest.raises(BadInput) as refused:
        recorded(**channels)
    has(str(refused.value), *parts)


@pytest.mark.parametrize(
    ("factor", "units"),
    [(180 / np.pi, "deg and rad"), (-np.pi / 30, "rpm and rad/s"), (-1.0, ""), (1.3, ""), (1, "")],
)
def test_a_velocity_of_another_size_than_the_differentiated_position(factor, units):
    v = factor * V + np.random.default_rng(1).normal(0, 0.3 * (factor == 1), T.size)
    warnings = observe(made_recording(T, Q, V, 0.005, velocity=v), Processing()).warnings
    sizes = [w for w in warnings if f"{factor:.3g} times the differentiated position" in w]
    assert len(sizes) == (factor != 1)  # noise is no other size
    assert any(f"factor between {units}" in w for w in sizes) == bool(units)


@pytest.mark.parametrize(
    ("columns", "warned", "right"),
    [
        ({"q": np.round(4096 * Q)}, ["position"], {"units": {"position": "turn/4096"}}),
        (
            {"t": np.round(1000 * T), "tau": np.round(1000 * V)},
            ["time", "torque"],
            {
                "units": {"time": "ms"},
                "torque": {"column": "tau", "unit": "N m", "constant": "0.001"},
            },
        ),
        ({"tau": np.sign(V)}, [], {}),  # switched
    ],
)
def test_counts_and_thousandths_that_are_taken_for_whole(columns, warned, right):
    def channels(recording):
        return [text.partition(":")[0] for text in recording.warnings if "whole" in text]

    assert channels(recorded(**columns)) == warned
    assert channels(recorded(**columns, **right)) == []


def test_limits_to_both_sides_count_together():
    """Of each side 0.7 % are at the limit, below the least share."""
    signal = np.sin(np.linspace(0, 200, 20_000))
    limit = np.sort(np.abs(signal))[int(0.986 * signal.size)]
    (warning,) = clipped(np.clip(signal, -limit, limit), "torque")
    has(warning, f"{-limit:.6g} or {limit:.6g}", "1.4 %")


@pytest.mark.parametrize("law", ["sign of speed", "position error"])
def test_a_torque_that_a_controller_computes_from_the_motion(law):
    """0.1.0 learned 0.9 N m of Coulomb friction from the first, and called it data."""
    rng, q = np.random.default_rng(2), Q
    if law == "position error":
        q = np.convolve(rng.normal(size=T.size), np.exp(-np.arange(200) / 40) / 40, mode="same")
    torque = 0.9 * np.sign(V) if law == "sign of speed" else -30.0 * (q - 0.1)
    torque = torque + 0.02 * rng.normal(size=T.size)
    assert feedback(torque, q, np.gradient(q, 0.005), np.ones(T.size, dtype=bool))[0] == law


def test_joints_that_lose_energy_are_no_controllers():
    """Coulomb friction at any speed, a hanging pendulum moved slowly, a square-wave torque."""
    usable = np.ones(T.size, dtype=bool)
    q, v = np.sin(T) + 0.3 * np.sin(2.3 * T), np.cos(T) + 0.69 * np.cos(2.3 * T)
    a = -np.sin(T) - 0.3 * 2.3**2 * np.sin(2.3 * T)
    for torque in (
        0.5 * np.sign(v) + 0.2 * v + 0.1 * a,
        3.0 * np.sin(q) + 0.1 * np.sign(v),
        0.8 * np.sign(np.sin(2 * np.pi * T)),
        a + 0.3 * v,
    ):
        assert feedback(torque, q, v, usable) is None


@pytest.mark.parametrize("late", [0.02, -0.013])
def test_a_velocity_that_a_drive_filters_is_told_by_its_delay(late):
    time, rng = np.arange(3000) * 0.004, np.random.default_rng(3)
    w = 2.0 * np.pi * np.array([0.7, 2.1])
    velocity, differentiated = (
        np.sum(np.sin(w * (time[:, None] - shift)), axis=1) + 0.02 * rng.standard_normal(3000)
        for shift in (late, 0.0)
    )
    usable = np.abs(differentiated) > 0.1
    _, estimate = speed_mismatch(0.9 * velocity, differentiated, usable, 0.004)
    assert estimate == pytest.approx(late, abs=0.001)
    assert speed_mismatch(0.9 * differentiated, differentiated, usable, 0.004)[1] is None
    noise = rng.standard_normal(3000)
    assert speed_mismatch(noise, differentiated, usable, 0.004)[1] is None


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.01, 1.4))
def test_unwrapping_undoes_what_wrapping_did(seed, largest):
    rng = np.random.default_rng(seed)
    angle = np.cumsum(rng.uniform(-largest, largest, 300))
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    estimate, _, jumps = unwrapped(wrapped, 2 * np.pi)
    np.testing.assert_allclose(estimate - estimate[0], angle - angle[0], atol=1e-9)
    assert (jumps > 0) == bool((np.abs(np.diff(wrapped)) > np.pi).any())
    # moved by hand while not recording: no turn
    assert unwrapped(np.repeat([0.0, 4.0], 50), 2 * np.pi)[1] == 0
