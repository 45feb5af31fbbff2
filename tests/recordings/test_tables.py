"""The table model: columns by name and number, parts of wider ones, holes, and rows by value."""

import numpy as np
import pandas as pd
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.recordings.readers import TableOptions, read_table
from bayesfric.recordings.source import Recording
from bayesfric.recordings.tables import Table
from tests.recordings.samples import has, measured


def table(by_rows=False, **columns):
    return Table("run", list(columns), list(columns.values()).__getitem__, by_rows=by_rows)


def opened(path, **options):
    return read_table(path, TableOptions(**options))


def refusal(act):
    with pytest.raises(BadInput) as caught:
        act()
    return str(caught.value)


def test_holes_are_nan_and_refused_by_their_row_where_all_are_needed():
    cells = np.array([1.0, None, "x", "2.5", "nan", [3.0], True, ""], dtype=object)
    holes = table(q=cells)
    expected = [1.0, np.nan, np.nan, 2.5, np.nan, np.nan, 1.0, np.nan]
    np.testing.assert_array_equal(holes.values("q"), expected)
    has(refusal(lambda: holes.column("q")), "'q', row 2: is empty")
    has(refusal(lambda: holes.at(np.array([2]), 8).column(1)), "1, row 3: holds 'x', not a finite")


AXIS = 0.01 * np.arange(1000.0)
COLUMNS = {"t": AXIS, "q": np.sin(5.0 * AXIS), "tau": np.cos(5.0 * AXIS)}


def recorded(columns, **keys):
    names = {"position": "q", "torque": "tau"} | ({} if "rate" in keys else {"time": "t"})
    return measured(Recording.from_dataframe(pd.DataFrame(columns), **names, **keys))


@pytest.mark.parametrize("empty", [np.nan, None, "", "NA"])
@pytest.mark.parametrize("rate", [{}, {"rate": "100 Hz"}])
def test_rows_with_holes_are_left_out_and_counted(empty, rate):
    columns = {name: values.astype(object) for name, values in COLUMNS.items()}
    columns["q"][:3] = columns["tau"][500] = empty
    recording = recorded(columns, **rate)
    assert recording.steps[0].startswith("holes: 4 of 1000 rows left out")
    # the missing row in the middle is no gap in time
    time = recording.time
    assert time[0] == 0.03
    np.testing.assert_allclose(recording.position, np.sin(5.0 * time), atol=1e-3)
    # linear across 0.02 s: (5 0.02)²/8
    np.testing.assert_allclose(recording.torque, np.cos(5.0 * time), atol=1.3e-3)


def test_columns_in_rows_of_their_own_are_paired_by_time():
    """The torque 2.3 ms after the position, each in half of the rows, and not for a second."""
    late = AXIS + 0.0023
    both = {
        "t": np.ravel([AXIS, late], "F"),
        "q": np.ravel([np.sin(5.0 * AXIS), np.full(1000, np.nan)], "F"),
        "tau": np.ravel([np.full(1000, np.nan), np.cos(5.0 * late)], "F"),
    }
    both["tau"][(both["t"] > 4.0) & (both["t"] < 5.0)] = np.nan
    recording = recorded(both)
    assert not ((recording.time > 4.01) & (recording.time < 4.98)).any()
    np.testing.assert_allclose(recording.position, np.sin(5.0 * recording.time), atol=1e-9)
    # linear between 0.01 s: (5 0.01)²/8
    np.testing.assert_allclose(recording.torque, np.cos(5.0 * recording.time), atol=3.2e-4)


@pytest.mark.parametrize("form", ["%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%f+01:00", None])
def test_dates_are_seconds_since_the_first(form):
    dates = pd.to_datetime("2026-03-02T09:59:57") + pd.to_timedelta(AXIS, unit="s")
    times = dates if form is None else dates.strftime(form)
    np.testing.assert_allclose(recorded(COLUMNS | {"t": times}).time, AXIS, atol=1e-9)


@pytest.mark.parametrize("turned", [False, True])
def test_one_of_several_signals(turned):
    state = np.arange(60.0).reshape(20, 3)
    wide = table(t=np.arange(20.0), q=state.T if turned else state)
    for k in range(3):
        assert wide.column(f"q[{k}]").tolist() == state[:, k].tolist()
    has(refusal(lambda: wide.column("q[3]")), "'q[3]'", "from 0 to 2")
    has(refusal(lambda: wide.column("q")), "'q'", "'q[0]'")
    has(refusal(lambda: wide.column("t[0]")), "'t[0]'")
    has(refusal(lambda: wide.column("p[0]")), "'p[0]'")


def test_the_longer_axis_is_time_unless_a_row_has_a_list():
    wide = np.arange(12.0).reshape(3, 4)
    assert table(q=wide).column("q[1]").tolist() == wide[1].tolist()
    assert table(by_rows=True, q=wide).column("q[1]").tolist() == wide[:, 1].tolist()
    named = Table("run", ["q", "q[1]"], [wide, np.ones(3)].__getitem__)
    assert named.column("q[1]").tolist() == [1.0] * 3


def test_lists_that_are_ragged():
    lists = np.empty(3, dtype=object)
    lists[:] = [[0.0, 1.0], [0.0], [0.0, 1.0]]
    ragged = table(q=lists)
    assert ragged.column("q[0]").tolist() == [0.0] * 3
    has(refusal(lambda: ragged.column("q[1]")), "'q[1]'", "row 2")


def test_conditions_are_all_to_hold():
    episodes = table(t=np.arange(6.0), episode=np.repeat([1, 2, 3], 2), on=np.tile([1, 0], 3))
    assert episodes.only({"episode": 2, "on": True}).column("t").tolist() == [2.0]
    assert episodes.only({"on": 0}).column("t").tolist() == [1.0, 3.0, 5.0]
    assert episodes.only({}).column("t").size == 6
    has(refusal(lambda: episodes.only({"episode": 2, "t": 0})), "'t', where", "2, 3")
    has(refusal(lambda: episodes.only({"run": 2})), "'run'")


def test_text_and_numbered_columns_in_a_csv(tmp_path):
    (tmp_path / "run.csv").write_text("task,t,q\nlift,0,1\nswing,1,2\nswing,2,x\nlift,3,4\n")
    assert opened(tmp_path / "run.csv", where={"task": "lift"}).column("q").tolist() == [1.0, 4.0]
    assert opened(tmp_path / "run.csv", where={"2": 1}).column("q").tolist() == [2.0]
    message = refusal(lambda: opened(tmp_path / "run.csv", where={"task": "drop"}))
    has(message, "'drop'", "lift, swing")
    swings = opened(tmp_path / "run.csv", where={"task": "swing"})
    # a bad cell is named by its row in the file, not among those used
    has(refusal(lambda: swings.column("q")), "'q'", "row 3 (line 4)")


def test_a_column_of_another_length_cannot_be_chosen_from():
    chosen = table(t=np.arange(5.0), q=np.arange(4.0)).only({"t": 1})
    has(refusal(lambda: chosen.column("q")), "'q'", "4", "5")


def test_a_name_that_two_columns_have():
    twice = Table("run", ["t", "q", "q"], [np.zeros(3), np.ones(3), np.zeros(3)].__getitem__)
    assert twice.column("t").tolist() == [0.0] * 3
    assert twice.column(2).tolist() == [1.0] * 3
    has(refusal(lambda: twice.column("q")), "columns 2 and 3 are both named 'q'")
