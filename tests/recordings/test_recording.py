"""Recordings made in Python: from arrays, a DataFrame or a file, they are one thing."""

import numpy as np
import pandas as pd
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.recordings.signals import observe
from bayesfric.recordings.source import Processing, Recording, Source, Torque

from .samples import has, measured, source, swing

T, Q, TAU = swing()
FRAME = pd.DataFrame({"t": T, "q": Q, "tau": TAU})
FINE = Processing(lowpass="off", decimate=1, trim=0.0)
ARRAYS = ("time", "position", "torque", "excluded")


def same(first, second):
    assert all(getattr(first, k).tobytes() == getattr(second, k).tobytes() for k in ARRAYS)
    for name in ("steps", "warnings", "segments", "inputs"):
        assert getattr(first, name) == getattr(second, name)


def test_quantities_with_units():
    used = source(start="500 ms", stop=8, added_mass="2 kg", radius="35 cm", exclude=[["1 s", 2]])
    assert (used.start, used.stop) == (0.5, 8.0)
    assert (used.added_mass, used.radius) == pytest.approx((2.0, 0.35))
    assert used.exclude == ((1.0, 2.0),)
    assert source(time=None, rate="1 kHz").rate == 1000.0
    processing = Processing(lowpass="0.1 kHz", band="20 Hz", trim="100 ms", dead_zone="1 deg/s")
    assert (processing.lowpass, processing.band, processing.trim) == (100.0, 20.0, 0.1)
    assert Processing(lowpass="off").lowpass == 0.0


def test_spans_that_are_left_out_are_told():
    keys = {"start": 0.1, "stop": 1.9, "exclude": [[0.3, 0.4], [0.35, 0.5]]}
    valid = (T < 0.695) | (T > 0.705)
    for options, expected in ((keys | {"valid": valid}, [(0.3, 0.5), (0.7, 0.7)]), ({}, [])):
        spans = observe(measured(Recording.from_arrays(T, Q, TAU, **options)), FINE).left_out
        assert [*spans] == [pytest.approx(span, abs=0.011) for span in expected]


def test_arrays_a_dataframe_and_its_file_are_the_same_bytes(tmp_path):
    frame = pd.DataFrame({"t": T, "note": "x", "q": Q, "tau": TAU})
    columns = {"time": "t", "position": "q", "torque": "tau"}
    keys = {"added_mass": "2 kg", "radius": 0.35, "exclude": [[0.2, "300 ms"]]}
    units = {"position": "deg", "torque": "mN m"}
    frame.to_csv(tmp_path / "run.csv", index=False)
    arrays = measured(Recording.from_arrays(T, Q, TAU, units=units, **keys))
    table = measured(Recording.from_dataframe(frame, **columns, units=units, **keys))
    file = measured(Recording.from_file(tmp_path / "run.csv", **columns, units=units, **keys))
    configured = source(
        position={"column": "q", "unit": "deg"}, torque=Torque(column="tau", unit="mN m"), **keys
    )
    for second in (table, file, measured(Recording(configured, tmp_path))):
        same(arrays, second)
    assert (arrays.inputs.added_mass, arrays.excluded.sum()) == (2.0, 11)
    assert (arrays.path, file.path) == (None, tmp_path / "run.csv")
    assert (arrays.name, file.name) == ("recording-1", "run")
    assert len(arrays.sha256) == 64
    assert arrays.sha256 == measured(Recording.from_arrays(T, Q, TAU)).sha256
    assert arrays.sha256 != measured(Recording.from_arrays(T, Q, TAU + 1e-12)).sha256


def test_a_table_in_memory_is_kept_as_a_file(tmp_path):
    frame = pd.DataFrame({"t": T, "note": "x", "q": Q, "u": TAU, "bus": 24.0, "on": T > 0.1})
    recording = Recording.from_dataframe(
        frame,
        time=1,
        position={"column": "q", "unit": "turn/4096", "sign": -1},
        torque={"column": 4, "unit": "mN m/V", "times": "bus", "times_unit": "V"},
        valid="on",
        name="knee",
    )
    saved = recording.saved(tmp_path / "knee [1].csv")
    first, second = measured(recording), measured(saved)
    same(first, second)
    assert second.name == "knee"
    assert isinstance(saved.source, Source)


@pytest.mark.parametrize(
    ("make", "parts"),
    [
        (lambda: Recording.from_arrays(T, Q), ["recording: got none; give exactly one of"]),
        (lambda: Recording.from_arrays(T, Q, TAU[1:]), ["'recording-1'", "'torque'", "199 values"]),
        (lambda: Recording.from_arrays(T, np.c_[Q, Q], TAU), ["'position'", "200 x 2"]),
        (lambda: Recording.from_arrays(T, Q * np.nan, TAU), ["'position', row 1", "nan"]),
        (lambda: Recording.from_arrays(T, Q, TAU, units={"torque": "A"}), ["got 'A'", "'N m'"]),
        (lambda: Recording.from_arrays(T, Q, TAU, units={"torqe": "A"}), ["mean 'torque'?"]),
        (lambda: Recording.from_arrays(T, Q, TAU, mass=2.0), ["recording: mass", "unknown key"]),
        (lambda: Recording.from_arrays(T, Q, TAU, name="a", radius="2 kg"), ["'a': radius", "m'"]),
        (lambda: Recording.from_arrays(T[::-1], Q, TAU), ["goes back in time"]),
        (
            lambda: Recording.from_dataframe(FRAME, time="t", position="q", torque="torque"),
            ["'recording-1', column 'torque'", "use one of t, q"],
        ),
        (
            lambda: Recording.from_dataframe(
                FRAME,
                time="t",
                position="q",
                torque={"column": "tau", "unit": "SI", "constant": "2 N m/A"},
            ),
            ["'SI' is not a known unit"],
        ),
    ],
)
def test_refused_as_a_file_is(make, parts):
    with pytest.raises(BadInput) as refused:
        measured(make())
    has(str(refused.value), *parts)


def test_what_is_changed_later_was_not_recorded():
    frame = FRAME.copy()
    recording = Recording.from_dataframe(frame, time="t", position="q", torque="tau")
    frame["q"] += 1.0
    assert measured(recording).position[0] == Q[0]
