"""When a larger model is the better one: by its residuals, known, and beside what there was."""

import math

import pytest

from bayesfric.estimates.larger_model import better
from bayesfric.estimates.point_estimate import Estimate, EstimatedValue

N = 400


def estimate(rms, **values):
    """Make one of values and sds by quantity of the motor."""
    found = tuple(
        EstimatedValue(f"motor.{name}", "", "", "", value, sd, kind="parameter")
        for name, (value, sd) in values.items()
    )
    point = tuple((v.name, v.value) for v in found)
    return Estimate("input-error", found, rms, N, "", point=point)


SMALL = {"inertia": (0.1, 0.01), "coulomb": (0.3, 0.01), "offset": (0.05, 0.01)}


# a parameter more costs the log of the outputs, which is what residuals must fall by
@pytest.mark.parametrize(("share", "worth"), [(0.99, False), (1.01, True)])
def test_a_term_is_worth_what_the_information_criterion_says(share, worth):
    rms = math.exp(-share * math.log(N) / (2.0 * N))
    larger = estimate(rms, **SMALL, quadratic=(0.02, 0.002))
    assert better(larger, estimate(1.0, **SMALL)) == worth


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
    assert better(estimate(0.5, **SMALL, **new), estimate(1.0, **SMALL)) == worth


@pytest.mark.parametrize(
    ("quantity", "worth"), [("coulomb", False), ("inertia", False), ("offset", True)]
)
def test_a_term_leaves_known_what_cannot_be_negative(quantity, worth):
    """An offset may come to be nothing; a loss that does was replaced."""
    changed = SMALL | {quantity: (0.001, 0.01)}
    larger = estimate(0.5, **changed, power=(0.3, 0.01))
    assert better(larger, estimate(1.0, **SMALL)) == worth
