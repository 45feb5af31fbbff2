"""What candidates that may be missing do to a posterior: closed forms, one term more."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import kstest, norm, truncnorm

import bayesfric as bf
from bayesfric.inference.discrepancy import (
    Discrepancy,
    _held,
    _without_bounds,
    cut_normal,
    discrepancy,
)
from bayesfric.inference.fitting import make_target, read_priors
from bayesfric.mechanism.presets import PRESETS
from tests.axis import AXIS, VALUES, swing
from tests.inference.test_missing import regression

QUICK = {"min_ess": 400, "ensembles": 2, "walkers": 24}
UNCHECKED = {"self_check": {"recordings": 0}, "sampling": QUICK}
LINES = [(0.31, 0.9), (0.73, 0.5), (1.9, 0.15)]


def recording(**extra):
    """Simulate, by the inverse model, a swing of the joint, with terms that ``AXIS`` lacks."""
    time = np.arange(0.0, 30.0, 0.005)
    q, qd, qdd = swing(time, LINES)
    torque = AXIS.torque(VALUES, q, qd, qdd) + extra.get("cubic", 0.0) * qd**3
    noise = 0.02 * np.random.default_rng(extra.get("seed", 0)).standard_normal(time.size)
    return bf.Recording.from_arrays(time, q, torque + noise)


@cache
def fitted(**extra):
    return bf.Model(AXIS, recording(**extra), **UNCHECKED).fit(seed=1)


@pytest.fixture(scope="module")
def right():
    return fitted()


@pytest.fixture(scope="module")
def wrong():
    return fitted(cubic=0.005)


@pytest.mark.slow
def test_a_right_model_keeps_its_intervals(right):
    assert not right.fit.discrepancy.shown
    for row in right.summary.joint.values():
        assert [row.told.low, row.told.high] == row.interval


def test_a_wrong_model_gets_room_that_holds_the_truth(wrong):
    """Viscous friction takes part in a cubic; inertia and Coulomb friction have a truth."""
    assert wrong.fit.discrepancy.chance > 0.99
    for name in ("motor.inertia", "motor.coulomb", "load.first_moment"):
        row = wrong.summary.parameters[name]
        assert row.told.sd > row.sd
        assert abs(row.reported.value - VALUES[name]) < 3.0 * row.told.sd


def test_where_nobody_could_ask_nothing_is_missing(right):
    none = discrepancy(right.fit.target, right.fit.posterior, None)
    assert not none.shown
    draws = right.fit.posterior.flat(50)
    rng = np.random.default_rng(0)
    np.testing.assert_array_equal(none.widened(right.fit.target, draws, rng), draws)


def moving(right, name, by, sd, n=4000):
    """Draws of one number, moved by normal steps of a room of their own, and those before."""
    target, draws = right.fit.target, right.fit.posterior.flat(n)
    i, k = target.names.index(name), len(target.free)
    moves, rng = np.zeros((n, k)), np.random.default_rng(3)
    moves[:, i] = by + sd * rng.standard_normal(n)
    room = Discrepancy(1.0, moves, np.zeros(k), np.cov(draws[:, :k].T))
    return room.widened(target, draws, np.random.default_rng(4)), draws, i


def test_draws_are_moved_by_the_steps_where_no_bound_is_near(right):
    moved, draws, i = moving(right, "offset", by=0.2, sd=0.0)
    draws[:, i] += 0.2
    np.testing.assert_allclose(moved, draws, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("by", [-0.15, -0.6])
def test_a_bound_cuts_what_was_moved(right, by):
    """A normal step that leaves much, or hardly any, of viscous friction above zero."""
    moved, draws, i = moving(right, "motor.viscous", by=by, sd=0.1)
    mean, sd = draws[:, i].mean() + by, np.hypot(draws[:, i].std(), 0.1)
    cut = truncnorm(-mean / sd, np.inf, mean, sd)
    # the steps are a sample of 4000, and draws of 4000 among them
    assert kstest(moved[:, i], cut.cdf).statistic < 0.05


@pytest.mark.parametrize("beyond", [0.5, 3.0, 12.0])
def test_a_normal_is_cut_by_gibbs_sampling(beyond):
    """One number far beyond its bound; the other follows it as regression says, as they are two."""
    covariance = np.array([[1.0, 0.6], [0.6, 1.0]])
    mean, n = np.array([-beyond, 0.0]), 4000
    limits = np.array([0.0, -np.inf]), np.full(2, np.inf)
    drawn = cut_normal(mean, covariance, limits, np.ones((n, 2)), np.random.default_rng(5))
    assert kstest(drawn[:, 0], truncnorm(beyond, np.inf, -beyond, 1.0).cdf).pvalue > 1e-3
    rest = drawn[:, 1] - 0.6 * (drawn[:, 0] + beyond)
    assert kstest(rest, norm(0.0, 0.8).cdf).pvalue > 1e-3


def test_between_two_bounds_and_below_one():
    limits = np.array([2.0, -np.inf]), np.array([3.0, -4.0])
    start = np.tile([2.5, -5.0], (2000, 1))
    drawn = cut_normal(np.zeros(2), np.eye(2), limits, start, np.random.default_rng(6))
    assert kstest(drawn[:, 0], truncnorm(2.0, 3.0).cdf).pvalue > 1e-3
    assert kstest(drawn[:, 1], truncnorm(-np.inf, -4.0).cdf).pvalue > 1e-3


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("beyond", [2.5, 15.0])
def test_without_its_bound_a_cut_normal_is_whole(beyond, seed):
    """What regression says, from draws that a bound has cut, however far the estimate lies."""
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((400, 3)) @ np.array([[1.0, 0.5, 0.0], [0.0, 1.0, 0.3], [0, 0, 1]])
    covariance = np.linalg.inv(rows.T @ rows)
    estimate = np.array([-beyond * np.sqrt(covariance[0, 0]), 0.4, -0.2])
    y = rows @ estimate
    # exact draws of the first, then of the others given it
    sd = np.sqrt(covariance[0, 0])
    first = truncnorm(beyond, np.inf, estimate[0], sd).rvs(40_000, random_state=rng)
    rest = covariance[1:, 1:] - np.outer(covariance[1:, 0], covariance[0, 1:]) / sd**2
    others = estimate[1:] + np.outer(first - estimate[0], covariance[0, 1:] / sd**2)
    others += rng.multivariate_normal(np.zeros(2), rest, size=first.size)
    draws = np.column_stack([first, others])
    mean = draws.mean(axis=0)
    pull = np.array([0.0 - mean[0], 0.0, 0.0])
    whole, shift = _without_bounds(np.cov(draws.T), rows, y - rows @ mean, pull, np.zeros(3))
    sds = np.sqrt(np.diag(covariance))
    # variances of what is not held are known to sqrt(2 / 40,000), and with them how much it
    # follows: at 15 sds that is a tenth of one
    np.testing.assert_allclose(mean + shift, estimate, atol=0.15 * sds.max())
    np.testing.assert_allclose(
        whole / np.outer(sds, sds), covariance / np.outer(sds, sds), atol=0.05
    )


def test_what_no_candidate_moves_stays(right):
    """A column that is orthogonal to what the parameters do moves nothing."""
    fit = right.fit
    (o,) = fit.target.likelihood.outputs
    rng = np.random.default_rng(5)
    noise = rng.standard_normal((o.measured.size, 1))
    noise *= np.sqrt(np.mean(o.measured**2) / np.mean(noise**2))
    one = regression(0.3, n=o.measured.size)
    room = discrepancy(
        fit.target, fit.posterior, replace(one, columns=noise, observations=fit.observations)
    )
    assert room.chance > 0.99
    # by chance each direction of unit noise is moved by size times the rms over the noise
    most = 0.3 * np.sqrt(np.mean(o.measured**2)) / fit.posterior["noise.sigma"].mean()
    straight = fit.target.unbounded(fit.posterior.flat(500))
    steps = np.abs(room.moves.mean(axis=0)) / straight[:, : len(fit.target.free)].std(axis=0)
    assert steps.max() < 4.0 * most * np.sqrt(steps.size)


def test_what_a_bound_holds_is_found_among_a_gearbox_s_coordinates(make_observation):
    """Coordinates stand in another order than parameters, and only some are one of these each."""
    preset = PRESETS["servo-pendulum"]
    chain = preset.chain()
    o = make_observation(chain, preset.values, n=500)
    target = make_target(chain, [o], read_priors(chain, {}, [o]), "shared")
    rng = np.random.default_rng(8)
    draws = np.array([*preset.values.values(), 0.01]) * (
        1.0 + 1e-3 * rng.standard_normal((4000, 1))
    )
    leans = target.names.index("motor.coulomb")
    draws[:, leans] = rng.exponential(0.01, 4000)
    v = target.unbounded(draws)
    pull, known = _held(target, v)
    (at,) = np.flatnonzero(pull)
    np.testing.assert_allclose(v[:, at], draws[:, leans])
    assert pull[at] == pytest.approx(-draws[:, leans].mean())
    assert known[at] == pytest.approx(target.priors[leans].sd() ** -2.0)
    assert not np.allclose(v[:, leans], draws[:, leans])  # where parameters have it is another
