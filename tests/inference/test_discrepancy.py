"""Sizes of missing effects, and what they do to a posterior: closed forms and integrals."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import chi2, kstest, norm, truncnorm

import bayesfric as bf
from bayesfric.inference.discrepancy import (
    Discrepancy,
    LinearisedFit,
    Missing,
    chance_missing,
    discrepancy,
    draw_sizes,
)
from bayesfric.inference.fitting import make_target, read_priors
from bayesfric.mechanism.joint import PRESETS
from tests.axis import AXIS, VALUES, swing

QUICK = {"min_ess": 400, "ensembles": 2, "walkers": 24}
UNCHECKED = {"self_check": {"recordings": 0}, "sampling": QUICK}
LINES = [(0.31, 0.9), (0.73, 0.5), (1.9, 0.15)]


def regression(size, n=400, m=1, seed=0):
    """A residual of unit noise with ``size`` of the first of ``m`` orthogonal unit-rms columns."""
    rng = np.random.default_rng(seed)
    columns = np.linalg.qr(rng.standard_normal((n, m)))[0] * np.sqrt(n)
    left = size * columns[:, 0] + rng.standard_normal(n)
    return Missing(
        observations=(),
        columns=columns,
        kinds={f"kind {k}": ((k,),) for k in range(m)},
        gram=columns.T @ columns,
        scores=columns.T @ left,
        column_errors=np.zeros(m),
        power=float(left @ left),
        spread=np.ones(m),
        free=n,
        biases_friction=np.zeros(m, dtype=bool),
    )


def test_sizes_are_those_of_the_integral():
    """One column: its mean size, by a sum over both scales at the variance that is left."""
    missing = regression(0.2, n=2000)
    drawn = draw_sizes(missing, np.random.default_rng(1))[:, 0]
    n, b = missing.gram[0, 0], missing.scores[0]
    variance = (missing.power - b**2 / n) / missing.free
    grid = np.geomspace(3e-5, 0.5, 24)
    ratio = grid[:, None] / grid
    prior = np.log(ratio) - np.log1p(ratio**2)
    prior -= logsumexp(prior, axis=0)
    x = grid / 0.003
    joint = prior + np.log(x / (1.0 + x**2))
    total = variance + grid**2 * n
    log_evidence = 0.5 * (b * grid) ** 2 / (variance * total) - 0.5 * np.log(total / variance)
    weights = np.exp(joint + log_evidence[:, None] - logsumexp(joint + log_evidence[:, None]))
    sizes = grid**2 * b / total
    mean = float(weights.sum(axis=1) @ sizes)
    sd = np.sqrt(variance / n)
    # of nearly independent draws; the variance is drawn, too, by 1 in sqrt(2 n)
    assert drawn.mean() == pytest.approx(mean, abs=4.0 * sd / np.sqrt(len(drawn) / 4.0))
    assert drawn.std() == pytest.approx(sd, rel=0.25)


@pytest.mark.parametrize("seed", range(5))
def test_a_large_effect_is_certain_and_none_is_less_likely_than_before(seed):
    assert chance_missing(regression(1.0, m=8, seed=seed)) > 0.999
    none = [chance_missing(regression(0.0, m=8, seed=10 * seed + k)) for k in range(40)]
    # Markov: of data without an effect, evidence for one of 20 comes once in 20 times at most
    assert np.mean(np.array(none) > 0.69) <= 0.15
    assert np.median(none) < 0.1


def test_columns_cancel_no_better_than_their_shapes_are_known():
    """Two columns leave 1 % of themselves, the same but for its sign, and a tenth of one is left.

    Were their shapes exact they would explain it by sizes of five. With ``S`` the error of shapes,
    0.04 here as is the Gram matrix' diagonal, sizes are ``(G + S)^-1 b``, 3.33.
    """
    rng = np.random.default_rng(0)
    inside, outside = np.linalg.qr(rng.standard_normal((400, 2)))[0].T * np.sqrt(400)
    columns = np.stack([inside + 0.01 * outside, inside - 0.01 * outside], axis=1)
    rest = np.stack([0.01 * outside, -0.01 * outside], axis=1)
    left = 0.1 * outside + 1e-3 * rng.standard_normal(400)
    exact = replace(
        regression(0.0, n=400, m=2),
        columns=columns,
        gram=rest.T @ rest,
        scores=rest.T @ left,
        power=float(left @ left),
        free=398,
    )

    def sizes(missing):
        return draw_sizes(missing, np.random.default_rng(1))

    # less by what the scale of 0.5 takes off, under a twentieth
    np.testing.assert_allclose(np.abs(sizes(exact).mean(axis=0)), 5.0, rtol=0.05)
    rough = replace(exact, column_errors=np.mean(columns**2, axis=0))
    expected = np.linalg.solve(exact.gram + 0.04 * np.eye(2), exact.scores)
    np.testing.assert_allclose(sizes(rough).mean(axis=0), expected, rtol=0.08)


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
def test_a_right_model_is_widened_by_its_residual_s_scatter_only(right):
    """Of ten directions of weights: a variance in a thousand is 2.96 times the posterior's."""
    assert not right.fit.discrepancy.is_plausible
    max_count = np.sqrt(chi2.ppf(0.999, 10) / 10.0)
    for row in right.summary.joint.values():
        assert row.value == row.middle
        assert 0.95 * row.sd < row.reported.sd < max_count * row.sd


def test_intervals_of_a_wrong_model_hold_the_truth(wrong):
    """Viscous friction takes part in a cubic; inertia and Coulomb friction have a truth."""
    assert wrong.fit.discrepancy.chance > 0.99
    for name in ("motor.inertia", "motor.coulomb", "load.first_moment"):
        row = wrong.summary.parameters[name]
        assert row.reported.sd > row.sd
        assert abs(row.reported.value - VALUES[name]) < 3.0 * row.reported.sd


def test_without_candidates_nothing_moves(right):
    assert chance_missing(replace(regression(1.0), kinds={})) == 0.0
    none = discrepancy(right.fit.target, right.fit.posterior, None)
    assert not none.is_plausible
    draws = right.fit.posterior.flat(50)
    rng = np.random.default_rng(0)
    np.testing.assert_array_equal(none.widened(right.fit.target, draws, rng), draws)


def moving(right, name, mean, sd, n=4000):
    """Draws of one number, moved by normal steps and a mean to either side, and those before."""
    target, draws = right.fit.target, right.fit.posterior.flat(n)
    i, k = target.names.index(name), len(target.free)
    steps, rng = np.zeros((n, k)), np.random.default_rng(3)
    steps[:, i] = sd * rng.standard_normal(n)
    errors = Discrepancy(1.0, steps, mean * (np.arange(k) == i), np.cov(draws[:, :k].T))
    return errors.widened(target, draws, np.random.default_rng(4)), draws, i


def test_draws_scatter_by_steps_and_mean_where_no_bound_is_near(right):
    moved, draws, i = moving(right, "offset", mean=0.2, sd=0.1)
    steps = (moved - draws)[:, i]
    assert kstest(steps, norm(0.0, np.hypot(0.2, 0.1)).cdf).pvalue > 1e-3
    np.testing.assert_allclose(np.delete(moved, i, 1), np.delete(draws, i, 1), rtol=1e-9)


@pytest.mark.parametrize("sd", [0.1, 0.6])
def test_a_bound_cuts_what_was_moved(right, sd):
    """A normal step that leads much of viscous friction below zero."""
    moved, draws, i = moving(right, "motor.viscous", mean=0.0, sd=sd)
    mean, sd = draws[:, i].mean(), np.hypot(draws[:, i].std(), sd)
    cut = truncnorm(-mean / sd, np.inf, mean, sd)
    # the steps are a sample of 4000, and draws of 4000 among them
    assert kstest(moved[:, i], cut.cdf).statistic < 0.05


def test_a_column_moves_constants_in_full_and_friction_by_what_motions_differ_in(wrong):
    """By weighted least squares anew, in the coordinates of a joint whose bounds are far."""
    fit = wrong.fit
    target, posterior, observations = fit.target, fit.posterior, fit.observations
    linear = LinearisedFit(target, posterior, observations)
    # unit weights give the posterior's own estimator: its rows times it are the identity
    identity = np.linalg.solve(linear.root, linear.estimator()) @ linear.rows
    # the covariance is of some 400 effective draws
    np.testing.assert_allclose(identity, np.eye(len(identity)), atol=3.0 / np.sqrt(400.0))
    (o,) = target.likelihood.outputs
    column = observations[0].qd[observations[0].filter.centres][:, None] ** 3
    missing = replace(regression(0.3, n=o.measured.size), columns=column, observations=observations)
    sizes = np.full((80, 1), 0.01)
    rng = np.random.default_rng
    moves = linear.moves(target.friction, missing, sizes, rng(0))
    biased = replace(missing, biases_friction=np.ones(1, dtype=bool))
    in_full = linear.moves(target.friction, biased, sizes, rng(0))
    np.testing.assert_array_equal(in_full, np.tile(in_full[0], (80, 1)))
    constant = ~target.friction
    np.testing.assert_array_equal(moves[:, constant], in_full[:, constant])
    # a cube's best line goes with the speeds that are weighed, about that of equal weights
    law = (in_full - moves)[:, target.friction]
    assert (np.abs(law.mean(axis=0) - in_full[0, target.friction]) < law.std(axis=0)).all()
    assert (law.std(axis=0) < np.abs(in_full[0, target.friction])).all()


def test_a_column_orthogonal_to_the_model_moves_nothing(right):
    """A column that is orthogonal to what the parameters do moves nothing."""
    fit = right.fit
    (o,) = fit.target.likelihood.outputs
    rng = np.random.default_rng(5)
    noise = rng.standard_normal((o.measured.size, 1))
    noise *= np.sqrt(np.mean(o.measured**2) / np.mean(noise**2))
    missing = regression(0.3, n=o.measured.size)
    errors = discrepancy(
        fit.target, fit.posterior, replace(missing, columns=noise, observations=fit.observations)
    )
    assert errors.chance > 0.99
    # by chance each direction of unit noise is moved by size times the rms over the noise
    max_count = 0.3 * np.sqrt(np.mean(o.measured**2)) / fit.posterior["noise.sigma"].mean()
    linear = fit.target.unbounded(fit.posterior.flat(500))
    steps = np.abs(errors.mean) / linear[:, : len(fit.target.free)].std(axis=0)
    assert steps.max() < 4.0 * max_count * np.sqrt(steps.size)


def test_coordinates_of_a_gearbox_are_friction_or_constants(make_observation):
    """Coordinates stand in another order than parameters: moving one changes its own kind only."""
    preset = PRESETS["servo-pendulum"]
    chain = preset.chain()
    o = make_observation(chain, preset.values, n=500)
    target = make_target(chain, [o], read_priors(chain, {}, [o]), "shared")
    at = np.array([[*preset.values.values(), 0.01]])
    k = len(target.free)
    v = target.unbounded(at)
    constants = {"inertia", "first_moment", "gravity_angle", "offset"}
    is_friction = [name.split(".")[-1] not in constants for name in target.free]
    load = target.free.index("gearbox.load")
    for i, friction in enumerate(target.friction):
        moved = target.from_unbounded(v + 1e-6 * v.std() * (np.arange(v.shape[1]) == i))
        changed = np.flatnonzero(~np.isclose(moved, at, rtol=1e-10, atol=0.0)[0, :k])
        assert load in changed or [is_friction[j] for j in changed] == [friction] * changed.size
