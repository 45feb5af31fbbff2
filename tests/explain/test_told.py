"""A term whose value the recordings do not tell, or that no joint has, is not asked for."""

from dataclasses import replace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.estimates.estimation import Estimation
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.methods import Given
from bayesfric.estimates.point_estimate import Estimate, EstimatedValue
from bayesfric.explain.candidates import candidates
from bayesfric.explain.evidence import Score
from bayesfric.explain.explanation import explain
from bayesfric.explain.ladder import searched
from bayesfric.explain.told import untold
from tests.axis import AXIS, VALUES

FOLDS = 8
BEFORE = Score(1.0, 1.0, 0.1, np.zeros(FOLDS))
# better by 8 ± 2, by 8 ± 5 where two folds say all of it, and worse by 1 where one does
CLEAR = Score(0.9, 0.9, 0.1, np.ones(FOLDS) + 0.7 * (-1.0) ** np.arange(FOLDS))
VAGUE = Score(0.9, 0.9, 0.1, np.eye(FOLDS)[:2].sum(axis=0) * FOLDS / 2.0)
WORSE = Score(0.9, 0.9, 0.1, -np.eye(FOLDS)[0])


@pytest.fixture
def swing(make_observation):
    """3 s of a known motion."""
    return make_observation(AXIS, VALUES, n=1500)


def judged(o, option, choice, numbers, after=VAGUE):
    """Judge a term by its numbers, pairs of value and sd, beside those of the axis."""
    one = next(
        c
        for c in candidates(AXIS, [o], VALUES)
        if (c.owner, c.option, c.choice) == ("motor", option, choice)
    )
    known = {n: (VALUES[n], 0.01 * abs(VALUES[n])) for n in one.chain.names if n in VALUES}
    told = known | {f"motor.{n}": pair for n, pair in numbers.items()}
    values = tuple(
        EstimatedValue(n, "", "", "", *pair, kind="parameter") for n, pair in told.items()
    )
    point = tuple((n, told[n][0]) for n in one.chain.names)
    estimate = Estimate("input-error", values, 0.1, 100, "", point=point)
    return untold(one, one.chain, estimate, [o], after, BEFORE)


def warming(viscous, seconds, sd=None, sure=0.3):
    wide = sure * abs(viscous) if sd is None else sd
    return {"viscous_warming": (viscous, wide), "warming_time": (seconds, 0.3 * seconds)}


@pytest.mark.parametrize(
    ("numbers", "why"),
    [
        (warming(-0.03, 1.0), None),
        # of 3 s: shorter than any that was tried
        (warming(-0.03, 0.1), "shape"),
        # a hundred times as long as the recording
        (warming(-3.0, 300.0), "shape"),
        ({"viscous_warming": (-0.03, 0.01), "warming_time": (1.0, np.inf)}, "shape"),
        # of 0.1 N m s and 0.3 N m nothing would be left at the speeds there are
        (warming(-1.5, 1.0), "negative"),
        (warming(-0.03, 1.0, sd=0.02), "zero"),
        ({"viscous_warming": (-0.03, np.inf), "warming_time": (1.0, 0.1)}, "zero"),
    ],
)
def test_a_change_is_one_that_this_recording_could_tell(swing, numbers, why):
    assert judged(swing, "warming", "viscous", numbers) == why


def test_a_change_that_was_over_before_the_first_output_is_not_asked_for(swing):
    """Of a warming within 1 s a recording cut from 8 s on sees 3e-4: the rest is extrapolated."""
    late = replace(swing, stamps=swing.stamps + 8.0)
    assert judged(swing, "warming", "viscous", warming(-0.03, 1.0)) is None
    assert judged(late, "warming", "viscous", warming(-0.03, 1.0), CLEAR) == "shape"


def test_each_term_gains_by_itself(swing):
    sure = {"quadratic": (0.05, 0.001)}
    assert judged(swing, "quadratic", True, sure, VAGUE) is None
    assert judged(swing, "quadratic", True, sure, WORSE) == "worse"


def test_zero_is_asked_for_only_where_left_out_motion_is_clearly_better(swing):
    zero = {"quadratic": (0.01, 0.02)}
    assert judged(swing, "quadratic", True, zero) == "zero"
    assert judged(swing, "quadratic", True, zero, CLEAR) is None
    assert judged(swing, "quadratic", True, {"quadratic": (0.05, 0.02)}) is None


def test_nothing_is_asked_for_that_predicts_worse(swing):
    worse = Score(0.9, 1.1, 0.1, VAGUE.folds)
    assert judged(swing, "quadratic", True, {"quadratic": (0.05, 0.001)}, worse) == "worse"
    worse = Score(0.9, 0.9, 0.1, -VAGUE.folds)
    assert judged(swing, "quadratic", True, {"quadratic": (0.05, 0.001)}, worse) == "worse"


def test_two_values_in_the_place_of_one_are_something_where_they_differ(swing):
    def by_direction(positive, negative):
        both = {"viscous_positive": (positive, 0.01), "viscous_negative": (negative, 0.01)}
        return judged(swing, "viscous", "by-direction", both)

    assert by_direction(0.30, 0.31) == "zero"
    assert by_direction(0.10, 0.15) is None


@pytest.mark.parametrize("seed", range(3))
def test_outputs_that_the_terms_together_could_take_tell_no_noise(make_observation, seed):
    """Of a noise of next to nothing any term would be sure, by 1e26 and more."""
    sigma = 0.05
    options = {"n": 3000, "factor": 40, "amplitude": 6.0}
    o = make_observation(AXIS, VALUES, sigma=sigma, seed=seed, **options)
    # more than are too few for the model itself
    assert o.measured.size >= 2 * len(AXIS.names) + 50
    columns = searched(AXIS, [o], VALUES).columns
    # the sum of white noise over a window has its variance; of n numbers it is known to 2/n
    expected = sigma**2 * float(np.sum(o.filter.taps**2))
    assert columns.variance == pytest.approx(expected, rel=4.0 * np.sqrt(2.0 / o.measured.size))
    assert explain(Given(AXIS, [o], Knowledge({}, {}, {}), Estimation(), tuple), VALUES).asked == ()


def test_a_term_is_told_with_its_value_and_the_line_to_write(make_observation):
    """A spring, not one that stiffens by nothing."""
    true = bf.Joint(AXIS.elements, load=bf.Load(first_moment=True, spring=True), offset=True)
    o = make_observation(
        true, VALUES | {"load.spring": 0.5}, sigma=0.02, n=4000, factor=5, amplitude=1.5
    )
    found = explain(Given(AXIS, [o], Knowledge({}, {}, {}), Estimation(), tuple), VALUES)
    (term,) = found.asked
    assert (term.table, term.line) == ("mechanism.load", "spring = true")
    assert (term.parameters, term.sure) == (("load.spring",), True)
    number = found.last.numbers["load.spring"]
    assert abs(number.value - 0.5) < 4.0 * number.sd
