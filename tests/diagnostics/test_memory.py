"""Noise that remembers across gaps: what whitening does to its exact covariance."""

import numpy as np
import pytest
from scipy.linalg import toeplitz

from bayesfric.diagnostics.memory import WHITE, Layout, Memory, memory_of
from bayesfric.inference.likelihood import autoregression as ar


def layout(*counts, gaps=()):
    """Recordings of so many outputs, those at ``gaps`` missing."""
    at, runs, stamps = [], [], []
    for n in counts:
        kept = np.setdiff1d(np.arange(n), gaps)
        at.append(kept - kept[0])
        runs.append(np.diff(kept) == 1)
        stamps.append(0.01 * kept)
    return Layout(tuple(runs), tuple(at), tuple(stamps))


def covariance(partial, at):
    """Exact, of an autoregressive series at some of its steps."""
    known = list(ar.autocovariance(partial))
    phi = ar.predictors(partial[None])[-1][0]
    while len(known) <= at[-1]:
        known.append(float(phi @ np.array(known[-1 : -len(phi) - 1 : -1])))
    return toeplitz(known)[np.ix_(at, at)]


@pytest.mark.parametrize("partial", [[0.8], [0.9, -0.5], [0.5, 0.3, -0.6]])
def test_whitening_over_gaps_makes_the_exact_covariance_one(partial):
    where = layout(60, gaps=[7, 8, 20, 21, 22, 23, 40])
    memory = Memory(np.array(partial))
    exact = covariance(memory.partial, where.at[0])
    white = memory.whitened(np.linalg.cholesky(exact), where)
    np.testing.assert_allclose(white @ white.T, np.eye(len(exact)), atol=1e-9)


def test_whitening_takes_out_the_wander_too():
    where = layout(80, gaps=[30, 31])
    memory = Memory(np.array([0.4]), slow=1.5)
    exact = covariance(memory.partial, where.at[0])
    exact = exact + memory.slow**2 * where.waves[0] @ where.waves[0].T
    white = memory.whitened(np.linalg.cholesky(exact), where)
    np.testing.assert_allclose(white @ white.T, np.eye(len(exact)), atol=1e-5)
    assert memory.variance(where) == pytest.approx(np.mean(np.diag(exact)))


def test_recordings_know_nothing_of_each_other():
    where = layout(30, 40)
    memory = Memory(np.array([0.7]))
    x = np.random.default_rng(1).standard_normal((70, 1))
    both = memory.whitened(x, where)
    for part, alone, n in ((slice(0, 30), x[:30], 30), (slice(30, 70), x[30:], 40)):
        np.testing.assert_allclose(both[part], memory.whitened(alone, layout(n)), atol=1e-12)


def test_noise_that_is_drawn_is_found_again():
    where = layout(4000, gaps=range(500, 600))
    truth = Memory(np.array([0.8, -0.3]))
    found, _ = memory_of(truth.drawn(where, np.random.default_rng(3)), where)
    # partial autocorrelations of 3900 outputs have sds of at most 1/sqrt(3900)
    np.testing.assert_allclose(found.partial[:2], truth.partial, atol=4.0 / np.sqrt(3900))


def test_white_noise_has_no_memory():
    where = layout(2000)
    found, _ = memory_of(np.random.default_rng(4).standard_normal(2000), where)
    assert found.partial.size == 0
    assert found.slow == 0.0
    x = np.ones((2000, 2))
    np.testing.assert_array_equal(WHITE.whitened(x, where), x)
