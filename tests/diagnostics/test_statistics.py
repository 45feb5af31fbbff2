"""Statistics of candidates, against dense least squares, scipy's distributions and simulation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import toeplitz

from bayesfric.diagnostics.autocorrelation import WHITE, Autocorrelation
from bayesfric.diagnostics.disturbances import (
    DELAY,
    SINUSOID,
    TRANSIENT,
    Scan,
    sinusoidal_disturbance,
    transient_disturbance,
)
from bayesfric.diagnostics.statistics import (
    CandidateScores,
    Columns,
    Key,
    basis_of,
    project_out,
    score_candidates,
    standard_normal_scores,
    truncated_least_squares,
)
from bayesfric.diagnostics.statistics import (
    testable as candidates,
)
from tests.diagnostics.bench import dense_covariance, laid_out

SEVERAL = {"single": 1, "pair": 2, "three": 3, "alone": 1}


def columns(autocorrelation=WHITE, seed=1, n=(90, 70), base=3, groups=SEVERAL, delays=()):
    """Random columns of two recordings with gaps, and a residual that some of them make."""
    rng = np.random.default_rng(seed)
    where = laid_out(*n, gaps=(20, 21, 50))
    keys = [Key(kind, "", i) for kind, k in groups.items() for i in range(k)]
    keys += [Key(DELAY, f"{d}", i, delay=d) for d in delays for i in (0, 1)]
    x = rng.standard_normal((where.outputs, base + len(keys))) * rng.uniform(
        0.1, 10.0, base + len(keys)
    )
    left = rng.standard_normal(where.outputs) + 0.3 * x[:, base] / x[:, base].std()
    return Columns(x[:, :base], x[:, base:], left, where, tuple(keys), autocorrelation)


def root(d):
    """Inverse root of the noise's dense covariance: generalised least squares without whitening."""
    return np.linalg.inv(np.linalg.cholesky(dense_covariance(d.autocorrelation, d.layout)))


def fitted(x, y):
    """Coefficients, their covariance in units of the variance, and the sum of squares left."""
    b, *_ = np.linalg.lstsq(x, y)
    return b, np.linalg.inv(x.T @ x), float(((y - x @ b) ** 2).sum())


MEMORIES = [
    WHITE,
    Autocorrelation(np.array([0.6, -0.4])),
    Autocorrelation(np.array([0.5]), drift=0.8),
]


@pytest.mark.parametrize("autocorrelation", MEMORIES, ids=["white", "autoregressive", "wandering"])
@pytest.mark.parametrize("extra", [[], [0], [0, 2]])
def test_t_and_gain_are_those_of_generalised_least_squares(autocorrelation, extra):
    d = columns(autocorrelation)
    groups = candidates(d)
    assert groups == [(d.keys[own[0]], own) for own in ([0], [1, 2], [3, 4, 5], [6])]
    found = score_candidates(d, groups, extra, 0.2)
    white = root(d)
    start = np.column_stack([d.base, d.others[:, extra]])
    *_, before = fitted(white @ start, white @ d.residual)
    for (_, own), t, gain in zip(groups, found.t, found.gains, strict=True):
        if set(own) & set(extra):
            assert np.isnan(t).all()
            assert gain == 0.0
            continue
        both = white @ np.column_stack([start, d.others[:, own]])
        b, covariance, after = fitted(both, white @ d.residual)
        variance = after / (d.residual.size - both.shape[1])
        sds = np.sqrt(variance * np.diag(covariance))
        np.testing.assert_allclose(t, (b / sds)[start.shape[1] :], rtol=1e-4)
        assert gain == pytest.approx((before - after) / variance, rel=1e-4)


def test_scans_are_of_the_whitened_residual_beside_the_models_columns():
    d = columns(MEMORIES[1])
    white = root(d)
    x, y = white @ d.base, white @ d.residual
    rest = y - x @ np.linalg.lstsq(x, y)[0]
    for mine, scan in zip(
        score_candidates(d, candidates(d), [], 0.2).scans[:2],
        (sinusoidal_disturbance(rest, d.layout), transient_disturbance(rest, d.layout, 0.2)),
        strict=True,
    ):
        assert mine.kind == scan.kind
        assert (mine.peak, mine.place) == pytest.approx((scan.peak, scan.place), rel=1e-6)


@pytest.mark.parametrize("autocorrelation", MEMORIES[:2], ids=["white", "autoregressive"])
def test_a_far_delay_is_the_best_of_dense_fits_with_a_coefficient_of_one(autocorrelation):
    delays = (0.03, -0.03, 0.2)
    for best in (None, 1):
        d = columns(autocorrelation, delays=delays)
        first = [i for i, key in enumerate(d.keys) if key.delay and key.number == 0]
        if best is not None:
            made = d.others[:, first[best]] - 0.4 * d.others[:, first[best] + 1]
            d = replace(d, residual=d.residual + made)
        white = root(d)
        x = white @ d.base
        *_, before = fitted(x, white @ d.residual)
        gains = []
        for i in first:
            rated = np.column_stack([x, white @ d.others[:, i + 1]])
            *_, after = fitted(rated, white @ (d.residual - d.others[:, i]))
            # two more than the model's: how fast it changed, and which delay
            gains.append((before - after) / after * (d.residual.size - 3 - 2))
        scan = score_candidates(d, candidates(d), [], 0.2).scans[2]
        assert scan.kind == DELAY
        assert scan.peak == pytest.approx(max(*gains, 0.0), rel=1e-6, abs=1e-9)
        if best is not None:
            assert scan.place == delays[best] == delays[int(np.argmax(gains))]
            # of one that was taken in there is no other
            taken = score_candidates(d, candidates(d), [first[best], first[best] + 1], 0.2).scans[2]
            assert (taken.peak, taken.place) == (0.0, 0.0)
    # nor of none
    none = score_candidates(columns(), candidates(columns()), [], 0.2).scans[2]
    assert (none.kind, none.peak, none.place) == (DELAY, 0.0, 0.0)


def test_columns_beside_and_far_delays_are_no_candidates():
    d = columns(delays=(0.03,))
    keys = list(d.keys)
    keys[0] = replace(keys[0], nuisance=True)
    assert [own for _, own in candidates(replace(d, keys=tuple(keys)))] == [[1, 2], [3, 4, 5], [6]]


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_a_candidate_is_asked_where_enough_of_it_is_outside_the_models_own(share):
    """Of its norm 1.5 %, whichever the size of the columns."""
    d = columns()
    inside = d.base @ [1.0, -2.0, 0.5]
    outside = project_out(basis_of(d.base), d.others[:, 0])
    inside, outside = (x / np.linalg.norm(x) for x in (inside, outside))
    sine = share * 0.015
    others = d.others.copy()
    for size in (1e-6, 1e6):
        others[:, 0] = size * (np.sqrt(1.0 - sine**2) * inside + sine * outside)
        told = candidates(replace(d, others=others))
        assert ("single" in [key.kind for key, _ in told]) == (share > 1.0)
        # one that was asked is not asked any longer where such a column was taken in
        (t, *_), (gain, *_) = (
            getattr(score_candidates(replace(d, others=others), [(d.keys[0], [0])], [], 0.2), name)
            for name in ("t", "gains")
        )
        assert np.isnan(t).all() == (share < 1.0) == (gain == 0.0)


def test_of_several_columns_those_are_asked_that_those_before_them_cannot_do():
    d = columns()
    others = d.others.copy()
    others[:, 2] = 3.0 * others[:, 1] + d.base[:, 0]
    others[:, 4] = 0.0
    groups = candidates(replace(d, others=others))
    told = {key.kind: own for key, own in groups}
    assert all(key == d.keys[own[0]] for key, own in groups)
    assert told == {"single": [0], "pair": [1], "three": [3, 5], "alone": [6]}
    # where all that is left of a pair is another candidate, that one stands for it
    others[:, 1], others[:, 2] = d.base[:, 1], -2.0 * others[:, 0] + d.base[:, 2]
    told = [key.kind for key, _ in candidates(replace(d, others=others))]
    assert told == ["single", "three", "alone"]
    # a candidate of one column that is another is asked beside it
    others[:, 6] = others[:, 0]
    told = [key.kind for key, _ in candidates(replace(d, others=others))]
    assert told == ["single", "three", "alone"]
    # and a pair whose columns have become one cannot be asked jointly
    others[:, 2] = d.others[:, 1] + 1e-3 * d.others[:, 2] / d.others[:, 2].std()
    others[:, 1] = d.others[:, 1]
    pair = score_candidates(replace(d, others=others), [(d.keys[1], [1, 2])], [], 0.2)
    assert np.isnan(pair.t[0]).all()
    assert pair.gains[0] == 0.0


def test_what_nothing_explains_and_what_everything_explains_are_finite():
    d = columns()
    exact = score_candidates(replace(d, residual=d.others[:, 0]), candidates(d), [], 0.2)
    assert all(np.isfinite(t).all() for t in exact.t)
    # the rest of an exact fit is rounding, of which a millionth in size counts
    assert exact.gains[0] == pytest.approx(1e12 * (d.residual.size - 4), rel=1e-3)


@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e8])
def test_a_basis_is_orthonormal_and_spans_what_its_columns_do(scale):
    rng = np.random.default_rng(2)
    x = rng.standard_normal((40, 4)) * [1.0, scale, 1.0, 1.0]
    x[:, 2] = 0.0
    x[:, 3] = x[:, 0] + x[:, 1] / scale
    basis = basis_of(x)
    assert basis.shape == (40, 2)
    np.testing.assert_allclose(basis.T @ basis, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(
        project_out(basis, x / (np.linalg.norm(x, axis=0) + 1e-300)), 0.0, atol=1e-9
    )
    y, both = rng.standard_normal(40), x[:, :2] / [1.0, scale]
    np.testing.assert_allclose(
        project_out(basis, y), y - both @ np.linalg.lstsq(both, y)[0], atol=1e-9
    )
    # columns that differ by a share of 1e-3 are two, by 1e-6 one
    for share, many in ((1e-3, 2), (1e-6, 1)):
        near = np.column_stack([x[:, 0], x[:, 0] + share * x[:, 1] / scale])
        assert basis_of(near).shape[1] == many
    assert basis_of(np.zeros((5, 3))).shape == basis_of(np.zeros((5, 0))).shape == (5, 0)


@pytest.mark.parametrize("size", [np.ones(4), np.array([1e-3, 1.0, 1e3, 10.0])])
def test_solved_is_least_squares_along_what_is_determined(size):
    rng = np.random.default_rng(1)
    x = rng.standard_normal((200, 4)) * [1.0, 1e-3, 10.0, 0.0]
    y = x @ [1.0, -2.0, 0.5, 0.0] + 0.1 * rng.standard_normal(200)
    found, covariance, told = truncated_least_squares(x, y, size)
    exact = np.linalg.lstsq(x[:, :3], y)[0]
    np.testing.assert_allclose(found, [*exact, 0.0], rtol=1e-8)
    left = y - x[:, :3] @ exact
    dense = np.zeros((4, 4))
    dense[:3, :3] = (left @ left) / 197 * np.linalg.inv(x[:, :3].T @ x[:, :3])
    np.testing.assert_allclose(covariance, dense, rtol=1e-8, atol=1e-300)
    np.testing.assert_allclose(told.T @ told, np.eye(3), atol=1e-12)
    assert np.abs(told[3]).max() < 1e-12
    # the sum of two equal columns' coefficients is told, their difference is not
    same = np.column_stack([x[:, :3], x[:, 0]])
    found, _, told = truncated_least_squares(same, y, np.ones(4))
    assert told.shape == (4, 3)
    assert found[0] + found[3] == pytest.approx(exact[0])
    assert found[0] == pytest.approx(found[3])
    assert np.linalg.norm(told.T @ [1.0, 0.0, 0.0, -1.0]) < 1e-6


# Scores


def sample(t, peaks=(), kind=SINUSOID):
    """Statistics of one candidate, and of a scan."""
    return CandidateScores(
        [np.atleast_1d(t)], np.zeros(1), tuple(Scan(kind, p, 1.0) for p in peaks)
    )


def unlikely(x, others, spread=0.0):
    """Standard normal as unlikely as a vector's distance from others, by scipy's F.

    A tenth is taken off their covariances, and ``spread`` times the mean's square is added.
    """
    (n, k), mean = others.shape, others.mean(axis=0)
    covariance = np.atleast_2d(np.cov(others.T))
    wide = 0.9 * covariance + 0.1 * np.diag(np.diag(covariance)) + spread * np.outer(mean, mean)
    square = (x - mean) @ np.linalg.inv(wide) @ (x - mean)
    f = square * n / (n + 1) * (n - k) / (k * (n - 1))
    return stats.norm.isf(stats.f.sf(f, k, n - k) / 2.0)


@pytest.mark.parametrize("k", [1, 2, 3])
@pytest.mark.parametrize("n", [12, 24])
def test_a_score_is_hotellings_among_the_others(k, n):
    """For the recording half of the replicates' mean is spread; for a replicate it is known."""
    rng = np.random.default_rng(4)
    t = rng.multivariate_normal([3.0] * k, 0.5 * np.eye(k) + 0.5, n)
    x = np.arange(1.0, k + 1.0)
    z, null = standard_normal_scores(sample(x), [sample(one) for one in t])
    assert z[0] == pytest.approx(unlikely(x, t, 0.25), rel=1e-6)
    exact = [unlikely(t[i], np.delete(t, i, axis=0)) for i in range(n)]
    np.testing.assert_allclose(null[:, 0], exact, rtol=1e-6)


@pytest.mark.parametrize("spread", [0.3, 4.0])
def test_a_scans_score_is_gumbels_of_the_twins_mean_and_spread(spread):
    """Of a spread of at least one: where replicates show nothing, that is a unit of chi squared."""
    rng = np.random.default_rng(7)
    peaks = 10.0 + spread * rng.standard_normal(24)
    mine = 14.0

    def score(x, others):
        sd = max(others.std(ddof=1), 1.0)
        scale = sd * np.sqrt(6.0) / np.pi
        law = stats.gumbel_r(others.mean() - np.euler_gamma * scale, scale)
        return stats.norm.isf(law.sf(x) / 2.0)

    z, null = standard_normal_scores(
        sample(0.0, (mine,)),
        [sample(t, (p,)) for t, p in zip(rng.standard_normal(24), peaks, strict=True)],
    )
    assert z[1] == pytest.approx(score(mine, peaks), rel=1e-6)
    exact = [score(peaks[i], np.delete(peaks, i)) for i in range(24)]
    np.testing.assert_allclose(null[:, 1], exact, rtol=1e-6, atol=1e-9)


def test_far_peaks_score_by_the_tail_of_gumbels():
    """There the logarithm of the probability is minus the standardised distance."""
    replicates = [
        sample(t, (p,))
        for t, p in zip(np.linspace(-1, 1, 24), np.tile([9.0, 11.0], 12), strict=True)
    ]
    sd = np.tile([9.0, 11.0], 12).std(ddof=1)
    for g in (15.0, 19.9, 20.1, 25.0, 300.0):
        peak = 10.0 + sd * (g - np.euler_gamma) * np.sqrt(6.0) / np.pi
        z = standard_normal_scores(sample(0.0, (peak,)), replicates)[0][1]
        assert stats.norm.logsf(z) == pytest.approx(-g - np.log(2.0), rel=1e-6)


@pytest.mark.parametrize("where", ["mine", "twin"])
def test_what_could_not_be_asked_of_one_scores_nothing(where):
    rng = np.random.default_rng(8)
    t = rng.standard_normal(24)
    mine = 9.0
    if where == "mine":
        mine = np.nan
    else:
        t[3] = np.nan
    z, null = standard_normal_scores(sample(mine), [sample(one) for one in t])
    assert z[0] == 0.0
    assert (null == 0.0).all()


def test_scores_of_twins_like_the_recording_are_standard_normal():
    """Scores of recordings drawn like their replicates are uniform, by Kolmogorov's test."""
    rng = np.random.default_rng(3)
    mix = np.array([[1.0, 0.3], [0.0, 0.8]])
    scores, replicates = [], []
    for _ in range(300):
        t = rng.standard_normal((25, 2)) @ mix
        peaks = rng.gumbel(5.0, 1.0, 25)
        made = [
            CandidateScores([x[:1], x], np.zeros(2), (Scan(TRANSIENT, p, 1.0),))
            for x, p in zip(t, peaks, strict=True)
        ]
        z, null = standard_normal_scores(made[0], made[1:])
        scores.append(z)
        replicates.append(null[0])
    for found in (np.array(scores), np.array(replicates)):
        p = 2.0 * stats.norm.sf(found)
        for column in p[:, :2].T:
            assert stats.kstest(column, "uniform").pvalue > 1e-3
        # mean and sd of a scan are estimates: its tail is a little heavier than Gumbel's
        assert np.mean(p[:, 2] < 0.1) == pytest.approx(0.1, abs=4.0 * np.sqrt(0.09 / 300))


def test_a_covariance_of_recordings_is_that_of_each():
    """The bench's own dense covariance is that of an autoregression of order one, in blocks."""
    where = laid_out(6, 5, gaps=(2,))
    dense = dense_covariance(Autocorrelation(np.array([0.5])), where)
    whole = toeplitz(0.5 ** np.arange(6)) / 0.75
    np.testing.assert_allclose(dense[:5, :5], np.delete(np.delete(whole, 2, 0), 2, 1))
    assert not dense[:5, 5:].any()
