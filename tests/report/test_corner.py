"""Corner plot: priors where they belong, what is open is marked, contours hold their mass."""

import numpy as np
import pytest
from matplotlib.path import Path

from bayesfric.report.figures import posterior
from bayesfric.report.figures.posterior import corner_figure
from bayesfric.report.summary.record import Summary
from bayesfric.report.summary.summary import summarise

from .conftest import by_gid
from .made_summaries import failed


def panels(figure, n=8):
    """Axes by row and column, of which there are none above the diagonal."""
    axes = np.full((n, n), None)
    axes[np.tril_indices(n)] = figure.axes
    return axes


def determined(fit, **changes):
    """Summarise it with nothing open: the corner shows parameters in their order."""
    summary = summarise(fit).as_dict()
    for name, row in summary["parameters"].items():
        row |= {"verdict": "data"} | changes.get(name, {})
        row.pop("reported", None)  # it follows from the rest
    return Summary.read(summary)


def test_prior_is_drawn_in_the_posteriors_density_unit(knee):
    summary = determined(knee)
    at = panels(corner_figure(knee, summary))
    for i, (_, _, prior) in enumerate(posterior.choice(knee, summary)[:8]):
        x, y = by_gid(at[i, i], "prior").get_data()
        some = slice(5, None, 40)
        expected = np.exp(prior.log_density(x[some]))
        np.testing.assert_allclose(y[some], expected, rtol=1e-12)
        assert (expected > 0).any()
        heights, edges, _ = by_gid(at[i, i], "posterior").get_data()
        assert np.sum(heights * np.diff(edges)) == pytest.approx(1.0)


def test_what_is_open_has_neither_density_nor_interval(knee):
    summary = summarise(knee).as_dict()
    for row in [*summary["parameters"].values()][1:]:
        row |= {"verdict": "prior", "at_bound": None}
        row.pop("reported", None)
    summary = Summary.read(summary)
    at = panels(corner_figure(knee, summary))
    status = [row.status for row, *_ in posterior.choice(knee, summary)[:8]]
    assert {*status} >= {"unidentified", "identified"}
    for k, of in enumerate(status):
        gids = [artist.get_gid() for artist in at[k, k].get_children()]
        assert ("posterior" in gids, "open" in gids) == (of != "unidentified", of == "unidentified")
        assert gids.count("interval") == {"unidentified": 0, "limit": 1}.get(of, 2)
        for j in range(k):
            filled = [c for c in at[k, j].collections if getattr(c, "filled", False)]
            assert any(c.get_visible() for c in filled) == ("unidentified" not in (of, status[j]))
    # nor has anything of ensembles that disagree
    at = panels(corner_figure(knee, Summary.read(failed(summarise(knee).as_dict()))))
    assert not [a for ax in at.diagonal() for a in ax.get_children() if a.get_gid() == "posterior"]


def test_a_limit_has_one_end(knee):
    limit = {"verdict": "prior", "at_bound": "lower", "data_sd": 1e-9, "prior_sd": 1.0}
    summary = determined(knee, **{"motor.viscous": limit})
    k = [*summary.parameters].index("motor.viscous")
    end = by_gid(panels(corner_figure(knee, summary))[k, k], "interval")
    assert end.get_xdata()[0] == pytest.approx(summary.rows["motor.viscous"].interval[1])


def test_contours_hold_the_stated_mass(make_fit):
    fit = make_fit(spread=1e-2)
    summary = determined(fit)
    axes = panels(corner_figure(fit, summary))[1, 0]
    first, second = (draws for _, draws, _ in posterior.choice(fit, summary)[:2])
    points = np.stack([first, second], axis=1)
    lines = [a for a in axes.collections if not getattr(a, "filled", True)]
    shares = []
    for path in lines[-1].get_paths():
        inside = np.zeros(len(points), dtype=int)
        for polygon in path.to_polygons(closed_only=False):
            inside += Path(polygon).contains_points(points)
        shares.append(np.mean(inside % 2))
    # 1920 draws in 40 by 40 bins, smoothed by 1.2 bins: the densest cells are favoured
    np.testing.assert_allclose(sorted(shares), [0.5, 0.9], atol=0.05)
