"""How a run tells that its model is not right: summary, terminal, tables, page, paragraph."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.inference.discrepancy import Discrepancy
from bayesfric.report.figures.registry import RUN_FIGURES
from bayesfric.report.result_row import result_rows
from bayesfric.report.summary.derived_quantities import groups
from bayesfric.report.summary.doubts import add_model_error
from tests.inference.test_discrepancy import fitted

NAME = "motor.viscous"


@pytest.fixture(scope="module")
def wrong():
    return fitted(cubic=0.005)


def test_widened_draws_that_a_run_holds_are_not_made_again(wrong):
    """In the coordinates of another session they came out twice as wide."""
    wide = wrong.fit.wide.posterior.flat()
    held = wide[::7]
    again = replace(wrong.fit, widened_draws=held)
    np.testing.assert_array_equal(again.wide.posterior.flat(), held)


def test_what_room_lets_reach_zero_is_a_limit(wrong):
    """The narrow posterior is clear of the bound; the widened one leans on it."""
    assert wrong.summary.parameters[NAME].at_bound is None
    held = wrong.fit.wide.posterior.flat()[::7].copy()
    j = wrong.fit.posterior.names.index(NAME)
    held[:, j] = np.abs(np.random.default_rng(3).normal(size=len(held))) * held[:, j].mean()
    row = add_model_error(
        wrong.summary, replace(wrong.fit, widened_draws=held), groups(wrong.fit)
    ).parameters[NAME]
    assert (row.at_bound, row.bound, row.bound_physical) == ("lower", 0.0, True)
    assert result_rows(wrong.summary)[NAME].limit is None
    widened = wrong.summary.with_rows({NAME: dict(row)})
    assert result_rows(widened)[NAME].limit == row.model_error_interval[1]


def test_figures_show_what_the_tables_print(wrong):
    """Densities of the widened draws, their dotted ends the tables' intervals."""
    figure = RUN_FIGURES["corner"].draw(wrong.fit, wrong.summary)
    row = wrong.summary.parameters[NAME]
    interval = result_rows(wrong.summary)[NAME].interval
    sds = []
    for ax in figure.axes:
        fills = [p for p in ax.patches if p.get_gid() == "posterior"]
        ends = [x.get_xdata()[0] for x in ax.lines if x.get_linewidth() == 0.7]
        if fills and len(ends) == 2 and np.allclose(sorted(ends), interval, rtol=1e-9):
            values, edges, _ = fills[0].get_data()
            middles = 0.5 * (edges[1:] + edges[:-1])
            mean = np.average(middles, weights=values)
            sds.append(np.sqrt(np.average((middles - mean) ** 2, weights=values)))
    assert sds, "no panel has the interval of the tables"
    # of 40 bins, and a thousandth of the draws beyond either end
    assert sds[0] == pytest.approx(row.model_error_sd, rel=0.05)
    assert row.model_error_sd > 1.2 * row.sd


def test_every_view_goes_by_the_wide_one(wrong):
    row = wrong.summary.parameters[NAME]
    assert row.reported.interval == row.model_error_interval
    cell = result_rows(wrong.summary)[NAME]
    assert (cell.interval, cell.sd) == (tuple(row.model_error_interval), row.model_error_sd)
    frame = wrong.summary.frame.set_index("name").loc[NAME]
    assert [frame["low"], frame["high"]] == row.model_error_interval
    # figures of friction draw from it
    drawn = wrong.fit.wide.posterior.draws[..., wrong.fit.posterior.names.index(NAME)]
    assert np.quantile(drawn, [0.05, 0.95]) == pytest.approx(row.model_error_interval)
    # derived quantities widen too, and noise keeps its interval
    totals = [row for name, row in wrong.summary.derived.items() if name.startswith("total")]
    assert all(row.model_error_interval for row in totals)
    assert wrong.summary.parameters["noise.sigma"].model_error_interval is None


def test_what_is_as_wide_as_its_prior_is_no_longer_data(wrong):
    """The verdict is judged on the interval that is shown."""
    fit = replace(wrong.fit)
    names = fit.target.names
    at = names.index("motor.coulomb")
    plain = wrong.summary.with_rows({"motor.coulomb": {"verdict": "data"}})
    prior = plain.parameters["motor.coulomb"].prior_sd
    k = len(fit.target.free)
    moves = np.zeros((4000, k))
    moves[:, at] = 3.0 * prior * np.random.default_rng(7).standard_normal(4000)
    room = Discrepancy(1.0, moves, np.zeros(k), np.eye(k))
    fit = replace(fit, discrepancy=room)
    widened = add_model_error(plain, fit, groups(fit))
    assert widened.parameters["motor.coulomb"].verdict == "weak"
    assert widened.parameters["motor.inertia"].verdict == plain.parameters["motor.inertia"].verdict
