"""When a larger model is the better one: by what it has not seen, and beside what there was."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.methods import EstimationInputs, FittedModel, predicts_better
from bayesfric.estimates.point_estimate import Estimate, EstimatedValue, Estimation, Knowledge
from bayesfric.estimates.torque import filtered_torque
from bayesfric.mechanism.element import Element
from bayesfric.mechanism.joint import Joint

PLAIN = {"inertia": True, "coulomb": "symmetric", "viscous": True}
SMALL, LARGE = (Joint([Element("motor", **PLAIN, quadratic=more)]) for more in (False, True))
TRUE = {"motor.inertia": 0.05, "motor.viscous": 0.1, "motor.coulomb": 0.3, "motor.quadratic": 0.02}


def candidate(joint, observation):
    options = Estimation(starts=1)
    inputs = EstimationInputs(joint, [observation], Knowledge(), options, lambda: [])
    return FittedModel(inputs, input_error(joint, [observation], Knowledge(), options))


@pytest.fixture
def recorded(make_observation):
    """A recording with a quadratic loss in some of its quarters."""

    def make(quarters, sigma):
        values = TRUE | {"motor.quadratic": 0.0}
        o = make_observation(LARGE, values, sigma=sigma, n=2000, factor=2, amplitude=2.0)
        both = filtered_torque(LARGE, o, np.array([LARGE.vector(values), LARGE.vector(TRUE)]))
        for part in quarters:
            rows = np.array_split(np.arange(o.measured.size), 4)[part]
            o.measured[rows] += (both[1] - both[0])[rows]
        return o

    return make


def test_each_quarter_is_foretold_by_the_others(recorded):
    """Of a linear model that no bound holds, by ordinary least squares of the rest."""
    o = recorded((), 0.05)
    eye = np.eye(len(SMALL.names))
    columns, y = filtered_torque(SMALL, o, eye).T, o.measured
    squares = 0.0
    for part in np.array_split(np.arange(y.size), 4):
        rest = np.setdiff1d(np.arange(y.size), part)
        solution = np.linalg.lstsq(columns[rest], y[rest], rcond=None)[0]
        squares += np.sum((y[part] - columns[part] @ solution) ** 2)
    assert candidate(SMALL, o).left_out_rms == pytest.approx(math.sqrt(squares / y.size), rel=1e-6)


@pytest.mark.parametrize(
    ("quarters", "worth"),
    [((0, 1, 2, 3), True), ((3,), False)],  # a law of the joint; something that happened once
)
def test_a_term_has_to_help_with_what_it_has_not_seen(recorded, quarters, worth):
    o = recorded(quarters, 0.02)
    larger, smaller = candidate(LARGE, o), candidate(SMALL, o)
    assert predicts_better(larger, smaller) == worth
    # by the residuals of all it would be worth it, see the Bayesian information criterion
    gain = smaller.estimate.residual_rms / larger.estimate.residual_rms
    assert 2.0 * o.measured.size * math.log(gain) > math.log(o.measured.size)


def stated(rms, **pairs):
    """Make a candidate of values and sds by quantity of the motor, and what it leaves."""
    values = tuple(
        EstimatedValue(f"motor.{name}", "", "", "", value, sd, kind="parameter")
        for name, (value, sd) in pairs.items()
    )
    model = FittedModel(None, Estimate("input-error", values, rms, 400, ""))
    model.__dict__["left_out_rms"] = rms
    return model


KNOWN = {"inertia": (0.1, 0.01), "coulomb": (0.3, 0.01), "offset": (0.05, 0.01)}


@pytest.mark.parametrize(
    ("new", "worth"),
    [
        ({"quadratic": (0.02, 0.02)}, False),  # its size is not known
        ({"stribeck_change": (0.5, 0.1), "stribeck_velocity": (0.1, 0.1)}, False),  # nor its shape
        ({"stribeck_change": (0.5, 0.1), "stribeck_velocity": (0.1, 0.01)}, True),
        ({"cogging_sin_4": (0.0, 0.1), "cogging_cos_4": (1.0, 0.1)}, True),  # of two, one may be 0
    ],
)
def test_a_term_has_to_be_known(new, worth):
    assert predicts_better(stated(0.5, **KNOWN, **new), stated(1.0, **KNOWN)) == worth


# 3 s at 100 Hz, of which 0.1 s are cut off either end: delays up to 0.3 s are searched
SHORT = SimpleNamespace(
    settings={"sampling_rate": 100.0, "trim_samples": 10}, stamps=np.arange(301) / 100.0
)


@pytest.mark.parametrize(
    ("before", "after", "worth"),
    [
        (None, (0.02, 0.004), True),
        (None, (0.02, 0.02), False),  # it may be none
        (None, (-3.3, 1.2), False),  # beyond what is searched
        ((0.02, 0.004), (0.02, 0.02), False),  # the larger model loses it
        ((0.02, 0.02), (0.02, 0.02), True),  # nobody knew it before
    ],
)
def test_a_delay_is_determined_and_stays_so(before, after, worth):
    known = {"quadratic": (0.02, 0.001), "delay": after}
    smaller = stated(1.0, **KNOWN, **({} if before is None else {"delay": before}))
    larger = replace(stated(0.5, **KNOWN, **known), inputs=SimpleNamespace(observations=[SHORT]))
    larger.__dict__["left_out_rms"] = 0.5
    smaller = replace(smaller, inputs=larger.inputs)
    smaller.__dict__["left_out_rms"] = 1.0
    assert predicts_better(larger, smaller) == worth
