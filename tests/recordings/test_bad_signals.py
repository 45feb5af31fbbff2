"""Time stamps, signals and units that make no sense are refused in one line."""

import pytest

from bayesfric.recordings import Processing, Torque

from .samples import has, lines, refused, source, write

PLAIN = lines()


def constant(column):
    cells = [line.split(",") for line in PLAIN[1:]]
    return [PLAIN[0], *(",".join([*row[:column], "0.5", *row[column + 1 :]]) for row in cells)]


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ([*PLAIN[:17], PLAIN[18], PLAIN[17], *PLAIN[19:]], ["'t'", "row 18 (line 19)", "back in"]),
        ([*PLAIN[:18], PLAIN[17], *PLAIN[19:]], ["'t'", "row 18 (line 19)", "repeats"]),
        (constant(1), ["'q'", "position", "0.5"]),
        (constant(2), ["'tau'", "torque", "0.5"]),
        (lines(30), ["30 samples", "min_samples = 50"]),
        ([line for i, line in enumerate(PLAIN) if i == 0 or i % 40 < 30], ["gap", "min_samples"]),
    ],
    ids=["unsorted", "repeated", "constant position", "constant torque", "short", "gaps"],
)
def test_samples(tmp_path, text, parts):
    write(tmp_path, "\n".join(text))
    has(refused(tmp_path), "run.csv", *parts)


def torque(unit="N m", **keys):
    return source(torque=Torque(column="tau", unit=unit, **keys))


@pytest.mark.parametrize(
    ("used", "more", "parts"),
    [
        (source(start=50), {}, ["run.csv", "start = 50 s"]),
        (source(), {"ratio": 101.0}, ["run.csv", "'q'", "101", 'side = "motor"']),
        (torque(twos_complement=16), {}, ["'tau'", "row 1 (line 2)", "16 bits"]),
        (source(), {"processing": Processing(dead_zone="1 mm/s")}, ["dead_zone", "rad/s"]),
    ],
)
def test_meaning(tmp_path, used, more, parts):
    write(tmp_path, "\n".join(PLAIN))
    has(refused(tmp_path, used, **more), *parts)


def test_two_files_with_one_name(tmp_path):
    for name in ("a.csv", "b.csv"):
        write(tmp_path, "\n".join(PLAIN), name)
    has(refused(tmp_path, source("*.csv", name="x")), "name", "2 files")


@pytest.mark.parametrize("unit", ["%", "N", "V", "rad", "bananas", "", "9**9**9", "N m +/- 1"])
def test_wrong_unit_of_the_torque(tmp_path, unit):
    write(tmp_path, "\n".join(PLAIN))
    has(refused(tmp_path, torque(unit)), "run.csv", "'tau'", "unit of torque", "N m")
