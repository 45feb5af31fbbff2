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
        power=float(left @ left),
        spread=np.ones(m),
        free=n,
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
