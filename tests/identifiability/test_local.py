"""What the likelihood alone determines, where theory says so."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from bayesfric.estimates.information import directions
from bayesfric.identifiability.local import given_by, local_information, meaning_of, verdict
from bayesfric.inference.priors import Prior
from bayesfric.mechanism.own_term import Term
from tests.identifiability.bench import AXIS, KNEE, problem

# Of which a prior settles a factor that is common to three.
NAMES = ("motor.inertia", "load.first_moment", "drive.gain")
SIZES = np.array([0.14, 0.27, 0.77])
# Relative sd that the data leave of the ratio of any two.
RATIO = 0.01


def information(chain, values, observation):
    return local_information(*problem(observation, chain=chain, values=values))


def test_a_parameter_that_never_shows_is_named(make_observation):
    """No motion into gravity's reach: q stays 0 in a made-up copy."""
    chain = KNEE.chain()
    o = make_observation(chain, KNEE.values, amplitude=2.0)
    level = type(o)(**{**vars(o), "q": np.zeros_like(o.q)})
    result = information(chain, KNEE.values, level)
    assert {"load.first_moment": 1.0} in result.null_directions
    assert meaning_of({"load.first_moment": 1.0}).startswith("load.first_moment does not show")


@pytest.mark.parametrize(
    ("posterior_sd", "prior_sd", "data_sd", "word"),
    [
        (1.0, 100.0, 1.0, "data"),
        (1.0, np.inf, 1.0, "data"),
        (0.95, 1.0, 3.0, "prior"),
        (0.1, 10.0, np.inf, "prior"),  # bounded by something else than data or prior width
        (0.7, 1.0, 1.0, "weak"),
        (0.3, 10.0, 1.0, "weak"),  # the data alone tell it, bounds of others tell more
        (0.3, 1.5, 1.0, "prior"),
        (0.1, 10.0, 1.0, "prior"),  # a hundredth of what is known is the data's
        (0.95, 1.0, 0.96, "prior"),
        (0.1, 0.5, 0.02, "weak"),  # far wider than the local picture says
        (0.1, 0.5, np.nan, "prior"),
        (0.0, 0.0, 0.0, "prior"),
    ],
)
def test_verdicts(posterior_sd, prior_sd, data_sd, word):
    assert verdict(posterior_sd, prior_sd, data_sd) == word


def test_a_term_of_ones_own_keeps_its_name_and_its_own_unit(make_observation):
    """Whatever it is called: only a load loss by the direction of power has an alpha."""
    ripple = Term("motor.load_drive_ripple", lambda m: np.sin(6.0 * m.position), "N m")
    chain = AXIS.chain().with_term(ripple)
    values = {**AXIS.values, ripple.name: 0.0}
    result = information(chain, values, make_observation(chain, values, amplitude=2.0))
    j = result.names.index(ripple.name)
    assert (result.labels[j], result.ways[j], result.shifted[j]) == (ripple.name, 0, True)
    assert result.data_sd[j] > 0.0


# Which given prior determines a number: normal posteriors whose sds are known in closed form


def prior_of(relative, default=False, value=1.0):
    return Prior("", stats.norm(0.0, relative * value), np.nan, -np.inf, np.inf, default=default)


WEIGHED = [(0.3, True), (0.07, False), (0.8, True)]
WEIGHT = ["load.first_moment"]


@pytest.mark.parametrize(
    ("number", "priors", "sd", "prior_sd", "own", "informative"),
    [
        # data and weight leave 7.07 % of the others
        (0, WEIGHED, 0.07, 0.3, True, WEIGHT),
        (2, WEIGHED, 0.07, 0.8, True, WEIGHT),
        (0, WEIGHED, 0.07, 0.3, False, WEIGHT),
        (1, WEIGHED, 0.067, 0.07, True, []),  # the weight itself
        (0, [(0.3, True), (0.07, True), (0.8, True)], 0.07, 0.3, True, []),  # defaults alone
        (0, [(0.3, True), (0.07, False), (0.08, True)], 0.053, 0.3, True, []),  # as good a default
        (0, WEIGHED, 0.2, 0.3, True, []),  # as wide as its own prior
        (0, WEIGHED, 0.02, 0.3, True, []),  # a bound made it narrower still
        (0, [(0.3, True), (np.inf, False), (0.8, True)], 0.07, 0.3, True, []),  # a flat prior
        (0, [(0.3, True), (0.02, False), (0.07, False)], 0.021, 0.3, True, WEIGHT),  # the better
        # each alone leaves 5.1 %, both together 3.6 %: within a half of it, so one is enough
        (0, [(0.3, True), (0.05, False), (0.05, False)], 0.036, 0.3, True, WEIGHT),
    ],
)
def test_priors_that_determine_a_number_are_named(number, priors, sd, prior_sd, own, informative):
    """The data leave a factor common to three open."""
    ratios = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0], [1.0, 0.0, -1.0]]) / RATIO
    local = SimpleNamespace(names=NAMES, units=SIZES, directions=directions(ratios, np.ones(3)))
    given = [prior_of(*prior, value) for prior, value in zip(priors, SIZES, strict=True)]
    sds = SIZES[number] * np.array([sd, prior_sd])
    names = given_by(local, given, np.eye(3)[number], *sds, number if own else None)
    assert names == informative


def test_two_factors_take_two_priors():
    """The sum of a number of each pair is known only where both pairs' factors are."""
    rows = np.array([[1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]]) / RATIO
    names = ("a", "b", "c", "d")
    local = SimpleNamespace(names=names, units=np.ones(4), directions=directions(rows, np.ones(4)))
    given_priors = [prior_of(5.0, True), prior_of(0.05), prior_of(5.0, True), prior_of(0.05)]
    both = given_by(local, given_priors, np.array([1.0, 0.0, 1.0, 0.0]), 0.0721, 5.0)
    assert both == ["b", "d"]
