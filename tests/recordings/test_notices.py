"""What reading tells of units, clocks, limits and rests; and of what it does not."""

import numpy as np
import pytest

from bayesfric.recordings import Processing, observe
from bayesfric.recordings.checks import clipped
from tests.conftest import made_recording
from tests.recordings.samples import has, read, source
from tests.recordings.test_motion_checks import table

T = 0.005 * np.arange(4000)
Q, V = np.sin(3 * T), 3 * np.cos(3 * T)


@pytest.mark.parametrize(
    ("factor", "says"),
    [(180 / np.pi, "deg and rad"), (-np.pi / 30, "rpm and rad/s"), (-1.0, ""), (1.3, "")],
)
def test_a_velocity_of_another_size_than_the_differentiated_position(factor, says):
    wrong = made_recording(T, Q, V, 0.005, velocity=factor * V)
    (said,) = [w for w in observe(wrong, Processing()).warnings if w.startswith("velocity")]
    has(said, f"{factor:.3g} times", says, "unit, sign and side")
    assert bool(says) == ("factor between" in said)


def warned(tmp_path, columns, word, **used):
    table(tmp_path, columns)
    (found,) = read(tmp_path, source(**used))
    return [w for w in found.warnings if word in w]


@pytest.mark.parametrize(
    ("columns", "channels", "used"),
    [
        ({"q": np.round(4096 * Q)}, ["position"], {"position": ("q", "turn/4096", {})}),
        (
            {"t": 1000 * T, "tau": np.round(1000 * V)},
            ["time", "torque"],
            {"time": ("t", "ms", {}), "torque": ("tau", "N m", {"constant": "0.001"})},
        ),
        ({"tau": np.sign(V)}, [], {}),  # switched
    ],
)
def test_counts_and_thousandths_that_are_taken_for_whole(tmp_path, columns, channels, used):
    columns = {"t": T, "q": Q, "tau": V} | columns
    said = warned(tmp_path, columns, "whole")
    assert [w.partition(":")[0] for w in said] == channels
    right = {
        key: {"column": column, "unit": unit, **more} for key, (column, unit, more) in used.items()
    }
    assert not warned(tmp_path, columns, "whole", **right)


def test_limits_to_both_sides_are_one():
    """Of each side 0.7 % are at the limit, below what either would be told for."""
    signal = np.sin(np.linspace(0, 200, 20_000))
    limit = np.sort(np.abs(signal))[int(0.986 * signal.size)]
    (said,) = clipped(np.clip(signal, -limit, limit), "torque")
    has(said, f"{-limit:.6g} or {limit:.6g}", "1.4 %")
    (one,) = clipped(np.clip(signal, -2, np.sort(signal)[int(0.95 * signal.size)]), "torque")
    has(one, f"stays at -1 or {np.sort(signal)[int(0.95 * signal.size)]:.6g} (raw)")
