"""The forest figure: bars are what they say, what is open has none, nothing is cut off."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.figures.forest import forest_figure

from .made_summaries import LEG, TOTALS, knee

# 90 % of a normal distribution lie within so many sds
HALF = 1.645


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
    compared = comparison({"a": knee()})
    figure = forest_figure(compared)
    ax = panels(figure)["total.inertia"]
    *_, plain, robust = TOTALS["total.inertia"]
    cells = compared["total.inertia"].cells
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
    compared = comparison({"a": knee()})
    columns = tuple(replace(c, widened=c.kind == "posterior") for c in compared.columns)
    ax = panels(forest_figure(replace(compared, columns=columns)))["total.inertia"]
    ((x, y),) = drawn(ax, "wide")
    np.testing.assert_allclose(x, compared["total.inertia"].cells["posterior"].interval)
    assert y == 0.0


def test_open_numbers_have_no_bars_but_words():
    at = panels(forest_figure(comparison({"a": knee()})))
    for name, (*_, span) in LEG.items():
        ax = at[name]
        assert not [*drawn(ax, "thick"), *drawn(ax, "thin"), *drawn(ax, "value")]
        hollow = [line for line in ax.lines if line.get_gid() == "open"]
        assert [line.get_markerfacecolor() for line in hollow] == ["white", "white"]
        assert [text.get_text() for text in ax.texts].count("not determined") == 3
        # dots for the two methods that know what fits as well, over just that
        assert {y for _, y in drawn(ax, "span")} == {2.0, 1.0}
        for x, _ in drawn(ax, "span"):
            np.testing.assert_allclose(x, span, atol=1e-12)


def test_limits_and_bounds():
    run = knee()
    row = run["parameters"]["motor.viscous"]
    row |= {"at_bound": "lower", "bound": 0.0, "verdict": "weak", "data_sd": 1e-3, "prior_sd": 4e-3}
    row = run["estimates"]["input-error"]["parameters"]["motor.viscous"]
    row |= {"value": 0.0, "sd": None, "sd_robust": None, "determined": False, "at_bound": "lower"}
    compared = comparison({"a": run})
    ax = panels(forest_figure(compared))["motor.viscous"]
    assert len(drawn(ax, "thick")) == 1  # output-error
    words = [text.get_text() for text in ax.texts]
    assert "at its lower bound" in words
    assert any(text.startswith("at most") for text in words)
    # the arrow begins at the limit and ends at its bound
    ((ends, _),) = drawn(ax, "limit")
    limit = compared["motor.viscous"].cells["posterior"].limit
    np.testing.assert_allclose(sorted(ends), [0.0, limit])


def test_nothing_to_draw():
    run = knee() | {"derived": {}, "estimates": {}}
    run["parameters"] = {"load.inertia": run["parameters"]["load.inertia"]}
    with pytest.raises(BadInput, match="no quantity is determined"):
        forest_figure(comparison({"a": run}))
