"""Overlaid posteriors: densities are densities, medians the summary's, nothing open is bare."""

import copy
import json
import math
import re
import shutil

import h5py
import numpy as np
import pytest
from scipy import stats

from bayesfric.commands.compare import compare
from bayesfric.mechanism.presets import PRESETS
from bayesfric.report.comparison.between_runs import between_runs
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.comparison.run_draws import RunDraws, read_draws
from bayesfric.report.figures import overlay as module
from bayesfric.report.figures import style
from bayesfric.report.figures.overlay import (
    density,
    overlay_caption,
    overlay_figure,
    overlay_words,
)
from bayesfric.report.figures.registry import ComparedRuns
from bayesfric.report.figures.style import PAGE, run_style, save
from bayesfric.report.summary.record import Summary

from .made_summaries import LEG, knee, loaded, posterior_row
from .page_reader import read_page
from .test_figures import drawn_ticks, shown_texts


def overlay(*compared):
    return module.overlay(ComparedRuns(*compared))


def integral(x, height):
    return float(height.sum() * (x[1] - x[0]))


LAWS = {
    "normal": stats.norm(3.0, 1e-5),
    "at a bound": stats.expon(scale=2.0),
    "uniform": stats.uniform(-1.0, 2.0),
    "skewed": stats.gamma(2.0, scale=1e4),
}


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
def test_a_density_integrates_to_one_and_is_near_the_true_one(law):
    draws = law.rvs(40_000, random_state=np.random.default_rng(11))
    x, height = density(draws)
    assert integral(x, height) == pytest.approx(1.0, abs=1e-9)
    assert np.all(height >= 0)
    mass = np.cumsum(height) * (x[1] - x[0])
    # total variation; a kernel of 0.15 sds and 40 000 draws leave about 2 %
    apart = 0.5 * np.abs(height - law.pdf(x)).sum() * (x[1] - x[0])
    assert apart < 0.03
    median = float(x[np.searchsorted(mass, 0.5)])
    assert median == pytest.approx(np.median(draws), abs=0.03 * draws.std())


def test_a_density_does_not_leak_over_its_bound():
    law = stats.expon()
    x, height = density(law.rvs(40_000, random_state=np.random.default_rng(3)))
    assert x[0] > 0
    # without the reflection it were half of one there; the kernel's width takes a tenth or so
    assert height[0] == pytest.approx(1.0, abs=0.15)


def test_far_draws_cost_their_share_and_no_more():
    draws = stats.cauchy().rvs(20_000, random_state=np.random.default_rng(5))
    draws[:3] = 1e300, np.nan, np.inf
    x, height = density(draws)
    # within twenty quartile ranges beyond the quartiles: 41 to either side
    assert integral(x, height) == pytest.approx(2 / math.pi * math.atan(41), abs=0.01)
    assert x.size < 20_000


def test_draws_that_are_all_the_same_have_a_place_and_no_density():
    x, height = density(np.full(100, 0.3))
    assert x.tolist() == [0.3]
    assert np.isinf(height)


# -- draws of runs


def test_derived_draws_have_the_medians_of_the_summary(written_run):
    text = (written_run / "summary.json").read_text(encoding="utf-8")
    summary = Summary.read(json.loads(text), "run")
    found = read_draws(written_run, summary, lambda _: PRESETS["rabbit-knee"].chain())
    assert found.missing == ""
    assert set(summary.parameters) <= set(found.values)
    derived = [name for name in found.values if name in summary.derived]
    assert {"total_drive.inertia", "total_back.gravity", "gearbox.lambda_ratio"} <= set(derived)
    for name, draws in found.values.items():
        row = summary.parameters[name] if name in summary.parameters else summary.derived[name]
        assert np.median(draws) == pytest.approx(row.median, rel=1e-9)
    # without the chain nothing can be derived, and nothing is guessed
    alone = read_draws(written_run, summary, lambda _: None)
    assert set(alone.values) == set(summary.parameters)


def test_draws_with_room_for_the_models_error_come_first(written_run, tmp_path):
    text = (written_run / "summary.json").read_text(encoding="utf-8")
    summary = Summary.read(json.loads(text), "run")
    shutil.copytree(written_run, tmp_path / "run")
    row = summary.parameters["motor.inertia"]
    with h5py.File(tmp_path / "run" / "posterior.nc", "a") as file:
        for name in summary.parameters:
            draws = file["posterior"][name][()]
            file[f"told/{name}"] = np.median(draws) + 3.0 * (draws - np.median(draws))
    found = read_draws(tmp_path / "run", summary, lambda _: None)
    assert found.values["motor.inertia"].std() == pytest.approx(3.0 * row.sd, rel=0.05)


def test_what_is_fixed_takes_part(written_run):
    text = (written_run / "summary.json").read_text(encoding="utf-8")
    raw = json.loads(text)
    row = raw["parameters"].pop("motor.inertia")
    raw["fixed"] = {"motor.inertia": {"unit": "kg m²", "value": row["median"]}}
    summary = Summary.read(raw, "run")
    found = read_draws(written_run, summary, lambda _: PRESETS["rabbit-knee"].chain())
    assert "motor.inertia" not in found.values
    # its share of the total no longer varies
    assert "total_drive.inertia" in found.values
    whole = read_draws(
        written_run,
        Summary.read(json.loads(text), "run"),
        lambda _: PRESETS["rabbit-knee"].chain(),
    )
    assert found.values["total_drive.inertia"].std() < whole.values["total_drive.inertia"].std()


def spoilt(kind):
    def of(path):
        if kind == "none":
            path.unlink()
        elif kind == "no file of its kind":
            path.write_bytes(b"not HDF5")
        elif kind == "half":
            path.write_bytes(path.read_bytes()[:5000])
        else:
            with h5py.File(path, "a") as file:
                if kind == "no group":
                    del file["posterior"]
                elif kind == "words":
                    del file["posterior"]["motor.inertia"]
                    file["posterior"]["motor.inertia"] = "words"
                elif kind == "other draws":
                    file["posterior"]["motor.inertia"][...] *= 1.5

    return of


@pytest.mark.parametrize(
    ("kind", "why"),
    [
        ("none", "has no posterior.nc"),
        ("no file of its kind", "cannot be read"),
        ("half", "cannot be read"),
        ("no group", "cannot be read"),
        ("words", "cannot be read"),
        ("other draws", "other draws than its summary.json"),
    ],
)
def test_draws_that_are_no_good_are_left_out_by_name(written_run, tmp_path, kind, why):
    shutil.copytree(written_run, tmp_path / "run")
    spoilt(kind)(tmp_path / "run" / "posterior.nc")
    text = (written_run / "summary.json").read_text(encoding="utf-8")
    found = read_draws(tmp_path / "run", Summary.read(json.loads(text), "run"), lambda _: None)
    assert not found.values
    assert why in found.missing


# -- the figure


def draws_of(summary, seed):
    """Normal draws with each row's mean and sd."""
    rng = np.random.default_rng(seed)
    rows = {**summary.derived, **summary.parameters}
    return RunDraws({n: r.mean + r.sd * rng.standard_normal(4000) for n, r in rows.items()})


def made(**summaries):
    """Overlay runs; what is ``None`` in place of draws is left out."""
    runs = {name: Summary.read(summary, name) for name, summary in summaries.items()}
    draws = {name: draws_of(run, k) for k, (name, run) in enumerate(runs.items())}
    return comparison(summaries), runs, draws


def test_what_is_shown_and_in_which_order():
    found, runs, draws = made(knee=knee(), loaded=loaded())
    shown = overlay(found, runs, draws)
    names = [panel.row.name for panel in shown.panels]
    assert set(LEG) <= set(names)
    assert "noise.sigma" not in names
    free = [panel.row.gauge_free for panel in shown.panels]
    assert free == sorted(free, reverse=True)
    for panel in shown.panels:
        told = {curve.run: curve.told for curve in panel.curves}
        assert told == {"knee": "open" if panel.row.name in LEG else "data", "loaded": "data"}
    # what no run determines is left out
    assert set(LEG).isdisjoint(
        panel.row.name for panel in overlay(*made(a=knee(), b=knee())).panels
    )


def test_what_is_open_is_never_a_bare_curve():
    other = copy.deepcopy(loaded())
    other["parameters"]["motor.viscous"]["verdict"] = "weak"
    figure = overlay_figure(overlay(*made(knee=knee(), loaded=other)))
    seen = set()
    for ax in figure.axes:
        hatched = {c.get_gid() for c in ax.collections if c.get_hatch()}
        filled = {c.get_gid() for c in ax.collections if not c.get_hatch()}
        for line in ax.lines:
            told, run = line.get_gid().split(" ")
            area = f"{told} area {run}"
            seen.add(told)
            assert (area in hatched) == (told == "open")
            assert (area in filled) == (told == "data")
            if told == "open":
                words = [text.get_text() for text in ax.texts if text.get_gid() == "open"]
                assert words == [f"{run}: NOT determined"]
    assert seen == {"data", "both", "open"}


def test_curves_hold_the_summarys_medians_and_are_told_apart():
    found, runs, draws = made(knee=knee(), loaded=loaded())
    shown = overlay(found, runs, draws, between_runs(runs))
    for panel in shown.panels:
        for curve in panel.curves:
            mass = np.cumsum(curve.density) * (curve.x[1] - curve.x[0])
            assert mass[-1] == pytest.approx(1.0, abs=1e-9)
            median = float(curve.x[np.searchsorted(mass, 0.5)])
            # 4000 draws: a standard error of 0.02 sds
            assert median == pytest.approx(curve.row.mean, abs=0.1 * curve.row.sd)
    figure = overlay_figure(shown)
    looks = {(line.get_color(), line.get_linestyle()) for ax in figure.axes for line in ax.lines}
    assert len(looks) == 2
    assert len({repr(run_style(k)) for k in range(12)}) == 12
    words = {ax.get_gid(): [t.get_text() for t in ax.texts] for ax in figure.axes}
    assert words["total.inertia"] == ["agree"]
    for ax in figure.axes:
        # symbol and unit, a dash where there is none
        assert re.search(r" \(.+\)$", ax.get_xlabel())


def test_a_run_without_draws_is_named_and_not_drawn():
    found, runs, draws = made(knee=knee(), loaded=loaded(), third=loaded())
    draws["third"] = RunDraws(missing="has no posterior.nc")
    shown = overlay(found, runs, draws)
    assert shown.left_out == {"third": "has no posterior.nc"}
    assert all(curve.run != "third" for panel in shown.panels for curve in panel.curves)
    said = [text.get_text() for text in overlay_figure(shown).texts]
    assert said == ["not shown: third, which has no posterior.nc"]
    assert "third, which has no posterior.nc" in overlay_caption(shown)
    # one curve alone is no overlay
    draws["loaded"] = RunDraws(missing="has no posterior.nc")
    assert overlay(found, runs, draws).panels == ()


def test_words_give_no_number_of_what_is_open():
    run = knee()
    for name in LEG:
        run["parameters"][name] |= {"mean": 0.717171, "median": 0.717171, "interval": [0.7171, 0.8]}
    words = overlay_words(overlay(*made(knee=run, loaded=loaded())))
    assert "load.first_moment in kg m: knee not determined by the data, loaded 0.428" in words
    assert "7171" not in words


def test_limits_have_no_interval_in_words():
    row = {"at_bound": "lower", "data_sd": 0.01, "prior_sd": 1.0}
    runs = {"knee": knee(), "loaded": loaded()}
    for run in runs.values():
        run["parameters"]["motor.coulomb"] = posterior_row(
            "N m", 0.02, 0.015, verdict="weak", **row
        )
    shown = overlay(*made(**runs))
    (panel,) = [p for p in shown.panels if p.row.name == "motor.coulomb"]
    assert {curve.told for curve in panel.curves} == {"both"}
    assert "motor.coulomb in N m: knee at most 0.0447" in overlay_words(shown)


def test_nothing_is_cut_off_and_nothing_overlaps():
    names = ["a run with quite a long name, longer than there is room for", "b", "c" * 40]
    found, runs, draws = made(**{name: loaded() for name in names}, open=knee(), none=knee())
    draws["none"] = RunDraws(missing="has a posterior.nc that cannot be read")
    figure = overlay_figure(overlay(found, runs, draws, between_runs(runs)))
    assert figure.get_figwidth() == PAGE
    assert figure.get_figheight() <= 9.0
    ticks = {id(t.label1) for ax in figure.axes for a in (ax.xaxis, ax.yaxis) for t in a.majorTicks}
    texts, drawn = shown_texts(figure), drawn_ticks(figure)
    boxes = [(t, b) for t, b in texts if id(t) not in ticks or id(t) in drawn]
    width, height = figure.bbox.size
    for k, (text, box) in enumerate(boxes):
        assert min(box.x0, box.y0) >= 0, text.get_text()
        assert box.x1 <= width, text.get_text()
        assert box.y1 <= height, text.get_text()
        for other, other_box in boxes[:k]:
            across = min(box.x1, other_box.x1) - max(box.x0, other_box.x0)
            up = min(box.y1, other_box.y1) - max(box.y0, other_box.y0)
            assert across <= 1.0 or up <= 1.0, (text.get_text(), other.get_text())


def test_same_draws_same_bytes(tmp_path):
    for stem in ("one", "two"):
        few = overlay(*made(knee=knee(), loaded=loaded()))
        save(overlay_figure(type(few)(few.panels[:2], {}, ())), tmp_path, stem)
    for kind in ("pdf", "svg", "png"):
        one, two = ((tmp_path / f"{stem}.{kind}").read_bytes() for stem in ("one", "two"))
        assert one == two


# -- the command


def test_two_runs_and_one_without_draws(written_run, tmp_path, monkeypatch):
    for name in ("first", "second", "third"):
        shutil.copytree(written_run, tmp_path / name)
        summary = json.loads((written_run / "summary.json").read_text(encoding="utf-8"))
        # in truth nothing is determined there
        for parameter in ("motor.inertia", "load.inertia"):
            summary["parameters"][parameter]["verdict"] = "data"
        (tmp_path / name / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    (tmp_path / "third" / "posterior.nc").unlink()
    compare([tmp_path / name for name in ("first", "second", "third")], tmp_path / "out")
    for kind in ("pdf", "svg", "png"):
        assert (tmp_path / "out" / "figures" / f"overlay.{kind}").stat().st_size > 1000
    page = read_page((tmp_path / "out" / "report.html").read_text(encoding="utf-8"))
    (figure,) = page.all("figure", id="figure-overlay")
    (drawing,) = figure.all("svg")
    assert drawing.attrs["aria-label"].startswith("Posteriors of the runs, overlaid. ")
    assert "third, which has no posterior.nc" in figure.text
    saved = []
    monkeypatch.setattr(style, "save", lambda _, __, stem: saved.append(stem))
    compare([tmp_path / name for name in ("first", "third")], tmp_path / "alone")
    assert saved == ["population", "forest"]
    page = read_page((tmp_path / "alone" / "report.html").read_text(encoding="utf-8"))
    assert "third has no posterior.nc" in page.text
