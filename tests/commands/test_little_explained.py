"""A wrong unit or mechanism is not taken for a delay."""

from dataclasses import replace

import numpy as np
import pytest

import bayesfric as bf

T = 0.002 * np.arange(10000)


def pendulum(times=1.0, preset="servo-pendulum", late=0, spins=True, delay=False):
    """A SIMULATED pendulum, its position told so many times too large, and samples late."""
    q = -8.0 + 8.0 * np.cos(2 * np.pi * 0.1 * T) if spins else 0.2 * np.sin(2 * np.pi * 0.3 * T)
    q = q + 0.4 * np.sin(2 * np.pi * 0.7 * T) * (1.0 if spins else 0.2)
    v = np.gradient(q, T)
    torque = 0.15 * np.gradient(v, T) + 0.05 * v + 0.1 * np.tanh(v / 0.02) + 3.0 * np.sin(q)
    torque += 0.02 * np.random.default_rng(1).standard_normal(T.size)
    q = np.roll(q, late)[100:]
    recording = bf.Recording.from_arrays(T[100:], times * q, torque[100:], name="bench")
    return bf.Model(replace(bf.Joint.preset(preset), delay=delay), recording)


@pytest.mark.slow
@pytest.mark.parametrize(("times", "judged"), [(1.0, True), (np.pi / 180.0, False)])
def test_no_delay_is_advised_while_little_is_explained(times, judged):
    """A position 10 samples late, in its own unit and in a wrong one."""
    found = bf.check(pendulum(times, late=10))
    assert ("delay = true in [mechanism]" in " ".join(found.warnings)) == judged


@pytest.mark.parametrize("late", [60, -100])
def test_a_delay_far_longer_than_what_is_trimmed_is_found_first_and_fitted(late):
    """A position 0.12 or 0.2 s late, or early; 0.024 s is what is trimmed."""
    model = pendulum(late=late)
    first = model.explain(seed=1).findings[0]
    assert (first.kind, first.setting) == ("delay", "mechanism.delay = true")
    found = pendulum(late=late, delay=True).estimates(["input-error"])[0]["drive.delay"].value
    assert found == pytest.approx(0.002 * late, abs=0.001)


@pytest.mark.parametrize("wrong", [{"preset": "motor-axis"}, {"times": 2.0 * np.pi}])
def test_no_delay_stands_for_another_mistake(wrong):
    assert pendulum(**wrong).explain(seed=1).findings[0].kind != "delay"


def test_a_measured_swing_as_an_axis_is_not_called_late(real_data):
    """Of ilqr a quarter of its period, taken for a delay, explains 75 % instead of 46 %."""
    names = {"time": "s", "position": "rad", "velocity": "rad/s", "torque": "N m"}
    keys = {name: {"column": name, "unit": unit} for name, unit in names.items()}
    recording = bf.Recording.from_file(real_data / "dfki-pendulum/ilqr.csv", **keys)
    model = bf.Model(bf.Joint.preset("motor-axis"), recording)
    assert all(one.kind != "delay" for one in model.explain(seed=1).findings[:1])


@pytest.mark.parametrize(("unit", "named"), [("deg", True), ("rad", False)])
def test_a_measured_pendulum_in_a_wrong_unit(real_data, unit, named):
    columns = {"time": "s", "position": unit, "velocity": f"{unit}/s", "torque": "N m"}
    keys = {name: {"column": name, "unit": text} for name, text in columns.items()}
    recording = bf.Recording.from_file(real_data / "dfki-pendulum/sac.csv", **keys)
    found = bf.check(bf.Model(bf.Joint.preset("servo-pendulum"), recording))
    doubts = [one for one in found.as_json()["doubts"] if one["kind"] == "unexplained"]
    assert bool(doubts) == named
    assert all(doubt["share"] < 0.4 for doubt in doubts)
    assert not any("delay = true" in one for one in found.warnings)
