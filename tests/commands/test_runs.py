"""``report``, ``compare``, ``rollout`` and ``export`` of finished, damaged and moved runs."""

import csv
import hashlib
import json
import os
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from bayesfric.commands.fit import fit
from bayesfric.diagnostics import explanation
from bayesfric.problem.config import read_config
from bayesfric.report.figures import style
from tests.report.made_summaries import LEG, TOTALS, knee, loaded
from tests.report.page_reader import number, read_page

from .bench import SAMPLED, has, simulated, without_figures
from .test_fit import draws

pytestmark = pytest.mark.usefixtures("nothing_explained")


# -- pages and tables of summaries


def write(folder, summary):
    text = summary if isinstance(summary, str) else json.dumps(summary, ensure_ascii=False)
    (folder / "summary.json").write_text(text, encoding="utf-8")


@pytest.fixture
def runs(bench):
    """Write three runs, two of which have the same name in different folders."""
    for folder, summary in (("knee", knee()), ("a/run", loaded()), ("b/run", loaded())):
        (bench.folder / folder).mkdir(parents=True)
        write(bench.folder / folder, summary)
    (bench.folder / "link").symlink_to("knee", target_is_directory=True)
    (bench.folder / "plain").write_text("a file, not a folder")
    return bench


@pytest.fixture
def undrawn(monkeypatch):
    """Leave the figure's pixels out; a separate process draws them in one test."""
    monkeypatch.setattr(style, "save", lambda *_: None)


def test_report_in_a_separate_process_and_again(runs):
    ended = runs.run_apart("report", "knee", "--json")
    assert (ended.code, ended.err) == (0, ""), ended
    record = json.loads(ended.out)
    assert record["run"] == "knee"
    for name in record["written"]:
        assert (runs.folder / "knee" / name).stat().st_size, name
    page = runs.folder / "knee" / "report.html"
    first = page.read_bytes()
    assert runs.run("report", "knee").code == 0
    assert page.read_bytes() == first


def test_compare_in_a_separate_process(runs):
    ended = runs.run_apart("compare", "knee", "-o", "out")
    assert (ended.code, ended.err) == (0, ""), ended
    names = {str(path.relative_to(runs.folder / "out")) for path in runs.folder.glob("out/**/*")}
    assert names == {
        "report.html", "comparison.csv", "comparison.tex", "comparison.json", "figures",
        "figures/forest.pdf", "figures/forest.png", "figures/forest.svg",
    }  # fmt: skip
    with (runs.folder / "out" / "comparison.csv").open(encoding="utf-8", newline="") as file:
        assert {row["name"] for row in csv.DictReader(file)} >= {*TOTALS, *LEG}


def test_runs_with_the_same_name_are_distinguished(runs, monkeypatch):
    def labels(*folders):
        columns = runs.record("compare", *folders)["columns"]
        return [column["label"].removesuffix(": posterior") for column in columns[:2]]

    assert labels("a/run", "b/run") == ["a/run", "b/run"]
    monkeypatch.chdir(runs.folder / "knee")  # the working folder has a name, too
    assert labels(".", "../a/run") == ["knee", "run"]


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["nowhere"], "nowhere: there is no such folder"),
        (["knee/summary.json"], "knee/summary.json: is a file"),
        (["a"], "a: holds no summary.json"),
        (["knee", "link"], "link: is given twice"),
        (["knee", "-o", "plain/out"], "plain/out: cannot be written"),
        (["knee", "-o", "knee"], "knee: is not empty"),
    ],
)
def test_bad_places(runs, arguments, part):
    has(runs.refused("compare", *arguments), part)
    if "-o" not in arguments and "link" not in arguments:
        has(runs.refused("report", *arguments), part)


@pytest.mark.parametrize("command", ["report", "compare", "rollout", "export"])
def test_a_run_of_an_earlier_version(runs, command):
    write(runs.folder / "knee", knee() | {"bayesfric": "0.1.0"})
    options = ["--to", "csv"] if command == "export" else []
    has(runs.refused(command, "knee", *options), "knee: ", "bayesfric 0.1", "fit it again")


@pytest.mark.parametrize(
    ("text", "part"),
    [
        *((json.dumps(knee())[:cut], "knee/summary.json: ") for cut in (0, 1, 900, -3)),
        ("[]", "knee/summary.json"),
        ("[" * 100_000, "knee/summary.json"),
        ('{"parameters": {"a": 3}}', "parameters.a"),
        ("{}", "parameters"),
        ('{"parameters": {}, "derived": []}', "derived"),
        (json.dumps(knee() | {"warnings": 3}), "warnings"),
        (json.dumps(knee() | {"sampler": {"status": "reliable", "ensembles": "4"}}), "ensembles"),
    ],
)
def test_damaged_summaries(runs, text, part):
    write(runs.folder / "knee", text)
    has(runs.refused("report", "knee"), part)


def compared(runs):
    assert runs.run("compare", "knee", "a/run", "-o", "out").code == 0
    return read_page((runs.folder / "out" / "report.html").read_text(encoding="utf-8"))


@pytest.mark.usefixtures("undrawn")
def test_the_page_of_several_runs(runs):
    page = compared(runs)
    with (runs.folder / "out" / "between-runs.csv").open(encoding="utf-8", newline="") as file:
        pooled = {row["name"]: row for row in csv.DictReader(file)}
    (table,) = [t for t in page.all("table") if "pooled" in t.attrs["class"]]
    rows = {r.attrs["data-name"]: r for r in table.all("tr") if "data-name" in r.attrs}
    assert set(TOTALS) <= set(rows) == set(pooled)
    assert set(LEG).isdisjoint(rows)
    for name, row in rows.items():
        mean, ends, following, _, between, _, p, agreement = list(row.all("td"))
        cells = (
            (mean, ["mean"]),
            (following, ["following_low", "following_high"]),
            (ends, ["mean_low", "mean_high"]),
        )
        for cell, keys in cells:
            numbers, last = number(cell.text)
            expected = [float(pooled[name][key]) for key in keys]
            assert numbers[: len(keys)] == pytest.approx(expected, abs=0.51 * last)
        assert float(between.attrs["data-sort"]) == float(pooled[name]["spread"])
        assert float(p.attrs["data-sort"]) == float(pooled[name]["p_value"])
        # the second run is 0.7 sds off: nobody can call that a difference
        assert agreement.text == "2 of 2 agree"
    # what one run leaves open is open in its column, whatever the other says
    for cell in page.all("td", **{"data-status": "unidentified"}):
        assert not set("[±") & set(cell.text)


@pytest.mark.usefixtures("undrawn")
def test_runs_of_one_recording_are_not_pooled(runs):
    for name in ("knee", "a/run"):
        with h5py.File(runs.folder / name / "posterior.nc", "w") as file:
            file.attrs.update(versions="{}", seed="1", recordings='{"r": "ab12"}', spans="{}")
    assert not [t for t in compared(runs).all("table") if "pooled" in t.attrs["class"]]


# -- a finished run and its recording


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A folder with a project and a finished run of it."""
    folder = tmp_path_factory.mktemp("finished")
    (folder / "project").mkdir()
    simulated(folder / "project" / "c.toml", SAMPLED)
    with pytest.MonkeyPatch.context() as patch:
        without_figures(patch)
        patch.setattr(explanation, "least_outputs", lambda _: 10**9)
        # names as a user gives them: relative to the working folder
        patch.chdir(folder / "project")
        fit(read_config(Path("c.toml")), Path("../run"))
    return folder


@pytest.fixture
def project(bench, finished, monkeypatch):
    without_figures(monkeypatch)
    monkeypatch.chdir(finished)
    return bench


def test_the_configuration_of_a_run_repeats_it(project, finished):
    assert (finished / "run" / "config.toml").read_text() == SAMPLED
    assert project.run("fit", "run/config.toml", "-o", "again").code == 0
    again = draws(finished / "again")
    for name, values in draws(finished / "run").items():
        np.testing.assert_array_equal(again[name], values, err_msg=name)


def test_a_recording_may_move_to_the_run(project, finished):
    file = finished / "project" / "small.csv"
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    summary = json.loads((finished / "run/summary.json").read_text())
    (source,) = summary["source"]["recordings"].values()
    assert source == {"file": str(file), "sha256": digest}
    moved = file.rename(file.with_name("elsewhere.csv"))
    has(project.refused("check", "run/config.toml"), "run/small.csv")
    # where the message says
    moved.rename(finished / "run" / "small.csv")
    assert project.run("check", "run/config.toml").code == 0
    (finished / "run" / "small.csv").rename(file)


def test_a_changed_recording_is_warned_of(project, finished):
    assert "SHA-256" not in project.run("check", "run/config.toml").out
    file = finished / "project" / "small.csv"
    text = file.read_text()
    file.write_text(text[: text.rstrip().rindex("\n") + 1])
    has(project.run("check", "run/config.toml").out, "SHA-256")
    file.write_text(text)


@pytest.mark.parametrize("text", ["", "[]", '{"bayesfric": "0.1.0"}'])
def test_a_summary_of_another_kind_is_not_a_run(bench, text):
    path = (bench.folder / "c.toml").rename(bench.folder / "config.toml")
    path.with_name("summary.json").write_text(text)
    assert read_config(path).folder == bench.folder


def delete_inertia(group):
    del group["motor.inertia"]


def shorten(group):
    values = group["motor.inertia"][:, :-1]
    del group["motor.inertia"]
    group["motor.inertia"] = values


def set_nan(group):
    group["motor.inertia"][0, 0] = np.nan


@pytest.mark.parametrize("damage", [None, 0, 5000, delete_inertia, shorten, set_nan])
def test_damaged_draws(project, finished, damage):
    run = Path(shutil.copytree(finished / "run", finished / "damaged", dirs_exist_ok=True))
    path = run / "posterior.nc"
    if damage is None:
        path.unlink()
    elif isinstance(damage, int):
        os.truncate(path, damage)
    else:
        with h5py.File(path, "r+") as file:
            damage(file["posterior"])
    for words in (["rollout", "damaged"], ["export", "damaged", "--to", "csv"]):
        ended = project.run(*words)
        assert ended.code == 2
        has(ended.err, "damaged/posterior.nc")
    if damage in (None, 0):  # page and table need no draws
        assert project.run("report", "damaged").code == 0
        assert project.run("compare", "damaged").code == 0
