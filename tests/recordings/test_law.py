"""Position targets: what a drive's controller makes of them is the torque."""

import numpy as np
import pandas as pd
import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput

from .samples import measured, swing

MOTOR = {"torque_constant": "0.3 N m/A", "resistance": "2 ohm"}


def recording(target, **more):
    t, q, _ = swing()
    frame = {"target": target, "units": {"target": "rad"}}
    return bf.Recording.from_arrays(t, q, None, **(frame | more))


def aims():
    t, q, _ = swing()
    return q + 0.2 * np.sin(9.0 * t), q


def test_gains_make_the_torque():
    target, q = aims()
    speed = np.gradient(q, 0.01)
    gains = {"kp": "8 N m/rad", "kd": "0.5 N m s/rad", "limit": "1.1 N m", "velocity": speed}
    drive = measured(recording(target, valid=q > 0.0, **gains))
    torque = np.clip(8.0 * (target - q) - 0.5 * speed, -1.1, 1.1)
    assert np.abs(torque).max() == 1.1
    assert drive.torque == pytest.approx(torque, abs=1e-12)
    assert any("at its limit in" in step for step in drive.steps)
    assert np.array_equal(drive.law.off, q <= 0.0)


@pytest.mark.parametrize(
    ("times", "changes"),
    [
        (180.0 / np.pi, {"kp": f"{8.0 * np.pi / 180:.17g} N m/deg", "units": {"target": "deg"}}),
        (1.0, {"kp": "20 A/rad", "torque_constant": "0.4 N m/A"}),
    ],
)
def test_units_of_a_gain(times, changes):
    target, q = aims()
    torque = measured(recording(times * target, **changes)).torque
    assert torque == pytest.approx(8.0 * (target - q), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("supply", [None, "measured"])
def test_a_voltage_from_targets_is_that_voltage(supply):
    """A duty of a supply, or a voltage, against the same numbers as a voltage column."""
    t, q, _ = swing()
    target, _ = aims()
    volts = 12.0 + np.sin(3.0 * t) if supply else np.ones(t.size)
    duty = np.clip(2.5 * (target - q), -0.4, 0.4)
    table = {"t": t, "q": q, "u": duty * volts, "goal": target, "supply": volts}
    channels = {"time": "t", "position": "q", "units": {"time": "s"}}
    aimed = {"column": "goal", "unit": "rad", "kp": "2.5 V/rad", "limit": "0.4 V", **MOTOR}
    if supply:
        aimed |= {"kp": "2.5 1/rad", "limit": "0.4", "times": "supply", "times_unit": "V"}
    frame = pd.DataFrame(table)
    by_target = measured(bf.Recording.from_dataframe(frame, target=aimed, **channels))
    by_voltage = measured(bf.Recording.from_dataframe(frame, voltage="u", **MOTOR, **channels))
    both = measured(bf.Recording.from_dataframe(frame, voltage={"column": "u", **MOTOR},
                                            target=aimed, **channels))  # fmt: skip
    assert by_target.torque == pytest.approx(by_voltage.torque, abs=1e-12)
    assert by_target.back_emf == pytest.approx(by_voltage.back_emf, abs=1e-12)
    # beside a measured voltage it closes the loop, and the torque is the measured one
    assert np.array_equal(both.torque, by_voltage.torque)
    assert both.law.closed
    assert not by_voltage.law.closed
    assert by_voltage.law.follows


def test_a_target_of_the_motor_counts_its_turns():
    t, q, _ = swing()
    target, _ = aims()
    given = {"target": 50.0 * target, "kp": "0.1 N m/rad", "side": "motor", "units": {}}
    found = measured(bf.Recording.from_arrays(t, 50.0 * q, None, **given), ratio=50.0)
    assert found.torque == pytest.approx(0.1 * 50.0 * (target - q), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"kp": "8 N m"}, "kp: '8 N m' is no gain"),
        ({"kp": "8 s"}, "is no gain"),
        ({"kp": "8 V/rad"}, "torque_constant: is not given"),
        ({"kp": "8 V/rad", "torque_constant": "0.3 N m/A"}, "resistance: is not given"),
        ({"kp": "8 1/rad", **MOTOR}, "times: is not given"),
        (
            {"kp": "8 N m/rad", "kd": "2 V s/rad"},
            "kd: '2 V s/rad' is no gain; give it in one of 'N m/(rad/s)'",
        ),
        ({"kp": "8 N m/rad", "limit": "2 V"}, "limit"),
    ],
)
def test_what_makes_no_torque_is_refused(changes, said):
    with pytest.raises(BadInput) as refused:
        measured(recording(aims()[0], **changes))
    assert said in str(refused.value)


@pytest.mark.parametrize(
    ("motion", "unit", "said"),
    [
        ("linear", "V", "got 'V'; give a force like 'N'"),
        ("rotary", "mA", "got 'mA'; give a torque like 'N m'"),
        ("linear", "kg", "a force like 'N'"),
    ],
)  # fmt: skip
def test_a_signal_in_place_of_a_torque_is_refused(motion, unit, said):
    t, q, _ = swing()
    given = {"units": {"torque": unit, "position": "m" if motion == "linear" else "rad"}}
    recording = bf.Recording.from_arrays(t, q, np.sin(t), **given)
    with pytest.raises(BadInput) as caught:
        measured(recording, motion=motion)
    assert said in str(caught.value)
