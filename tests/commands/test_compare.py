"""``bayesfric compare`` as a user runs it."""

import csv
import json

import h5py
import pytest

from bayesfric.report.figures import style
from tests.report.made_summaries import LEG, TOTALS, knee, loaded
from tests.report.page_reader import number, read_page

from .bench import below_a_file, has


@pytest.fixture
def runs(bench):
    """Give three runs, two of which have the same name in different folders."""
    for folder, summary in (("knee", knee()), ("a/run", loaded()), ("b/run", loaded())):
        (bench.folder / folder).mkdir(parents=True)
        write(bench.folder / folder, json.dumps(summary, ensure_ascii=False))
    (bench.folder / "link").symlink_to("knee", target_is_directory=True)
    below_a_file(bench.folder)
    return bench


def write(folder, text):
    (folder / "summary.json").write_text(text, encoding="utf-8")


@pytest.fixture
def undrawn(monkeypatch):
    """Leave the figure's pixels out; a process of its own draws them in one test."""
    monkeypatch.setattr(style, "save", lambda *_: None)


def test_one_run_in_a_process_of_its_own(runs):
    ended = runs.run_apart("compare", "knee", "-o", "out")
    assert (ended.code, ended.err) == (0, ""), ended
    found = {str(path.relative_to(runs.folder / "out")) for path in runs.folder.glob("out/**/*")}
    assert found == {
        "report.html", "comparison.csv", "comparison.tex", "comparison.json", "figures",
        "figures/forest.pdf", "figures/forest.png", "figures/forest.svg",
    }  # fmt: skip
    with (runs.folder / "out" / "comparison.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["name"] for row in rows} >= {*TOTALS, *LEG}
    left = [path.name for path in runs.folder.iterdir() if path.name.startswith(".")]
    assert left == []


def test_runs_of_one_name_are_told_apart(runs, monkeypatch):
    def named(*folders):
        columns = runs.told("compare", *folders)["columns"]
        return [column["label"].removesuffix(": posterior") for column in columns[:2]]

    assert named("a/run", "b/run") == ["a/run", "b/run"]
    monkeypatch.chdir(runs.folder / "knee")  # the working folder has a name, too
    assert named(".", "../a/run") == ["knee", "run"]


# -- bad input: one line, exit code 2, nothing written (``refused`` looks)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["nowhere"], ["nowhere: there is no such folder"]),
        (["knee/summary.json"], ["knee/summary.json: is a file"]),
        (["a"], ["a: holds no summary.json"]),
        (["knee", "knee"], ["knee: is given twice"]),
        (["knee", "link"], ["link: is given twice"]),
        (["knee", "-o", "plain/out"], ["plain/out: cannot be written"]),
        (["knee" * 200], ["cannot be read"]),
        (["knee", "-o", "knee"], ["knee: is not empty"]),
        (["knee", "nowhere", "-o", "no/such/out"], ["nowhere: there is no such folder"]),
    ],
)
def test_places(runs, arguments, parts):
    message = runs.refused("compare", *arguments)
    has(message, *parts)
    # there is no such option here
    assert "--force" not in message


def page_of(runs):
    return read_page((runs.folder / "out" / "report.html").read_text(encoding="utf-8"))


@pytest.mark.usefixtures("undrawn")
def test_the_page_of_several_runs(runs):
    assert runs.run("compare", "knee", "a/run", "-o", "out").code == 0
    page = page_of(runs)
    with (runs.folder / "out" / "between-runs.csv").open(encoding="utf-8", newline="") as file:
        pooled = {row["name"]: row for row in csv.DictReader(file)}
    (table,) = [t for t in page.all("table") if "pooled" in t.attrs["class"]]
    shown = {r.attrs["data-name"]: r for r in table.all("tr") if "data-name" in r.attrs}
    assert set(shown) == set(pooled)
    assert set(TOTALS) <= set(shown)
    assert set(LEG).isdisjoint(shown)
    for name, row in shown.items():
        mean, ends, following, _, between, _, p, said = list(row.all("td"))
        cells = (
            (mean, ["mean"]),
            (following, ["following_low", "following_high"]),
            (ends, ["mean_low", "mean_high"]),
        )
        for cell, keys in cells:
            told, last = number(cell.text)
            wanted = [float(pooled[name][key]) for key in keys]
            assert told[: len(keys)] == pytest.approx(wanted, abs=0.51 * last)
        assert float(between.attrs["data-sort"]) == float(pooled[name]["spread"])
        assert float(p.attrs["data-sort"]) == float(pooled[name]["p_value"])
        # the second run is 0.7 sds off: nobody can call that a difference
        assert said.text == "2 of 2 agree"
    # what one run leaves open is open in its column, whatever the other says
    for cell in page.all("td", **{"data-status": "undetermined"}):
        assert cell.text.startswith("not determined")
        assert not set("[±") & set(cell.text)


@pytest.mark.usefixtures("undrawn")
def test_runs_of_one_recording_are_not_pooled(runs):
    for name in ("knee", "a/run"):
        with h5py.File(runs.folder / name / "posterior.nc", "w") as file:
            file.attrs.update(versions="{}", seed="1", recordings='{"r": "ab12"}', spans="{}")
    assert runs.run("compare", "knee", "a/run", "-o", "out").code == 0
    page = page_of(runs)
    assert "same seconds of a recording" in page.text
    assert not [t for t in page.all("table") if "pooled" in t.attrs["class"]]
