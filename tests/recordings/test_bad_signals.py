"""Time stamps, signals and units that make no sense are refused in one line."""

import pytest

from bayesfric.recordings import Processing, Torque

from .samples import has, lines, refused, source, write


def test_time_not_sorted(tmp_path):
    text = lines()
    text[17], text[18] = text[18], text[17]
    write(tmp_path, "\n".join(text))
    has(refused(tmp_path), "run.csv", "'t'", "row 18 (line 19)", "back in time")


def test_time_repeated(tmp_path):
    text = lines()
    text[18] = text[17]
    write(tmp_path, "\n".join(text))
    has(refused(tmp_path), "run.csv", "'t'", "row 18 (line 19)", "repeats")


@pytest.mark.parametrize(("column", "word"), [(1, "position"), (2, "torque")])
def test_constant_signal(tmp_path, column, word):
    text = [line.split(",") for line in lines()]
    for row in text[1:]:
        row[column] = "0.5"
    write(tmp_path, "\n".join(",".join(row) for row in text))
    has(refused(tmp_path), "run.csv", ("'q'", "'tau'")[column - 1], word, "0.5")


def test_too_short(tmp_path):
    write(tmp_path, "\n".join(lines(30)))
    has(refused(tmp_path), "run.csv", "30 samples", "min_samples = 50")


def test_only_gaps(tmp_path):
    text = lines(200)
    kept = [line for i, line in enumerate(text) if i == 0 or i % 40 < 30]
    write(tmp_path, "\n".join(kept))
    has(refused(tmp_path), "run.csv", "gap", "min_samples")


def test_start_after_the_end(tmp_path):
    write(tmp_path, "\n".join(lines()))
    has(refused(tmp_path, source(start=50)), "run.csv", "start = 50 s")


# -- meaning


def test_side_is_asked_for(tmp_path):
    write(tmp_path, "\n".join(lines()))
    message = refused(tmp_path, ratio=101.0)
    has(message, "run.csv", "'q'", "101", 'side = "motor"')


def test_two_files_with_one_name(tmp_path):
    for name in ("a.csv", "b.csv"):
        write(tmp_path, "\n".join(lines()), name)
    has(refused(tmp_path, source("*.csv", name="x")), "name", "2 files")


@pytest.mark.parametrize("unit", ["%", "N", "V", "rad", "bananas", "", "9**9**9", "N m +/- 1"])
def test_wrong_unit_of_the_torque(tmp_path, unit):
    write(tmp_path, "\n".join(lines()))
    message = refused(tmp_path, source(torque=Torque(column="tau", unit=unit)))
    has(message, "run.csv", "'tau'", "unit of torque", "N m")


def test_wrong_twos_complement(tmp_path):
    write(tmp_path, "\n".join(lines()))
    channel = Torque(column="tau", unit="N m", twos_complement=16)
    has(refused(tmp_path, source(torque=channel)), "'tau'", "row 1 (line 2)", "16 bits")


def test_dead_zone_of_the_wrong_motion(tmp_path):
    write(tmp_path, "\n".join(lines()))
    has(refused(tmp_path, processing=Processing(dead_zone="1 mm/s")), "dead_zone", "rad/s")
