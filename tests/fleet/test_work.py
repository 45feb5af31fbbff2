"""What a worker does: once, in a folder of its own, and what is the machine's fault."""

import errno
import json
import sys

import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.fleet import work
from bayesfric.fleet.fleet import _Course
from bayesfric.fleet.plan import read_plan
from bayesfric.fleet.results import Results
from bayesfric.report.comparison.between_runs import read_draws
from bayesfric.report.summary.record import Summary, read_summary_file

from .made import write_fleet

pytestmark = pytest.mark.usefixtures("nothing_explained")


def begun(folder, good=1):
    """Begin with a fleet; give how far it is, and its tasks by name."""
    plan = read_plan(write_fleet(folder, good))
    course = _Course(plan, Results(folder / "r.parquet", plan.units), lambda _: None)
    return course, {task["name"]: task for task in course.tasks(folder / "units")}


@pytest.fixture
def tasks(tmp_path):
    return begun(tmp_path)[1]


def test_a_unit_is_done_once_while_nothing_changes(tasks, tmp_path):
    task = tasks["a0"]
    first = work.do_unit(task)
    assert not first["again"]
    assert first["record"]["outcome"] in ("good", "usable", "unchecked"), first
    # what goes through the scheduler is data
    assert json.loads(json.dumps(first)) == first
    again = work.do_unit(task)
    assert again == first | {"again": True, "cpu_seconds": again["cpu_seconds"]}
    # no fit was made
    assert 0.0 < again["cpu_seconds"] < 0.5 * first["cpu_seconds"]
    # the run is small, and can be gone on with: compared, pooled, fitted again
    run = tmp_path / "units" / "a0"
    assert sum(one.stat().st_size for one in run.iterdir()) < 130_000
    summary = Summary.read(read_summary_file(run))
    found = read_draws(run, summary)
    assert found.values
    assert {x.size for x in found.values.values()} == {300}
    # a recording that changed is fitted anew, and one that is as before gives the same
    csv = tmp_path / "u0.csv"
    before = csv.read_text()
    csv.write_text(before.rsplit("\n", 2)[0] + "\n")
    changed = work.do_unit(task)
    assert not changed["again"]
    assert changed["record"]["rows"] != first["record"]["rows"]
    csv.write_text(before)
    assert work.do_unit(task)["record"] == first["record"]


def test_a_unit_that_fails_is_told_in_its_line_until_it_is_mended(tasks, tmp_path):
    missing = tasks["missing"]
    first = work.do_unit(missing)
    assert first["record"]["outcome"] == "failed"
    assert "none.csv: does not exist" in first["record"]["error"]
    assert work.do_unit(missing)["again"]
    # another configuration is another fit
    other = {**missing, "text": missing["text"].replace("300", "301")}
    assert not work.do_unit(other)["again"]
    (tmp_path / "none.csv").write_text((tmp_path / "broken.csv").read_text())
    second = work.do_unit(missing)
    assert not second["again"]
    assert "fewer than 50" in second["record"]["error"]


def test_a_defect_is_its_units(tasks, monkeypatch):
    def fails(_):
        raise ZeroDivisionError("of\nall")

    monkeypatch.setattr(work.Model, "from_config", fails)
    record = work.do_unit(tasks["a0"])["record"]
    assert record["error"] == "internal: ZeroDivisionError: of all"


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO])
def test_a_fault_of_the_machine_is_none_of_the_unit(tasks, monkeypatch, number):
    def fails(_):
        raise OSError(number, "it is the machine")

    with monkeypatch.context() as patch:
        patch.setattr(work.Model, "from_config", fails)
        with pytest.raises(OSError, match="it is the machine") as told:
            work.do_unit(tasks["broken"])
    assert told.value.errno == number
    # nothing is kept of it
    assert not work.do_unit(tasks["broken"])["again"]


def test_without_dask_one_line_says_what_to_install(tmp_path, monkeypatch):
    path = write_fleet(tmp_path, good=1)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(BadInput, match=r"not installed; pip install 'bayesfric\[fleet\]'"):
        bf.Fleet.from_config(path).run(tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"cluster": {"memory_limit": "much"}}, "memory_limit = 'much': is no size"),
        ({"cluster": {"worker": 2}}, "Fleet: cluster.worker: unknown key"),
        ({"runs": {"draws": "all"}}, "Fleet: runs.draws"),
    ],
)
def test_options_in_python_are_checked_as_those_of_a_file(tmp_path, options, said):
    write_fleet(tmp_path, good=1)
    with pytest.raises(BadInput) as told:
        bf.Fleet(tmp_path / "unit.toml", tmp_path / "units.csv", **options).run(tmp_path / "out")
    assert said in str(told.value)
    assert not (tmp_path / "out").exists()
