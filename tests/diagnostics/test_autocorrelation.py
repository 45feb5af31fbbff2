"""Noise that remembers across gaps: what whitening does to its exact covariance."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayesfric.diagnostics.autocorrelation import (
    WHITE,
    Autocorrelation,
    Layout,
    choose_autocorrelation,
)
from bayesfric.estimates import autoregression as ar
from tests.diagnostics.bench import dense_covariance, laid_out

PARTIALS = [[], [0.8], [0.9, -0.5], [0.5, 0.3, -0.6], [0.4, 0.1, 0.2, -0.3, 0.2, 0.1]]


@pytest.mark.parametrize("slow", [0.0, 0.15, 4.0])
@pytest.mark.parametrize("partial", PARTIALS)
def test_whitening_over_gaps_makes_the_exact_covariance_one(partial, slow):
    where = laid_out(60, 90, gaps=[7, 8, 20, 21, 22, 23, 40])
    autocorrelation = Autocorrelation(np.array(partial), slow)
    exact = dense_covariance(autocorrelation, where)
    white = autocorrelation.whitened(np.linalg.cholesky(exact), where)
    np.testing.assert_allclose(white @ white.T, np.eye(len(exact)), atol=1e-8)
    assert autocorrelation.variance(where) == pytest.approx(np.mean(np.diag(exact)))


@pytest.mark.parametrize(
    ("n", "rate", "many"), [(200, 100.0, 4), (400, 20.0, 39), (60, 2.0, 7), (600, 5.0, 60)]
)
def test_wander_is_a_sum_of_cosines_up_to_a_hertz(n, rate, many):
    """Four at least; one for eight outputs and sixty at most."""
    where = laid_out(n, rate=rate)
    (waves,) = where.drift_cosines
    assert waves.shape == (n, many)
    dense = dense_covariance(Autocorrelation(np.zeros(0), 1.0), where) - np.eye(n)
    np.testing.assert_allclose(waves @ waves.T, dense, atol=1e-9)
    assert many / 2.0 / np.ptp(where.stamps[0]) <= max(1.0, 2.0 / np.ptp(where.stamps[0]))


@pytest.mark.parametrize("gap", [0, 1, 300, 301])
def test_outputs_more_than_300_steps_apart_know_nothing_of_each_other(gap):
    """Nor do those that two segments have at the same step."""
    at = np.array([0, 1, 2, 2 + gap, 3 + gap])
    where = Layout((np.diff(at) == 1,), (at,), (0.01 * at + 1e-4 * np.arange(5),))
    autocorrelation = Autocorrelation(np.array([0.999, 0.1]))
    whole = dense_covariance(autocorrelation, laid_out(400))
    exact = whole[np.ix_(at, at)]
    if gap in (0, 301):
        exact[:3, 3:] = exact[3:, :3] = 0.0
    white = autocorrelation.whitened(np.linalg.cholesky(exact), where)
    np.testing.assert_allclose(white @ white.T, np.eye(5), atol=1e-7)


@pytest.mark.parametrize("slow", [0.0, 1.5])
def test_noise_that_is_drawn_has_the_exact_covariance(slow):
    where = laid_out(24, 20, gaps=[5, 6, 11])
    autocorrelation = Autocorrelation(np.array([0.6, -0.3]), slow)
    rng = np.random.default_rng(1)
    drawn = np.array([autocorrelation.drawn(where, rng) for _ in range(3000)])
    white = autocorrelation.whitened(drawn.T, where)
    # of independent normals: 38 means, and 741 products whose sds are at most sqrt(2/3000)
    assert np.abs(white.mean(axis=1)).max() < 4.5 / np.sqrt(3000)
    assert np.abs(white @ white.T / 3000 - np.eye(38)).max() < 4.5 * np.sqrt(2.0 / 3000)


def dense_choice(left, where):
    """Choose a memory by dense covariances: sizes of the wander, orders, and their criterion."""
    n, best, least = left.size, WHITE, np.inf
    for size in (0.0, 0.15, 0.45, 1.35, 4.0) if n > 40 else (0.0,):
        with_wander = dense_covariance(Autocorrelation(best.partial, size), where)
        without = dense_covariance(Autocorrelation(best.partial), where)
        # the wander's expectation: what is left then is the autoregression's
        rest = without @ np.linalg.solve(with_wander, left)
        partial = ar.burg(where.split(rest), where.runs, min(6, n // 20))
        costs = [
            n * np.log1p(-(partial[:p] ** 2)).sum() + p * np.log(n) for p in range(partial.size + 1)
        ]
        autocorrelation = Autocorrelation(partial[: int(np.argmin(costs))], size)
        covariance = dense_covariance(autocorrelation, where)
        power = left @ np.linalg.solve(covariance, left)
        bic = n * np.log(power / n) + np.linalg.slogdet(covariance)[1]
        bic += autocorrelation.partial.size * np.log(n)
        if bic < least:
            best, least = autocorrelation, bic
        elif best.drift:
            break
    return best, least


@pytest.mark.parametrize("slow", [0.0, 0.6, 3.0])
@pytest.mark.parametrize("partial", [[], [0.8, -0.4], [0.3, 0.3, 0.3]])
@pytest.mark.parametrize("counts", [(240,), (150, 130), (39,)])
def test_a_memory_is_chosen_by_its_exact_density(partial, slow, counts):
    """Against the same choice by dense covariances; where noise wanders much, wander is found."""
    where = laid_out(*counts, gaps=(11, 12, 13), rate=20.0)
    for seed in range(2):
        noise = Autocorrelation(np.array(partial), slow).drawn(where, np.random.default_rng(seed))
        found, bic = choose_autocorrelation(0.02 * noise, where)
        exact, least = dense_choice(0.02 * noise, where)
        assert (found.partial.size, found.drift) == (exact.partial.size, exact.drift)
        np.testing.assert_allclose(found.partial, exact.partial, rtol=1e-6)
        assert bic == pytest.approx(least, abs=1e-6)
        if slow == 3.0 and counts[0] > 40:
            assert found.drift
        if not slow and counts[0] > 40:
            assert found.drift < 0.5


def test_noise_that_is_drawn_is_found_again():
    where = laid_out(4000, gaps=range(500, 600))
    truth = Autocorrelation(np.array([0.8, -0.3]))
    found, _ = choose_autocorrelation(truth.drawn(where, np.random.default_rng(3)), where)
    # partial autocorrelations of 3900 outputs have sds of at most 1/sqrt(3900)
    np.testing.assert_allclose(found.partial[:2], truth.partial, atol=4.0 / np.sqrt(3900))


def test_a_layout_counts_whole_steps_from_each_recordings_first_output():
    """A clock that is off by a little is put right; what is missing is passed over."""
    rng = np.random.default_rng(1)
    at = [np.array([0, 1, 2, 5, 6]), np.array([0, 3, 4])]
    made = []
    for one, period in zip(at, (0.1, 0.25), strict=True):
        time = 7.0 + period * (one + rng.uniform(-0.2, 0.2, one.size) * (one > 0))
        taps = SimpleNamespace(starts=10 * one, n_outputs=one.size)
        settings = {"decimate": 10}
        made.append(SimpleNamespace(
            time=time, period=period, filter=taps, settings=settings,
            segment_of=np.zeros(one.size, int),
        ))  # fmt: skip
    where = Layout.of(made)
    for mine, exact, runs in zip(where.at, at, where.runs, strict=True):
        np.testing.assert_array_equal(mine, exact)
        np.testing.assert_array_equal(runs, np.diff(exact) == 1)
    assert where.outputs == 8
    assert [x.tolist() for x in where.split(np.arange(8))] == [[0, 1, 2, 3, 4], [5, 6, 7]]
    assert [x.tolist() for x in where.members] == [[1.0] * 5 + [0.0] * 3, [0.0] * 5 + [1.0] * 3]
    assert where.stamps == tuple(o.time for o in made)


def test_a_grid_holds_every_output_at_its_step():
    """Twice as long as the longest recording at least, so that a transform joins no ends."""
    where = laid_out(60, 33, 1, gaps=[4, 5], rate=20.0)
    step, span, size, places = where.grid
    assert (step, span) == pytest.approx((0.05, 59 * 0.05))
    assert size == 128
    exact = [k * size + at for k, at in enumerate(where.at)]
    np.testing.assert_array_equal(places, np.concatenate(exact))
