"""The forest figure: bars are what they say, what is open has none, nothing is cut off."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.text import Annotation

from bayesfric.base.errors import BadInput
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.figures.forest import forest_figure

from .made_summaries import LEG, TOTALS, knee

# 90 % of a normal distribution lie within so many sds
HALF = 1.645


def only(run, *names):
    run = copy.deepcopy(run)
    for group in (run, *run["estimates"].values()):
        for key in ("parameters", "derived", "references"):
            if key in group:
                group[key] = {name: row for name, row in group[key].items() if name in names}
    return run


def panels(figure):
    """Panels by quantity."""
    return {ax.get_gid(): ax for ax in figure.axes}


def drawn(ax, kind):
    """Lines of a kind: their x in the quantity's unit, and their y."""
    return [
        (np.asarray(line.get_xdata(), dtype=float), float(line.get_ydata()[0]))
        for line in ax.lines
        if line.get_gid() == kind
    ]


def test_bars_are_90_percent():
    found = comparison({"a": knee()})
    figure = forest_figure(found)
    ax = panels(figure)["total.inertia"]
    *_, plain, robust = TOTALS["total.inertia"]
    cells = found["total.inertia"].cells
    assert len(drawn(ax, "thick")) == 4  # three methods and the posterior
    assert len(drawn(ax, "thin")) == 3
    for k, label in enumerate(("least-squares", "input-error", "output-error")):
        value = cells[label].value
        for sd, kind in ((robust, "thick"), (plain, "thin")):
            ((low, high),) = [x for x, y in drawn(ax, kind) if y == 3 - k]
            np.testing.assert_allclose([low, high], [value - HALF * sd, value + HALF * sd])
    ((low, high),) = [x for x, y in drawn(ax, "thick") if y == 0]
    np.testing.assert_allclose([low, high], cells["posterior"].interval)
    values = sorted(float(x[0]) for x, _ in drawn(ax, "value"))
    np.testing.assert_allclose(values, sorted(cell.value for cell in cells.values()))


def test_a_posterior_with_room_for_model_discrepancy_is_explained_as_one():
    found = comparison({"a": knee()})
    columns = tuple(replace(c, widened=c.kind == "posterior") for c in found.columns)
    found = replace(found, columns=columns)
    figure = forest_figure(found)
    ((x, y),) = drawn(panels(figure)["total.inertia"], "wide")
    np.testing.assert_allclose(x, found["total.inertia"].cells["posterior"].interval)
    assert y == 0.0
    (legend,) = figure.legends
    assert sum("discrepancy" in text.get_text() for text in legend.get_texts()) == 1


def test_open_numbers_have_no_bars_but_words():
    found = comparison({"a": knee()})
    at = panels(forest_figure(found))
    for name in LEG:
        ax = at[name]
        assert not drawn(ax, "thick")
        assert not drawn(ax, "thin")
        assert not drawn(ax, "value")
        assert len(drawn(ax, "open")) == 2
        words = [t.get_text() for t in ax.texts if isinstance(t, Annotation)]
        assert words.count("not determined") == 3
        # dots for the two methods that know what fits as well, over just that
        assert {y for _, y in drawn(ax, "span")} == {2.0, 1.0}
        for x, _ in drawn(ax, "span"):
            np.testing.assert_allclose(x, LEG[name][-1], atol=1e-12)
        for line in ax.lines:
            if line.get_gid() == "open":
                assert line.get_markerfacecolor() == "white"


def test_the_arrow_of_a_limit_ends_at_its_bound():
    """Another method's bar may go below zero, where no loss is."""
    run = knee()
    row = run["parameters"]["motor.viscous"]
    row |= {"at_bound": "lower", "bound": 0.0, "verdict": "weak", "data_sd": 1e-3, "prior_sd": 4e-3}
    row = run["estimates"]["input-error"]["parameters"]["motor.viscous"]
    row |= {"value": 0.0, "sd": 0.01, "sd_robust": 0.01}
    ax = panels(forest_figure(comparison({"a": run})))["motor.viscous"]
    assert ax.get_xlim()[0] < 0.0
    assert min(float(x.min()) for x, _ in drawn(ax, "limit")) == 0.0


def test_limits_and_bounds():
    run = knee()
    row = run["parameters"]["motor.viscous"]
    row |= {"at_bound": "lower", "verdict": "weak", "data_sd": 1e-3, "prior_sd": 4e-3}
    row = run["estimates"]["input-error"]["parameters"]["motor.viscous"]
    row |= {"value": 0.0, "sd": None, "sd_robust": None, "determined": False, "at_bound": "lower"}
    found = comparison({"a": run})
    ax = panels(forest_figure(found))["motor.viscous"]
    assert len(drawn(ax, "thick")) == 1  # output-error
    words = [t.get_text() for t in ax.texts]
    assert "at its lower bound" in words
    assert any(text.startswith("at most") for text in words)
    assert max(float(x.max()) for x, _ in drawn(ax, "limit")) == pytest.approx(
        found["motor.viscous"].cells["posterior"].limit
    )


def test_nothing_to_draw():
    run = only(knee(), "load.inertia")
    run["estimates"] = {}
    with pytest.raises(BadInput, match="no quantity is determined"):
        forest_figure(comparison({"a": run}))
