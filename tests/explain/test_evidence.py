"""Evidence and held-out scores against the sums they stand for, written out."""

from dataclasses import fields

import numpy as np
import pytest
from scipy import stats

from bayesfric.explain.evidence import Columns, gain, prepared, score
from bayesfric.explain.ladder import compared, stacked
from tests.axis import AXIS, VALUES

N = 60
SIGMA = 0.3
TORQUE = 2.0


@pytest.fixture
def columns():
    """Two columns of a model, two candidates of one and two columns, and a target."""
    rng = np.random.default_rng(1)
    x = rng.standard_normal((N, 5))
    x /= np.sqrt(np.mean(x**2, axis=0))
    y = x[:, :2] @ [0.5, -1.0] + 0.15 * x[:, 2] + SIGMA * rng.standard_normal(N)
    rows = np.column_stack([x, y])
    folds = np.arange(N) * 4 // N
    # one piece of time: its scatter says nothing of the noise
    pieces = np.zeros(N, dtype=np.int64)
    names = ("a", "b", "c", "d")
    return Columns(rows, rows, TORQUE, SIGMA**2, np.zeros(0), folds, names, pieces, 2)


def log_marginal(columns, own):
    """Of the target: wide priors of what the model has, a tenth of the torque for the others."""
    x, y = columns.white[:, :-1], columns.white[:, -1]
    wide, narrow = 1e3 * np.ones(2), 0.1 * TORQUE * np.ones(len(own))
    design = x[:, [0, 1, *own]]
    covariance = design @ np.diag(np.concatenate([wide, narrow]) ** 2) @ design.T
    return stats.multivariate_normal(cov=covariance + SIGMA**2 * np.eye(N)).logpdf(y)


@pytest.mark.parametrize("own", [[2], [3], [3, 4]])
def test_evidence_is_the_bayes_factor(columns, own):
    expected = log_marginal(columns, own) - log_marginal(columns, [])
    assert gain(columns, [0, 1], own, 0).evidence == pytest.approx(expected, abs=2e-3)


def test_a_sign_halves_the_prior_and_keeps_one_side(columns):
    both = gain(columns, [0, 1], [2], 0).evidence
    up, down = (gain(columns, [0, 1], [2], sign).evidence for sign in (1, -1))
    # the two halves make up the whole
    assert np.logaddexp(up, down) - np.log(2.0) == pytest.approx(both, abs=1e-2)
    assert up > both > down


def test_what_the_model_can_do_adds_nothing(columns):
    again = Columns(**{**vars_of(columns), "white": doubled(columns), "raw": doubled(columns)})
    assert gain(again, [0, 1], [2], 0).dimensions == 0


def vars_of(columns):
    left = {"white", "raw"}
    return {f.name: getattr(columns, f.name) for f in fields(columns) if f.name not in left}


def doubled(columns):
    rows = columns.white.copy()
    rows[:, 2] = rows[:, :2] @ [0.3, 0.4]
    return rows


def test_noise_that_differs_between_pieces_of_time_counts(columns):
    """A candidate that is large in one piece only, where the target is off."""
    rows = columns.white.copy()
    rows[:, 2] = np.where(np.arange(N) < 3, np.sqrt(N / 3), 0.0)
    rows[:3, -1] += 2.0 * np.array([1.0, -1.0, 1.0])
    made = {**vars_of(columns), "white": rows, "raw": rows}
    calm = gain(Columns(**made), [0, 1], [2], 0).evidence
    pieces = np.arange(N)
    told = gain(Columns(**{**made, "pieces": pieces}), [0, 1], [2], 0).evidence
    assert told < calm


def test_held_out_folds_are_predicted_by_the_others(columns):
    found = score(columns, [0, 1, 2])
    x, y = columns.white[:, :3], columns.white[:, -1]
    whole = np.linalg.lstsq(x, y, rcond=None)[0]
    # of the model as it is, which has the first two
    plain = np.linalg.lstsq(x[:, :2], y, rcond=None)[0]
    assert found.rms == pytest.approx(np.sqrt(np.mean((y - x @ whole) ** 2)))
    power = 0.0
    for fold in range(4):
        inside = columns.folds == fold
        near = np.convolve(inside, np.ones(13), mode="same") > 0.5
        rest = x[~near].T @ x[~near]
        # what only the fold tells stays where the model as it is has it, a hundredth as strongly
        anchored = rest + 0.01 * x.T @ x
        held = 0.01 * x.T @ x[:, :2] @ plain
        there = np.linalg.solve(anchored, x[~near].T @ y[~near] + held)
        left = y[inside] - x[inside] @ there
        assert found.folds[fold] == pytest.approx(-0.5 * left @ left / SIGMA**2)
        power += left @ left
    assert found.held_out == pytest.approx(np.sqrt(power / N))


def test_a_term_that_one_fold_alone_tells_predicts_nothing(columns):
    """It fits that fold; from the others it cannot be known, and is no better there."""
    rows = columns.white.copy()
    inside = columns.folds == 0
    rows[:, 2] = np.where(inside, rows[:, 2], 0.0)
    rows[inside, -1] += 2.0 * rows[inside, 2]
    made = Columns(**{**vars_of(columns), "white": rows, "raw": rows})
    with_it, without = score(made, [0, 1, 2]), score(made, [0, 1])
    fitted = 0.5 * N * (without.rms**2 - with_it.rms**2) / SIGMA**2
    assert fitted > 50.0
    assert abs(compared(with_it, without)[0]) < 0.05 * fitted


def test_weights_prefer_what_predicts_and_share_where_two_are_as_good():
    class One:
        def __init__(self, folds):
            self.folds = np.array(folds)

    good, bad = One([0.0, 0.0, 0.0]), One([-9.0, -9.0, -9.0])
    assert stacked([good, bad])[0] > 0.99
    one, other = One([0.0, -4.0]), One([-4.0, 0.0])
    np.testing.assert_allclose(stacked([one, other]), 0.5, atol=1e-3)


def test_the_noise_of_all_models_is_what_every_candidate_leaves(make_observation):
    o = make_observation(AXIS, VALUES, sigma=0.05, n=6000, factor=1)
    rng = np.random.default_rng(3)
    base, others = rng.standard_normal((6000, 2)), rng.standard_normal((6000, 3))
    noise = np.zeros(6000)
    drawn = rng.standard_normal(6000)
    for k in range(1, 6000):
        noise[k] = 0.6 * noise[k - 1] + drawn[k]
    # the term that is missing is slow: a memory told before it would be longer
    slow = 20.0 * np.sin(np.arange(6000) / 300.0)
    usual = np.zeros(4, dtype=bool)
    found = prepared(base, np.column_stack([others, slow]), slow + noise, [o], usual)
    assert found.memory[0] == pytest.approx(0.6, abs=0.04)
    assert found.variance == pytest.approx(1.0, abs=0.06)
