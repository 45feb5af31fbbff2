"""Sizes of what may be missing: closed forms and integrals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp

from bayesfric.inference.missing import Missing, Sizes, chance_missing


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
    one = regression(0.2, n=2000)
    drawn = Sizes(one).drawn(np.random.default_rng(1))[:, 0]
    n, b = one.gram[0, 0], one.scores[0]
    variance = (one.power - b**2 / n) / one.free
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


def test_without_candidates_nothing_can_be_missing():
    assert chance_missing(replace(regression(1.0), kinds={})) == 0.0


def test_columns_cancel_no_better_than_their_shapes_are_known():
    """Two columns leave 1 % of themselves, the same but for its sign, and a tenth of one is left.

    Were their shapes exact they would explain it by sizes of five. With ``S`` the error of shapes,
    0.04 here as is the Gram matrix' diagonal, sizes are ``(G + S)^-1 b``, 3.33.
    """
    rng = np.random.default_rng(0)
    hidden, seen = np.linalg.qr(rng.standard_normal((400, 2)))[0].T * np.sqrt(400)
    columns = np.stack([hidden + 0.01 * seen, hidden - 0.01 * seen], axis=1)
    rest = np.stack([0.01 * seen, -0.01 * seen], axis=1)
    left = 0.1 * seen + 1e-3 * rng.standard_normal(400)
    exact = Missing(
        observations=(),
        columns=columns,
        kinds={"one": ((0,),), "other": ((1,),)},
        gram=rest.T @ rest,
        scores=rest.T @ left,
        column_errors=np.zeros(2),
        power=float(left @ left),
        spread=np.ones(2),
        free=398,
        biases_friction=np.zeros(2, dtype=bool),
    )

    def sizes(one):
        return Sizes(one).drawn(np.random.default_rng(1))

    # less by what the scale of 0.5 takes off, under a twentieth
    np.testing.assert_allclose(np.abs(sizes(exact).mean(axis=0)), 5.0, rtol=0.05)
    rough = replace(exact, column_errors=np.mean(columns**2, axis=0))
    expected = np.linalg.solve(exact.gram + 0.04 * np.eye(2), exact.scores)
    np.testing.assert_allclose(sizes(rough).mean(axis=0), expected, rtol=0.08)
