"""Which told prior settles a number: normal posteriors whose sds are known in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from bayesfric.estimates.information import directions
from bayesfric.identifiability.local import given_by
from bayesfric.inference.prior.priors import Prior

NAMES = ("motor.inertia", "load.first_moment", "drive.gain")
VALUES = np.array([0.14, 0.27, 0.77])
# Relative sd that the data leave of the ratio of any two.
RATIO = 0.01


def told(relative, default=False, value=1.0):
    distribution = stats.norm(0.0, relative * value)
    return Prior("", distribution, np.nan, -np.inf, np.inf, default=default)


def named(j, priors, sd, prior_sd, own=True):
    """Of a number whose data say all but a factor common to three."""
    ratios = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0], [1.0, 0.0, -1.0]]) / RATIO
    local = SimpleNamespace(names=NAMES, units=VALUES, directions=directions(ratios, np.ones(3)))
    relative = dict(zip(NAMES, priors, strict=True))
    given = [told(relative[n][0], relative[n][1], v) for n, v in zip(NAMES, VALUES, strict=True)]
    gradient = np.eye(3)[j]
    at = VALUES[j]
    return given_by(local, given, gradient, sd * at, prior_sd * at, j if own else None)


WEIGHED = [(0.3, True), (0.07, False), (0.8, True)]


def test_a_told_weight_settles_what_shares_its_factor():
    # data and weight leave 7.07 % of the others
    assert named(0, WEIGHED, 0.07, 0.3) == ["load.first_moment"]
    assert named(2, WEIGHED, 0.07, 0.8) == ["load.first_moment"]
    assert named(0, WEIGHED, 0.07, 0.3, own=False) == ["load.first_moment"]


def test_what_was_told_is_not_given_by_itself():
    assert named(1, WEIGHED, 0.067, 0.07) == []


@pytest.mark.parametrize(
    ("priors", "sd"),
    [
        ([(0.3, True), (0.07, True), (0.8, True)], 0.07),  # nobody told it
        ([(0.3, True), (0.07, False), (0.08, True)], 0.053),  # a default says nearly as much
        ([(0.3, True), (0.07, False), (0.8, True)], 0.2),  # as wide as its own prior
        ([(0.3, True), (0.07, False), (0.8, True)], 0.02),  # a bound made it narrower still
        ([(0.3, True), (np.inf, False), (0.8, True)], 0.07),  # told, but says nothing
    ],
)
def test_nothing_told_settles_it(priors, sd):
    assert named(0, priors, sd, 0.3) == []


def test_of_several_one_that_is_enough_is_named():
    better = [(0.3, True), (0.02, False), (0.07, False)]
    assert named(0, better, 0.021, 0.3) == ["load.first_moment"]
    alike = [(0.3, True), (0.05, False), (0.05, False)]
    # each alone leaves 5.1 %, both together 3.6 %: within a half of it, so one is enough to say
    assert named(0, alike, 0.036, 0.3) == ["load.first_moment"]


def test_two_factors_take_two_priors():
    """The sum of a number of each pair is known only where both pairs' factors are."""
    rows = np.array([[1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]]) / RATIO
    names = ("a", "b", "c", "d")
    local = SimpleNamespace(names=names, units=np.ones(4), directions=directions(rows, np.ones(4)))
    given = [told(5.0, True), told(0.05), told(5.0, True), told(0.05)]
    both = given_by(local, given, np.array([1.0, 0.0, 1.0, 0.0]), 0.0721, 5.0)
    assert both == ["b", "d"]
