"""The forest figure: bars are what they say, what is open has none."""

import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.figures.forest import forest_figure

from .made_summaries import LEG, knee

# 90 % of a normal distribution lie within so many sds
HALF = 1.645


@pytest.fixture(scope="module")
def knee_figure():
    """Draw the knee's quantities by every method."""
    return forest_figure(comparison({"a": knee()}))


def drawn(figure, name, kind):
    """Lines of a kind in a quantity's panel, by column: their x."""
    (ax,) = [ax for ax in figure.axes if ax.get_gid() == name]
    labels = ["least-squares", "input-error", "output-error", "posterior"]
    return {
        labels[int(line.get_ydata()[0])]: np.sort(np.asarray(line.get_xdata(), dtype=float))
        for line in ax.lines
        if line.get_gid() == kind
    }


def test_bars_are_90_percent():
    run = knee()
    run["estimates"]["least-squares"]["parameters"]["total.inertia"]["sd_robust"] = None
    compared = comparison({"a": run})
    cells, figure = compared["total.inertia"].cells, forest_figure(compared)
    bars = drawn(figure, "total.inertia", "bar")
    plain = drawn(figure, "total.inertia", "plain")
    assert (set(bars), set(plain)) == (set(cells) - {"least-squares"}, {"least-squares"})
    for label, ends in (bars | plain).items():
        cell = cells[label]
        expected = cell.interval or (cell.value - HALF * cell.sd, cell.value + HALF * cell.sd)
        np.testing.assert_allclose(ends, expected)
    values = drawn(figure, "total.inertia", "value")
    assert {label: x[0] for label, x in values.items()} == {k: c.value for k, c in cells.items()}


@pytest.mark.parametrize("name", LEG)
def test_open_numbers_have_no_bars(knee_figure, name):
    *_, span = LEG[name]
    assert not any(drawn(knee_figure, name, kind) for kind in ("bar", "plain", "value"))
    # dots for the two methods that know what fits as well, over just that
    spans = drawn(knee_figure, name, "span")
    assert set(spans) == {"input-error", "output-error"}
    for x in spans.values():
        np.testing.assert_allclose(x, span, atol=1e-12)


def test_a_limit_is_an_arrow_to_its_bound():
    run = knee()
    row = run["parameters"]["motor.viscous"]
    row |= {"at_bound": "lower", "bound": 0.0, "verdict": "weak", "data_sd": 1e-3, "prior_sd": 4e-3}
    figure = forest_figure(comparison({"a": run}))
    arrow = drawn(figure, "motor.viscous", "limit")["posterior"]
    np.testing.assert_allclose(arrow, [0.0, row["interval"][1]])
    assert "posterior" not in drawn(figure, "motor.viscous", "bar")


def test_nothing_to_draw():
    run = knee() | {"derived": {}, "estimates": {}}
    run["parameters"] = {"load.inertia": run["parameters"]["load.inertia"]}
    with pytest.raises(BadInput, match="no quantity is determined"):
        forest_figure(comparison({"a": run}))
