"""Which of input and output error to believe where they differ."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.commands.estimate import _mark, _told
from bayesfric.estimates.agreement import agreement
from bayesfric.estimates.point_estimate import Estimate, EstimatedValue
from bayesfric.mechanism.presets import PRESETS
from bayesfric.report.text_templates import sentence

AXIS = PRESETS["motor-axis"]
CHAIN = AXIS.chain()


def estimate(method, factor=1.0, sd=0.01, robust=0.01, **bounds):
    """Values of the axis, the inertia so many times as large; sds are shares."""
    point = {name: AXIS.values[name] for name in CHAIN.names}
    point["motor.inertia"] *= factor
    values = [
        EstimatedValue(
            name, "", "", "", x, sd * abs(x) or sd, robust * abs(x) or robust,
            at_bound=bounds.get(name.split(".")[-1]),
        )
        for name, x in point.items()
    ]  # fmt: skip
    return Estimate(method, tuple(values), 0.01, 100, "", point=tuple(point.items()))


def told(observations, *found):
    seen = agreement(found, CHAIN, observations)
    return seen, sentence("methods apart", _told(seen))


@pytest.fixture
def recorded(make_observation):
    return [make_observation(CHAIN, AXIS.values, sigma=0.01)]


def test_what_agrees_is_said_to(recorded):
    seen, words = told(recorded, estimate("input-error"), estimate("output-error", 1.02))
    assert seen.agree
    assert words == "Input and output error agree within three of their sds, the larger ones"
    wide = estimate("output-error", 1.02, robust=0.05)
    _, words = told(recorded, estimate("input-error"), wide)
    assert words.endswith("believe input error, whose sds are 5 times as small")


def test_another_minimum_is_not_believed(recorded):
    """The torque of twice the inertia, beside noise of 0.01 N m."""
    # wide sds hide no such minimum (measured, UR10e: 18 times the torque, "agree")
    wide = estimate("output-error", 2.0, robust=0.6)
    seen, words = told(recorded, estimate("input-error"), wide)
    assert not seen.apart
    assert not seen.agree
    assert "Believe input error and least squares" in words
    assert "agree" not in words
    seen, words = told(recorded, estimate("input-error"), estimate("output-error", 2.0))
    assert seen.apart == ("motor.inertia",)
    assert seen.believed == "input-error"
    o, inertia = recorded[0], AXIS.values["motor.inertia"]
    left = o.filter.apply(inertia * o.qdd)
    assert seen.torque[1] == pytest.approx(np.hypot(0.01, np.sqrt(np.mean(left**2))), rel=0.05)
    assert "Believe input error and least squares" in words
    assert "motor.inertia" in words


def test_without_a_word_of_the_torque_neither_is(recorded):
    near = estimate("output-error", 1.0001, sd=1e-6, robust=1e-6)
    torque = estimate("input-error", sd=1e-6, robust=1e-6)
    seen, words = told(recorded, torque, near)
    assert (seen.apart, seen.believed) == (("motor.inertia",), None)
    assert "neither is to be believed more" in words
    settings = {"acceleration_ratio": 3.0}
    noisy = [replace(recorded[0], settings=settings)]
    seen, words = told(noisy, torque, near)
    assert seen.believed == "output-error"
    assert "only 3 times its noise" in words


def test_a_bound_far_from_the_other_is_a_difference(recorded):
    bounded = estimate("output-error", coulomb="lower")
    seen, _ = told(recorded, estimate("input-error"), bounded)
    assert seen.on_bound == ()  # at the other's value
    off = [replace(v, value=0.0) if v.at_bound else v for v in bounded.values]
    seen, _ = told(recorded, estimate("input-error"), replace(bounded, values=tuple(off)))
    assert seen.on_bound == ("motor.coulomb",)


def test_what_is_no_estimate_is_not_compared(recorded):
    lost = replace(estimate("output-error", 2.0), converged=False)
    assert agreement([estimate("input-error"), lost], CHAIN, recorded) is None
    assert agreement([estimate("input-error")], CHAIN, recorded) is None


def test_sds_that_mean_nothing_are_marked():
    (fine, *_), (small, *_) = (estimate("output-error", robust=r).values for r in (0.015, 0.05))
    assert _mark(fine, doubted=False) == ""
    assert "sd too small" in _mark(small, doubted=False)
    assert "another minimum" in _mark(fine, doubted=True)
    assert _mark(replace(fine, at_bound="lower"), doubted=True) == ""
