"""Friction at recorded speeds: rows of the summary, and lines of the tables."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import Joint
from bayesfric.report.numbers import HTML, TEXT
from bayesfric.report.summary.parts import QUANTILES, friction_cells, friction_part
from bayesfric.report.summary.summary import summarise

from .conftest import build


@pytest.fixture(scope="module")
def plain():
    """Coulomb and viscous friction alone, known only together: c + 2 b is, to a thousandth."""
    joint = Joint((Element("motor", inertia=True, coulomb="symmetric", viscous=True),), Load())
    fit = build(joint)
    draws = fit.posterior.draws.copy()
    b, c = (fit.posterior.names.index(f"motor.{name}") for name in ("viscous", "coulomb"))
    rng = np.random.default_rng(3)
    draws[..., b] = 0.3 + 0.03 * rng.standard_normal(draws.shape[:3])
    draws[..., c] = 0.9 - 2.0 * draws[..., b] + 1e-3 * rng.standard_normal(draws.shape[:3])
    return replace(fit, posterior=replace(fit.posterior, draws=draws))


def test_rows_are_quantiles_of_the_friction_of_draws_at_recorded_speeds(plain):
    part = friction_part(plain, summarise(plain))
    assert (part["unit"], part["speed_unit"]) == ("N m", "rad/s")
    assert part["parameters"] == ["motor.viscous", "motor.coulomb"]
    speed = np.concatenate([o.speed for o in plain.observations])
    at = np.quantile(np.abs(speed), QUANTILES)
    np.testing.assert_allclose([r["speed"] for r in part["rows"]], [*at, *-at])
    draws = plain.chain_draws(1000)
    b, c = (draws[:, plain.chain.names.index(f"motor.{n}")] for n in ("viscous", "coulomb"))
    for row in part["rows"]:
        expected = np.quantile(c + b * abs(row["speed"]), [0.5, 0.05, 0.95])
        np.testing.assert_allclose([row["value"], *row["interval"]], expected, rtol=1e-9)
        assert (row["load"], row["status"]) == (0.0, "identified")
        # narrower than what the coefficients' own intervals add up to
        widths = [np.subtract(*np.quantile(x, [0.95, 0.05])) for x in (c, b * abs(row["speed"]))]
        assert np.subtract(*row["interval"][::-1]) < 0.9 * sum(widths)


def test_printed_is_a_line_a_speed_where_both_directions_are_alike(plain, knee):
    for medium in (TEXT, HTML):
        cells = list(friction_cells(friction_part(plain, summarise(plain)), medium))
        assert len(cells) == 3
        assert {(row[0][0], row[1], row[4]) for row in cells} == {("±", "", "identified")}
    # by direction and at three loads each speed is a line
    rows = friction_part(knee, summarise(knee))["rows"]
    assert {np.sign(row["load"]) for row in rows} == {-1.0, 0.0, 1.0}
    assert {np.sign(row["speed"]) for row in rows} == {-1.0, 1.0}


def test_what_is_doubted_or_not_sampled_is_not_told_as_identified(plain):
    summary = summarise(plain)
    doubted = summary.with_rows({"motor.viscous": {"doubted": ["missing"]}})
    assert {row["status"] for row in friction_part(plain, doubted)["rows"]} == {"doubtful"}
    lost = summary.sampler.model_copy(update={"status": "unusable"})
    part = friction_part(plain, summary.model_copy(update={"sampler": lost}))
    assert {row[2:] for row in friction_cells(part, TEXT)} == {("", "", "unidentified")}
    frictionless = build(Joint((Element("motor", inertia=True),), Load(first_moment=True)))
    assert friction_part(frictionless, summarise(frictionless)) is None
