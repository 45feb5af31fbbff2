"""How far runs are apart: of skewed numbers, of limits, and of what a run doubts itself."""

import math

import pytest

from bayesfric.report.comparison.comparison import comparison

from .made_summaries import DERIVED, knee, loaded, posterior_row


def test_runs_that_are_far_apart_are_named():
    """Their table held -7.2 sd, and the first sentence said that nothing was pooled."""
    other = loaded()
    assert not comparison({"a": knee(), "b": other}).runs_apart
    name = next(iter(DERIVED))
    row = other["derived"][name]
    by = 10.0 * row["sd"]
    row |= {"median": row["median"] + by, "interval": [end + by for end in row["interval"]]}
    found = comparison({"a": knee(), "b": other})
    (said,) = found.runs_apart
    far = found[name].cells["b: posterior"].disagreement
    assert far == pytest.approx((10.0 + 0.7) / math.sqrt(2), rel=1e-6)
    assert f"{name} ({far:+.1f} sd)" in said
    assert found.notes[0] == said
    # what a run doubts itself says nothing of the joint
    row["doubted"] = ["delay"]
    assert not comparison({"a": knee(), "b": other}).runs_apart


def _coulomb(median, interval, sd, **more):
    run = knee()
    run["parameters"]["motor.coulomb"] = posterior_row("N m", median, sd, **more) | {
        "interval": interval
    }
    return run


def test_of_what_is_skewed_the_side_that_faces_the_other_counts():
    """One long tail, away from the other run, made an sd that hid that nothing overlaps."""
    a = _coulomb(0.147, [0.078, 0.468], 0.13)
    b = _coulomb(0.02, [0.02 - 0.0165, 0.02 + 0.0165], 0.01)
    found = comparison({"a": a, "b": b})
    facing = math.hypot((0.147 - 0.078) / 1.645, 0.01)
    cell = found["motor.coulomb"].cells["b: posterior"]
    assert cell.disagreement == pytest.approx((0.02 - 0.147) / facing, rel=1e-6)
    # from the other side it is the long one
    high = _coulomb(0.9, [0.9 - 0.0165, 0.9 + 0.0165], 0.01)
    cell = comparison({"a": a, "b": high})["motor.coulomb"].cells["b: posterior"]
    far = math.hypot((0.468 - 0.147) / 1.645, 0.01)
    assert cell.disagreement == pytest.approx((0.9 - 0.147) / far, rel=1e-6)


def test_a_limit_may_be_far_from_what_another_run_finds():
    at_zero = {"at_bound": "lower", "bound": 0.0}
    limited = _coulomb(0.004, [0.0003, 0.0115], 0.0035, **at_zero)
    apart = comparison({"a": limited, "b": _coulomb(0.147, [0.08, 0.214], 0.04)})
    assert apart["motor.coulomb"].cells["a: posterior"].status == "limit"
    cell = apart["motor.coulomb"].cells["b: posterior"]
    facing = math.hypot((0.0115 - 0.004) / 1.645, 0.04)
    assert cell.disagreement == pytest.approx((0.147 - 0.004) / facing, rel=1e-6)
    assert "disagree in motor.coulomb (+3.6 sd)" in apart.runs_apart[0]
    # of either order, and with a value from elsewhere; of the same run's estimates they are no news
    other = comparison({"a": _coulomb(0.147, [0.08, 0.214], 0.04), "b": limited})
    assert other["motor.coulomb"].cells["b: posterior"].disagreement == pytest.approx(
        -cell.disagreement
    )
    alone = knee()
    assert comparison({"a": alone})["motor.viscous"].cells["input-error"].disagreement is not None
    alone["parameters"]["motor.viscous"] |= at_zero
    assert comparison({"a": alone})["motor.viscous"].cells["input-error"].disagreement is None
    near = comparison({"a": limited, "b": _coulomb(0.006, [0.0027, 0.0093], 0.002)})
    assert not near.runs_apart
