"""What a worker does with a unit, and what a fleet does with missing and failed ones."""

import os
import sys

import pandas as pd
import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.fit.model import Result
from bayesfric.fleet import fleet
from bayesfric.fleet.plan import read_plan
from bayesfric.fleet.workers import UNIT, fit_unit, is_fitted

from .simulated_fleet import write_fleet

pytestmark = pytest.mark.usefixtures("nothing_explained")


def test_a_unit_is_a_small_run_until_its_configuration_or_recording_changes(tmp_path):
    plan = read_plan(write_fleet(tmp_path, good=1))
    text, run = plan.configuration(plan.units[0]), tmp_path / "units" / "a0"
    why, seconds = fit_unit(text, str(run), template=str(plan.template), draws=300)
    assert why == ""
    assert seconds > 0.0
    assert is_fitted(run, text, plan.template)
    assert not is_fitted(run, text.replace("300", "301"), plan.template)
    later = (run / UNIT).stat().st_mtime + 1.0
    os.utime(tmp_path / "u0.csv", (later, later))
    assert not is_fitted(run, text, plan.template)
    assert sum(file.stat().st_size for file in run.iterdir()) < 130_000
    assert Result.read(run).draws.shape[0] == 300


def test_a_fleet_resumes_missing_and_failed_units(tmp_path, monkeypatch):
    def in_this_process(configurations, folder, template, draws, options):  # noqa: ARG001
        for name, text in configurations.items():
            why, seconds = fit_unit(text, str(folder / name), template=str(template), draws=draws)
            yield name, why, False, seconds

    def times():
        paths = [tmp_path / "out/units" / unit / UNIT for unit in ("a0", "a1")]
        return [path.stat().st_mtime_ns for path in paths]

    path = write_fleet(tmp_path, good=2)
    monkeypatch.setattr(fleet, "fit_units", in_this_process)
    first = bf.Fleet.from_config(path).run(tmp_path / "out")
    assert (first.units, first.again, first.left) == (4, 0, {})
    assert "fewer than 50" in first.failed["broken"]
    assert "none.csv: does not exist" in first.failed["missing"]
    assert first.outcomes["failed"] == 2
    table, before = first.frame, times()
    assert list(table.unit.unique()) == ["a0", "a1", "broken", "missing"]
    assert table.set_index("unit").error["missing"] == first.failed["missing"]
    assert set(table[table.unit == "a1"].km) == {1.5}
    # the missing file is there now: fitted by --resume, and nothing else is
    (tmp_path / "none.csv").write_text((tmp_path / "u0.csv").read_text())
    second = bf.Fleet.from_config(path).run(tmp_path / "out", resume=True)
    assert (second.again, set(second.failed)) == (2, {"broken"})
    assert times() == before
    unchanged = second.frame[second.frame.unit.isin(["a0", "a1"])]
    pd.testing.assert_frame_equal(unchanged, table[table.unit.isin(["a0", "a1"])])


def test_an_error_of_a_worker_is_reported_with_its_unit(tmp_path, monkeypatch):
    def fails(configurations, folder, template, draws, options):  # noqa: ARG001
        for name in configurations:
            yield name, "ZeroDivisionError: of all", True, 0.0

    path = write_fleet(tmp_path, good=1)
    monkeypatch.setattr(fleet, "fit_units", fails)
    result = bf.Fleet.from_config(path).run(tmp_path / "out")
    assert set(result.left) == {"a0", "broken", "missing"}
    assert result.outcomes == {"failed": 3}
    assert set(result.frame.error) == {"machine: ZeroDivisionError: of all"}


def test_without_dask(tmp_path, monkeypatch):
    path = write_fleet(tmp_path, good=1)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(BadInput, match=r"pip install 'bayesfric\[fleet\]'"):
        bf.Fleet.from_config(path).run(tmp_path / "out")
    assert not (tmp_path / "out").exists()
