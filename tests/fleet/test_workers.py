"""What a worker does with a unit, and what a fleet does without one."""

import os
import sys

import pandas as pd
import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.fleet import fleet
from bayesfric.fleet.plan import read_plan
from bayesfric.fleet.workers import UNIT, fit_unit, is_fitted
from bayesfric.report.comparison.between_runs import read_draws
from bayesfric.report.summary.record import Summary, read_summary_file

from .made import write_fleet

pytestmark = pytest.mark.usefixtures("nothing_explained")


def in_this_process(configurations, folder, template, draws, options, finished):  # noqa: ARG001
    """Fit units one after another, without workers."""
    for name, text in configurations.items():
        finished(name, *fit_here(text, folder / name, template, draws))


def fit_here(text, folder, template, draws=300):
    why, seconds = fit_unit(text, str(folder), template=str(template), draws=draws)
    return why, False, seconds


def test_a_unit_is_a_small_run_that_can_be_gone_on_with(tmp_path):
    plan = read_plan(write_fleet(tmp_path, good=1))
    text, run = plan.template.filled(plan.units[0]), tmp_path / "units" / "a0"
    why, _, seconds = fit_here(text, run, plan.template.path)
    assert why == ""
    assert seconds > 0.0
    assert is_fitted(run, text, plan.template.path)
    assert not is_fitted(run, text.replace("300", "301"), plan.template.path)
    mark = (run / UNIT).stat().st_mtime
    os.utime(tmp_path / "u0.csv", (mark + 1.0, mark + 1.0))
    assert not is_fitted(run, text, plan.template.path)
    assert sum(file.stat().st_size for file in run.iterdir()) < 130_000
    draws, _ = read_draws(run, Summary.read(read_summary_file(run)))
    assert draws
    assert {x.size for x in draws.values()} == {300}


def test_a_fleet_goes_on_with_what_is_missing_or_failed(tmp_path, monkeypatch):
    path = write_fleet(tmp_path, good=2)
    monkeypatch.setattr(fleet, "fit_units", in_this_process)
    first = bf.Fleet.from_config(path).run(tmp_path / "out")
    assert (first.units, first.again, first.left) == (4, 0, {})
    assert "fewer than 50" in first.failed["broken"]
    assert "none.csv: does not exist" in first.failed["missing"]
    assert first.outcomes["failed"] == 2
    table = first.frame
    assert list(table.unit.unique()) == ["a0", "a1", "broken", "missing"]
    assert table.set_index("unit").error["missing"] == first.failed["missing"]
    assert set(table[table.unit == "a1"].km) == {1.5}
    made = {
        unit: (tmp_path / "out/units" / unit / UNIT).stat().st_mtime_ns for unit in ("a0", "a1")
    }
    # mended: fitted by --resume, and nothing else is
    (tmp_path / "none.csv").write_text((tmp_path / "u0.csv").read_text())
    second = bf.Fleet.from_config(path).run(tmp_path / "out", resume=True)
    assert (second.again, set(second.failed)) == (2, {"broken"})
    for unit, when in made.items():
        assert (tmp_path / "out/units" / unit / UNIT).stat().st_mtime_ns == when
    kept = second.frame[second.frame.unit.isin(["a0", "a1"])]
    pd.testing.assert_frame_equal(kept, table[table.unit.isin(["a0", "a1"])])


def test_a_defect_is_its_worker_s_and_of_no_other_unit(tmp_path, monkeypatch):
    """What a worker raises is said of the unit, and the fleet ends."""

    def fails(configurations, folder, template, draws, options, finished):  # noqa: ARG001
        for name in configurations:
            finished(name, "ZeroDivisionError: of all", True, 0.0)

    path = write_fleet(tmp_path, good=1)
    monkeypatch.setattr(fleet, "fit_units", fails)
    found = bf.Fleet.from_config(path).run(tmp_path / "out")
    assert set(found.left) == {"a0", "broken", "missing"}
    assert found.outcomes == {"failed": 3}
    assert set(found.frame.error) == {"machine: ZeroDivisionError: of all"}


def test_without_dask_one_line_says_what_to_install(tmp_path, monkeypatch):
    path = write_fleet(tmp_path, good=1)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(BadInput, match=r"not installed; pip install 'bayesfric\[fleet\]'"):
        bf.Fleet.from_config(path).run(tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"cluster": {"memory_limit": "much"}}, "memory_limit = 'much'"),
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
