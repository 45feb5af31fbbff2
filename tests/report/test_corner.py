"""Corner plot: priors where they belong, awkward parameters survived."""

import numpy as np
import pytest

from bayesfric.report.figures import corner
from bayesfric.report.figures.corner import corner_figure
from bayesfric.report.paper.tables import parameter_table
from bayesfric.report.summary.record import Summary
from bayesfric.report.summary.summary import summarise

from .conftest import by_gid
from .made_summaries import failed


def panels(figure):
    """Axes by (row, column)."""
    found = {}
    for ax in figure.axes:
        place = ax.get_subplotspec()
        found[place.rowspan.start, place.colspan.start] = ax
    return found


def quantities(fit):
    return corner.quantities(fit, summarise(fit))


def determined(fit):
    """Its summary where nothing is open: the corner shows parameters in their order."""
    summary = summarise(fit).as_dict()
    for row in summary["parameters"].values():
        row["verdict"] = "data"
    return summary


def test_prior_is_drawn_in_the_posteriors_density_unit(knee):
    shown = quantities(knee)[:8]
    figure = corner_figure(knee, Summary.read(determined(knee)))
    for i, q in enumerate(shown):
        ax = panels(figure)[i, i]
        # nothing is open: parameters as sampled
        assert panels(figure)[7, i].get_xlabel().split("\n")[0] == q.symbol
        x, y = by_gid(ax, "prior").get_data()
        some = slice(5, None, 40)
        expected = np.exp(q.prior.log_density(x[some]))
        np.testing.assert_allclose(y[some], expected, rtol=1e-12)
        assert (expected > 0).any()
        heights, edges, _ = by_gid(ax, "posterior").get_data()
        # all but the two thousandths outside the margins, at most
        assert 0.997 < np.sum(heights * np.diff(edges)) <= 1.0 + 1e-12


def test_what_is_open_has_neither_density_nor_interval(knee):
    summary = summarise(knee).as_dict()
    for row in [*summary["parameters"].values()][1:]:
        row |= {"verdict": "prior", "at_bound": None}
    figure = corner_figure(knee, Summary.read(summary))
    table = {row.name: row for row in parameter_table(summary).rows}
    every = (*corner.combinations(knee, summarise(knee)), *quantities(knee))
    status = {q.symbol: table[q.name].status for q in every}
    seen = set()
    for k in range(8):
        one = status[panels(figure)[7, k].get_xlabel().split("\n")[0]]
        found = [a.get_gid() for a in panels(figure)[k, k].get_children()]
        assert ("posterior" in found) == (one != "undetermined")
        ends = {"undetermined": 0, "limit": 1}.get(one, 2)
        assert found.count("interval") == ends
        seen.add(one)
    assert seen >= {"undetermined", "determined"}


def test_a_limit_has_one_end(knee):
    summary = determined(knee)
    row = summary["parameters"]["motor.viscous"]
    row |= {"verdict": "prior", "at_bound": "lower", "data_sd": 1e-9, "prior_sd": 1.0}
    figure = corner_figure(knee, Summary.read(summary))
    k = [q.name for q in quantities(knee)].index("motor.viscous")
    (end,) = [line for line in panels(figure)[k, k].lines if line.get_gid() == "interval"]
    assert end.get_xdata()[0] == pytest.approx(row["interval"][1])


def test_ensembles_that_disagree_determine_nothing(knee):
    figure = corner_figure(knee, Summary.read(failed(summarise(knee).as_dict())))
    for k in range(8):
        assert "posterior" not in {a.get_gid() for a in panels(figure)[k, k].get_children()}


def test_contours_hold_the_stated_mass(make_fit):
    from matplotlib.path import Path

    fit = make_fit(spread=1e-2)
    figure = corner_figure(fit, Summary.read(determined(fit)))
    first, second = (q.draws for q in quantities(fit)[:2])
    points = np.stack([first, second], axis=1)
    lines = [a for a in panels(figure)[1, 0].collections if not getattr(a, "filled", True)]
    shares = []
    for path in lines[-1].get_paths():
        inside = np.zeros(len(points), dtype=int)
        for polygon in path.to_polygons(closed_only=False):
            inside += Path(polygon).contains_points(points)
        shares.append(np.mean(inside % 2))
    # 1920 draws in 40 by 40 bins, smoothed by 1.2 bins: the densest cells are favoured
    np.testing.assert_allclose(sorted(shares), [0.5, 0.9], atol=0.05)
