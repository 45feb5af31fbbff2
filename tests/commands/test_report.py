"""``bayesfric report`` as a user runs it."""

import json

import pytest

from tests.report.made_summaries import knee

from .bench import has


@pytest.fixture
def runs(bench):
    (bench.folder / "knee").mkdir()
    write(bench, json.dumps(knee(), ensure_ascii=False))
    return bench


def write(bench, text):
    (bench.folder / "knee" / "summary.json").write_text(text, encoding="utf-8")


def test_in_a_process_of_its_own(runs):
    ended = runs.run_apart("report", "knee", "--json")
    assert (ended.code, ended.err) == (0, ""), ended
    found = json.loads(ended.out)
    assert found["run"] == "knee"
    assert "report.html" in found["written"]
    for name in found["written"]:
        assert (runs.folder / "knee" / name).stat().st_size, name
    page = runs.folder / "knee" / "report.html"
    first = page.read_text(encoding="utf-8")
    assert "<h1>knee</h1>" in first
    assert runs.run("report", "knee").code == 0
    assert page.read_text(encoding="utf-8") == first
    assert not list((runs.folder / "knee").glob(".*"))


def test_a_run_of_parameters_alone(runs):
    write(runs, json.dumps({"parameters": knee()["parameters"]}))
    assert runs.run("report", "knee").code == 0


@pytest.mark.parametrize("command", ["report", "compare", "rollout", "export"])
def test_a_run_of_an_earlier_version_is_to_be_fitted_again(runs, command):
    write(runs, json.dumps(knee() | {"bayesfric": "0.1.0"}))
    options = ["--to", "csv"] if command == "export" else []
    said = runs.refused(command, "knee", *options)
    has(said, "knee: is a run of bayesfric 0.1, which this version cannot read", "fit it again")


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("nobody", ["nobody", "no such folder"]),
        ("empty", ["empty", "summary.json"]),
        ("knee/summary.json", ["is a file"]),
    ],
)
def test_places_without_a_run(runs, place, said):
    (runs.folder / "empty").mkdir()
    has(runs.refused("report", place), *said)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        *(
            (json.dumps(knee())[:cut], "knee/summary.json: is not valid JSON")
            for cut in (0, 1, 40, 900, -3)
        ),
        ("[]", "holds no table"),
        ("null", "holds no table"),
        ("[" * 100_000, "is not valid JSON"),
        ('{"parameters": {"a": 3}}', "parameters.a"),
        ("{}", "parameters"),
        ('{"parameters": {}, "derived": []}', "derived"),
        ('{"parameters": {"a.b": {"unit": "N"}}}', "a.b"),
        (json.dumps(knee() | {"warnings": 3}), "warnings"),
        (json.dumps(knee() | {"sampler": {"status": "reliable", "ensembles": "4"}}), "ensembles"),
    ],
)
def test_other_summaries(runs, text, said):
    write(runs, text)
    has(runs.refused("report", "knee"), said)


def test_a_page_that_cannot_be_replaced(runs):
    (runs.folder / "knee" / "report.html").mkdir()
    has(runs.refused("report", "knee"), "report.html", "is a folder")
