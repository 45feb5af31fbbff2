"""Efficiency curves: eq. (4), the package's own definition, and what is open."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.mechanism.derived import derive, efficiencies
from bayesfric.mechanism.presets import PRESETS
from bayesfric.report.figures.efficiency import (
    _bottom,
    _caption,
    efficiency_curves,
    efficiency_figure,
)
from bayesfric.report.summary.summary import summarise

from .conftest import draw_fast

P = PRESETS["rabbit-knee"].values


@pytest.fixture(scope="module")
def curves(knee):
    return efficiency_curves(knee)


def test_both_directions_of_the_gearbox(curves):
    assert list(curves) == [("gearbox", "drive"), ("gearbox", "back")]


def test_medians_are_equation_4_of_the_truth(curves):
    """Draws within a thousandth of Table 3."""
    constant = (P["joint.coulomb_positive"] + P["joint.coulomb_negative"]) / 2
    drive, back = curves.values()
    expected = efficiencies(
        np.array(P["gearbox.load_drive"]), np.array(P["gearbox.load_back"]), constant, drive.load
    )
    np.testing.assert_allclose(drive.median, expected[0], rtol=2e-3)
    defined = expected[1] > 0.02
    np.testing.assert_allclose(back.median[defined], expected[1][defined], rtol=2e-2)
    # eq. (4) ends where no torque comes back
    assert np.isnan(back.median[back.load * (1 - P["gearbox.load_back"]) < 5.0]).all()


def test_the_summarys_efficiency_lies_on_the_curve(knee, curves):
    derived = summarise(knee).as_dict()["derived"]
    for (element, side), curve in curves.items():
        name = f"{element}.efficiency_{side}"
        row = derived[name]
        load = float(row["meaning"].partition(" at ")[2].split()[0])
        k = int(np.argmin(np.abs(curve.load - load)))
        draws = {q.name: q.values for q in derive(knee.chain, knee.chain_draws(500), curve.load[k])}
        ends = np.nanquantile(draws[name], [0.05, 0.5, 0.95])
        found = [curve.low[k], curve.median[k], curve.high[k]]
        np.testing.assert_allclose(found, ends, rtol=1e-12)
        # between two neighbouring loads of the curve lies the one of the summary
        inside = slice(max(k - 1, 0), k + 2)
        assert curve.low[inside].min() <= row["median"] <= curve.high[inside].max()


def test_one_recording_does_not_determine_it(knee, curves):
    """The scale is open, and efficiency is of the load at the joint."""
    for curve in curves.values():
        assert not curve.determined.any()
    figure = efficiency_figure(knee)
    gids = [c.get_gid() for c in figure.axes[0].collections]
    assert "open" in gids
    assert "band" not in gids
    assert "NOT determined by the data" in [t.get_text() for t in figure.legends[0].get_texts()]


def test_the_axis_holds_what_is_drawn_and_the_caption_only_names_that(knee, curves):
    assert efficiency_figure(knee).axes[0].get_ylim() == (0.0, 1.0)
    first = curves["gearbox", "drive"]
    level = np.full(first.load.size, 0.96)
    high = replace(first, median=level, low=level, high=level)
    bottom = _bottom([high])
    assert 0.9 < bottom < 0.96
    said = _caption(curves)
    assert "Hatched where the data do not determine it" in said
    every = np.ones_like(high.covered)
    told = replace(high, covered=every, determined=every)
    assert "Hatched" not in _caption({("gearbox", "drive"): told})
    assert "Dashed" not in _caption({("gearbox", "drive"): told})


def test_no_load_loss_no_figure(slide):
    assert efficiency_curves(slide) == {}
    assert efficiency_figure(slide) is None


def test_an_irreversible_gearbox_has_no_curve_back(knee):
    draws = knee.posterior.draws.copy()
    draws[..., knee.posterior.names.index("gearbox.load_back")] = 0.9999
    fit = replace(knee, posterior=replace(knee.posterior, draws=draws))
    back = efficiency_curves(fit)["gearbox", "back"]
    assert np.isnan(back.median).all()
    draw_fast(efficiency_figure(fit))
