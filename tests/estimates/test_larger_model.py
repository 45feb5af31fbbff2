"""When a larger model is the better one: by what it has not seen, and beside what there was."""

import math

import numpy as np
import pytest

from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.methods import EstimationInputs, FittedModel
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
    assert larger.predicts_better(smaller) == worth
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
    assert stated(0.5, **KNOWN, **new).predicts_better(stated(1.0, **KNOWN)) == worth
