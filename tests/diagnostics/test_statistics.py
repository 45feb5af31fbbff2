"""Noise, searches and statistics of candidates, against dense algebra, scipy and simulation."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import minimize_scalar

from bayesfric.diagnostics.statistics import (
    DELAY,
    SINUSOID,
    WHITE,
    Autocorrelation,
    Columns,
    Key,
    Layout,
    Scan,
    basis_of,
    candidate_groups,
    choose_autocorrelation,
    project_out,
    score_candidates,
    sinusoid_columns,
    sinusoidal_disturbance,
    standard_normal_scores,
    transient_columns,
    transient_disturbance,
    truncated_least_squares,
    tune_frequency,
)
from bayesfric.estimates import autoregression as ar
from tests.diagnostics.bench import dense_covariance, laid_out

# Autocorrelated noise

PARTIALS = [[], [0.8], [0.9, -0.5], [0.5, 0.3, -0.6], [0.4, 0.1, 0.2, -0.3, 0.2, 0.1]]
# rates at which a recording has 4, 39 and (one for eight outputs) 7 cosines of drift
LAYOUTS = [((60, 90), 100.0), ((400,), 20.0), ((60,), 2.0)]


@pytest.mark.parametrize(("counts", "rate"), LAYOUTS)
@pytest.mark.parametrize("drift", [0.0, 0.15, 4.0])
@pytest.mark.parametrize("partial", PARTIALS)
def test_whitening_across_gaps_makes_the_exact_covariance_one(partial, drift, counts, rate):
    layout = laid_out(*counts, gaps=[7, 8, 20, 21, 22, 23, 40], rate=rate)
    autocorrelation = Autocorrelation(np.array(partial), drift)
    exact = dense_covariance(autocorrelation, layout)
    white = autocorrelation.whitened(np.linalg.cholesky(exact), layout)
    np.testing.assert_allclose(white @ white.T, np.eye(len(exact)), atol=1e-7)
    assert autocorrelation.variance(layout) == pytest.approx(np.mean(np.diag(exact)))


@pytest.mark.parametrize("gap", [0, 1, 300, 301])
def test_outputs_more_than_300_steps_apart_are_independent(gap):
    """So are those of two segments at the same step."""
    at = np.array([0, 1, 2, 2 + gap, 3 + gap])
    layout = Layout((np.diff(at) == 1,), (at,), (0.01 * at + 1e-4 * np.arange(5),))
    autocorrelation = Autocorrelation(np.array([0.999, 0.1]))
    exact = dense_covariance(autocorrelation, laid_out(400))[np.ix_(at, at)]
    if gap in (0, 301):
        exact[:3, 3:] = exact[3:, :3] = 0.0
    white = autocorrelation.whitened(np.linalg.cholesky(exact), layout)
    np.testing.assert_allclose(white @ white.T, np.eye(5), atol=1e-7)


@pytest.mark.parametrize("drift", [0.0, 1.5])
def test_drawn_noise_has_the_exact_covariance(drift):
    layout = laid_out(24, 20, gaps=[5, 6, 11])
    autocorrelation = Autocorrelation(np.array([0.6, -0.3]), drift)
    rng = np.random.default_rng(1)
    drawn = np.array([autocorrelation.drawn(layout, rng) for _ in range(3000)])
    white = autocorrelation.whitened(drawn.T, layout)
    # of independent normals: 38 means, and 741 products whose sds are at most sqrt(2/3000)
    assert np.abs(white.mean(axis=1)).max() < 4.5 / np.sqrt(3000)
    assert np.abs(white @ white.T / 3000 - np.eye(38)).max() < 4.5 * np.sqrt(2.0 / 3000)


def dense_choice(residual, layout):
    """Choose the noise by dense covariances: sizes of the drift, orders, and their criterion."""
    n, best, least = residual.size, WHITE, np.inf
    for size in (0.0, 0.15, 0.45, 1.35, 4.0) if n > 40 else (0.0,):
        with_drift = dense_covariance(Autocorrelation(best.partial, size), layout)
        without = dense_covariance(Autocorrelation(best.partial), layout)
        # less the expected drift, the residual is autoregressive
        rest = without @ np.linalg.solve(with_drift, residual)
        partial = ar.burg(layout.split(rest), layout.runs, min(6, n // 20))
        costs = [
            n * np.log1p(-(partial[:p] ** 2)).sum() + p * np.log(n) for p in range(partial.size + 1)
        ]
        autocorrelation = Autocorrelation(partial[: int(np.argmin(costs))], size)
        covariance = dense_covariance(autocorrelation, layout)
        power = residual @ np.linalg.solve(covariance, residual)
        bic = n * np.log(power / n) + np.linalg.slogdet(covariance)[1]
        bic += autocorrelation.partial.size * np.log(n)
        if bic < least:
            best, least = autocorrelation, bic
        elif best.drift:
            break
    return best, least


@pytest.mark.parametrize("drift", [0.0, 0.6, 3.0])
@pytest.mark.parametrize("partial", [[], [0.8, -0.4], [0.3, 0.3, 0.3]])
@pytest.mark.parametrize("counts", [(240,), (150, 130), (39,)])
def test_the_noise_is_chosen_by_its_exact_density(partial, drift, counts):
    layout = laid_out(*counts, gaps=(11, 12, 13), rate=20.0)
    for seed in range(2):
        noise = Autocorrelation(np.array(partial), drift).drawn(layout, np.random.default_rng(seed))
        chosen, bic = choose_autocorrelation(0.02 * noise, layout)
        exact, least = dense_choice(0.02 * noise, layout)
        assert (chosen.partial.size, chosen.drift) == (exact.partial.size, exact.drift)
        np.testing.assert_allclose(chosen.partial, exact.partial, rtol=1e-6)
        assert bic == pytest.approx(least, abs=1e-6)
        if counts[0] > 40 and drift != 0.6:
            assert chosen.drift > 0.0 if drift else chosen.drift < 0.5


def test_a_layout_counts_whole_steps_from_each_recordings_first_output():
    """Of a clock with jitter, and with missing outputs."""
    rng = np.random.default_rng(1)
    steps = [np.array([0, 1, 2, 5, 6]), np.array([0, 3, 4])]
    observations = []
    for at, period in zip(steps, (0.1, 0.25), strict=True):
        time = 7.0 + period * (at + rng.uniform(-0.2, 0.2, at.size) * (at > 0))
        windows = SimpleNamespace(starts=10 * at, n_outputs=at.size)
        observations.append(SimpleNamespace(
            time=time, period=period, filter=windows, settings={"decimate": 10},
            segment_of=np.zeros(at.size, int),
        ))  # fmt: skip
    layout = Layout.of(observations)
    for at, exact, runs in zip(layout.at, steps, layout.runs, strict=True):
        np.testing.assert_array_equal(at, exact)
        np.testing.assert_array_equal(runs, np.diff(exact) == 1)
    assert [x.tolist() for x in layout.split(np.arange(8))] == [[0, 1, 2, 3, 4], [5, 6, 7]]
    assert [x.tolist() for x in layout.members] == [[1.0] * 5 + [0.0] * 3, [0.0] * 5 + [1.0] * 3]
    # the transform of the longest recording joins no ends
    layout = laid_out(60, 33, 1, gaps=[4, 5], rate=20.0)
    step, span, size, places = layout.grid
    assert (step, span, size) == pytest.approx((0.05, 59 * 0.05, 128))
    exact = [k * size + at for k, at in enumerate(layout.at)]
    np.testing.assert_array_equal(places, np.concatenate(exact))


# Searches, against those that try every place

RATE = 50.0


def sinusoid_gain(y, layout, hertz):
    """Twice the rise of the log-likelihood by sine and cosine of a frequency, in each recording."""
    power = 0.0
    for t, part in zip(layout.stamps, layout.split(y), strict=True):
        power += abs(np.sum(part * np.exp(-2j * np.pi * hertz * (t - t[0])))) ** 2
    power /= 0.5 * float(y @ y)
    return power / (1.0 - power / y.size)


@pytest.mark.parametrize("counts", [(400,), (300, 120), (80, 90, 300)])
@pytest.mark.parametrize("seed", range(4))
def test_a_sinusoid_is_the_largest_of_the_periodogram(counts, seed):
    layout = laid_out(*counts, gaps=(30, 31, 77), rate=RATE)
    y = np.random.default_rng(seed).standard_normal(layout.outputs)
    span = max(np.ptp(t) for t in layout.stamps)
    # grid of the transform: a power of two of samples, twice the longest recording at least
    grid = RATE / 2 ** np.ceil(np.log2(2.0 * span * RATE + 2.0)) * np.arange(1, 1000)
    grid = grid[(grid >= 2.0 / span) & (grid <= 0.45 * RATE)]
    gains = [sinusoid_gain(y, layout, f) for f in grid]
    scan = sinusoidal_disturbance(y, layout)
    assert (scan.peak, scan.place) == pytest.approx((max(gains), grid[np.argmax(gains)]), rel=1e-6)


@pytest.mark.parametrize("hertz", [0.11, 0.2, 22.0, 24.0])
def test_sinusoids_have_two_periods_and_are_below_nearly_half_the_rate(hertz):
    """Of ten seconds from 0.2 Hz on, at a rate of 50 Hz up to 22.5 Hz."""
    layout = laid_out(501, rate=RATE)
    scan = sinusoidal_disturbance(np.sin(2 * np.pi * hertz * layout.stamps[0] + 0.3), layout)
    assert 0.2 - 0.05 <= scan.place <= 22.5 + 0.05
    tolerance = 0.05 if 0.2 <= hertz <= 22.5 else 0.2
    assert scan.place == pytest.approx(np.clip(hertz, 0.2, 22.5), abs=tolerance)


@pytest.mark.parametrize("seed", range(40))
def test_a_transient_is_the_largest_mean_of_all_places(seed):
    """Also right at the ends, and in whichever recording."""
    rng = np.random.default_rng(seed)
    layout = laid_out(*rng.integers(30, 90, 3), gaps=rng.integers(5, 25, 12), rate=RATE)
    width = rng.uniform(0.05, 0.3)
    parts = layout.split(rng.standard_normal(layout.outputs))
    parts[seed % 2][slice(6) if seed % 3 == 0 else slice(-6, None)] += 3.0
    y = np.concatenate(parts)
    best = (0.0, 0.0, 0)
    for k, (t, part) in enumerate(zip(layout.stamps, layout.split(y), strict=True)):
        place = t[0] + width
        while place < t[-1]:
            inside = part[(t >= place - 1.5 * width) & (t < place + 1.5 * width)]
            if inside.size >= 3:
                best = max(best, (inside.sum() ** 2 / inside.size / np.mean(y**2), place, k))
            place += width
    scan = transient_disturbance(y, layout, width)
    assert (scan.peak, scan.place, scan.recording) == pytest.approx(best, rel=1e-9)


def test_a_transient_has_three_outputs_at_least():
    for missing, enough in ((9, False), (8, True)):  # outputs 19 and 20 alone, or three
        layout = laid_out(40, gaps=[*range(10, 10 + missing), *range(21, 30)], rate=RATE)
        y = np.zeros(layout.outputs)
        y[10 : 10 + 11 - missing] = 5.0
        exact = 9 * 25.0 / 3 / np.mean(y**2) if enough else 0.0
        assert transient_disturbance(y, layout, 0.04).peak == pytest.approx(exact)
    # recordings that are too short
    assert not transient_disturbance(np.ones(8), laid_out(4, 4, rate=RATE), 0.25).peak
    assert not sinusoidal_disturbance(np.sin([*range(9)]), laid_out(3, 3, 3, rate=RATE)).peak


def test_columns_of_a_search_remove_what_it_finds():
    layout = laid_out(1000, 1500, rate=RATE)
    t, first = np.concatenate(layout.stamps), np.arange(2500) < 1000
    exact = [f(8 * np.pi * t) * part for part in (first, ~first) for f in (np.sin, np.cos)]
    np.testing.assert_allclose(sinusoid_columns(layout, 4.0).T, exact, atol=1e-9)
    y = np.exp(-0.5 * ((t - 7.1) / 0.25) ** 2) * ~first
    scan = transient_disturbance(y, layout, 0.25)
    x = transient_columns(layout, scan, 0.25)
    assert np.abs(y - x @ np.linalg.lstsq(x, y)[0]).max() < 0.02
    # bells as far apart as they are wide
    bells = transient_columns(layout, replace(scan, place=7.1), 0.25)
    for column, centre in ((2, 7.1), (0, 6.6), (4, 7.6)):
        exact = np.exp(-0.5 * ((t - centre) / 0.25) ** 2) * ~first
        np.testing.assert_allclose(bells[:, column], exact, atol=1e-12)


@pytest.mark.parametrize("counts", [(600,), (400, 700)])
@pytest.mark.parametrize("off", [-0.6, -0.15, 0.05, 0.6])
def test_a_tuned_sinusoid_leaves_least_of_all_frequencies(counts, off):
    """In addition to the model, with a phase and size of its own in each recording."""
    layout, rng = laid_out(*counts, rate=RATE), np.random.default_rng(2)
    t = np.concatenate(layout.stamps)
    waves = [
        size * np.sin(2 * np.pi * 3.217 * stamps + phase)
        for stamps, phase, size in zip(layout.stamps, (0.3, 2.0), (1.0, 0.5), strict=False)
    ]
    y = np.concatenate(waves) + 0.05 * rng.standard_normal(t.size)
    base = np.linalg.qr(np.column_stack([np.ones(t.size), t]))[0]

    def project(x):
        return x - base @ (base.T @ x)

    def power(hertz):
        x = project(sinusoid_columns(layout, hertz))
        return float(((project(y) - x @ np.linalg.lstsq(x, project(y))[0]) ** 2).sum())

    span = max(np.ptp(stamps) for stamps in layout.stamps)
    best = minimize_scalar(power, bounds=(3.2, 3.235), method="bounded", options={"xatol": 1e-7}).x
    tuned = tune_frequency(project(y), layout, best + off / span, project)
    assert abs(tuned - best) < 0.01 / span


# Statistics of candidates

SEVERAL = {"single": 1, "pair": 2, "three": 3, "alone": 1}
NOISES = [WHITE, Autocorrelation(np.array([0.6, -0.4])), Autocorrelation(np.array([0.5]), 0.8)]


def columns(autocorrelation=WHITE, delays=()):
    """Random columns of two recordings with gaps, and a residual that some of them make."""
    rng, layout = np.random.default_rng(1), laid_out(90, 70, gaps=(20, 21, 50))
    keys = [Key(kind, "", i) for kind, k in SEVERAL.items() for i in range(k)]
    keys += [Key(DELAY, f"{d}", i, delay=d) for d in delays for i in (0, 1)]
    count = 3 + len(keys)
    x = rng.standard_normal((layout.outputs, count)) * rng.uniform(0.1, 10.0, count)
    residual = rng.standard_normal(layout.outputs) + 0.3 * x[:, 3] / x[:, 3].std()
    return Columns(x[:, :3], x[:, 3:], residual, layout, tuple(keys), autocorrelation)


def root(d):
    """Inverse root of the noise's dense covariance: generalised least squares without whitening."""
    return np.linalg.inv(np.linalg.cholesky(dense_covariance(d.autocorrelation, d.layout)))


def least_squares(x, y):
    """Coefficients, their covariance in units of the variance, and the sum of squares left."""
    b, *_ = np.linalg.lstsq(x, y)
    return b, np.linalg.inv(x.T @ x), float(((y - x @ b) ** 2).sum())


def scored(d, groups=None, extra=()):
    return score_candidates(d, candidate_groups(d) if groups is None else groups, list(extra), 0.2)


@pytest.mark.parametrize("autocorrelation", NOISES, ids=["white", "autoregressive", "drifting"])
@pytest.mark.parametrize("extra", [[], [0], [0, 2]])
def test_t_and_gain_are_those_of_generalised_least_squares(autocorrelation, extra):
    """And searches are of the whitened residual in addition to the model's columns."""
    d = columns(autocorrelation)
    groups = candidate_groups(d)
    assert groups == [(d.keys[k[0]], k) for k in ([0], [1, 2], [3, 4, 5], [6])]
    t_values, gains, scans = scored(d, groups, extra)
    white = root(d)
    start = white @ np.column_stack([d.base, d.others[:, extra]])
    b, _, before = least_squares(start, white @ d.residual)
    for (_, members), t, gain in zip(groups, t_values, gains, strict=True):
        if set(members) & set(extra):
            assert np.isnan(t).all()
            assert gain == 0.0
            continue
        both = np.column_stack([start, white @ d.others[:, members]])
        joint, covariance, after = least_squares(both, white @ d.residual)
        variance = after / (d.residual.size - both.shape[1])
        sds = np.sqrt(variance * np.diag(covariance))
        np.testing.assert_allclose(t, (joint / sds)[start.shape[1] :], rtol=1e-4)
        assert gain == pytest.approx((before - after) / variance, rel=1e-4)
    if autocorrelation.drift:  # whitened otherwise than by this root
        return
    rest = white @ d.residual - start @ b
    exact = sinusoidal_disturbance(rest, d.layout), transient_disturbance(rest, d.layout, 0.2)
    for scan, search in zip(scans[:2], exact, strict=True):
        assert (scan.peak, scan.place) == pytest.approx((search.peak, search.place), rel=1e-6)


@pytest.mark.parametrize("autocorrelation", NOISES[:2], ids=["white", "autoregressive"])
@pytest.mark.parametrize("best", [None, 1])
def test_a_far_delay_is_the_best_of_dense_fits_with_a_coefficient_of_one(autocorrelation, best):
    delays = (0.03, -0.03, 0.2)
    d = columns(autocorrelation, delays)
    first = [i for i, key in enumerate(d.keys) if key.delay and key.number == 0]
    if best is not None:
        effect = d.others[:, first[best]] - 0.4 * d.others[:, first[best] + 1]
        d = replace(d, residual=d.residual + effect)
    white = root(d)
    x = white @ d.base
    *_, before = least_squares(x, white @ d.residual)
    gains = []
    for i in first:
        with_rate = np.column_stack([x, white @ d.others[:, i + 1]])
        *_, after = least_squares(with_rate, white @ (d.residual - d.others[:, i]))
        # two parameters more than the model's: the rate and which delay
        gains.append((before - after) / after * (d.residual.size - 3 - 2))
    *_, (*_, scan) = scored(d)
    assert scan.kind == DELAY
    assert scan.peak == pytest.approx(max(*gains, 0.0), rel=1e-6, abs=1e-9)
    if best is not None:
        assert scan.place == delays[best] == delays[int(np.argmax(gains))]
        # a second delay is not searched, nor any without columns
        for other in (scored(d, extra=[first[best], first[best] + 1]), scored(columns())):
            assert other[2][2] == Scan(DELAY, 0.0, 0.0)


@pytest.mark.parametrize("share", [0.99, 1.01])
@pytest.mark.parametrize("size", [1e-6, 1e6])
def test_a_candidate_is_tested_where_enough_of_it_is_outside_the_models_columns(share, size):
    """Of its norm 1.5 %, whichever the size of the columns."""
    d = columns()
    inside = d.base @ [1.0, -2.0, 0.5]
    outside = project_out(basis_of(d.base), d.others[:, 0])
    inside, outside = (x / np.linalg.norm(x) for x in (inside, outside))
    sine, others = share * 0.015, d.others.copy()
    others[:, 0] = size * (np.sqrt(1.0 - sine**2) * inside + sine * outside)
    d = replace(d, others=others)
    assert ("single" in [key.kind for key, _ in candidate_groups(d)]) == (share > 1.0)
    (t,), (gain,), _ = scored(d, [(d.keys[0], [0])])
    assert np.isnan(t).all() == (share < 1.0) == (gain == 0.0)


def test_collinear_columns_are_dropped():
    """Later ones; nuisance columns and far delays are no candidates."""
    d = columns(delays=(0.03,))
    keys = [replace(d.keys[0], nuisance=True), *d.keys[1:]]
    groups = candidate_groups(replace(d, keys=tuple(keys)))
    assert [members for _, members in groups] == [[1, 2], [3, 4, 5], [6]]
    d = columns()
    others = d.others.copy()
    others[:, 2] = 3.0 * others[:, 1] + d.base[:, 0]
    others[:, 4] = 0.0
    groups = candidate_groups(replace(d, others=others))
    assert all(key == d.keys[members[0]] for key, members in groups)
    members = {key.kind: members for key, members in groups}
    assert members == {"single": [0], "pair": [1], "three": [3, 5], "alone": [6]}
    # where all that is left of a pair is another candidate, that one stands for it; an equal
    # candidate of one column is tested, too
    others[:, 1], others[:, 2] = d.base[:, 1], -2.0 * others[:, 0] + d.base[:, 2]
    for alone in (others[:, 6], others[:, 0]):
        others[:, 6] = alone
        kinds = [key.kind for key, _ in candidate_groups(replace(d, others=others))]
        assert kinds == ["single", "three", "alone"]
    # and a pair of nearly equal columns cannot be tested jointly
    others[:, 2] = d.others[:, 1] + 1e-3 * d.others[:, 2] / d.others[:, 2].std()
    others[:, 1] = d.others[:, 1]
    (t,), (gain,), _ = scored(replace(d, others=others), [(d.keys[1], [1, 2])])
    assert np.isnan(t).all()
    assert gain == 0.0


def test_statistics_of_an_exact_fit_are_finite():
    d = columns()
    t_values, gains, _ = scored(replace(d, residual=d.others[:, 0]))
    assert all(np.isfinite(t).all() for t in t_values)
    # the rest of an exact fit is rounding, of which a millionth in size counts
    assert gains[0] == pytest.approx(1e12 * (d.residual.size - 4), rel=1e-3)


@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e8])
def test_a_basis_is_orthonormal_and_spans_its_columns(scale):
    rng = np.random.default_rng(2)
    x = rng.standard_normal((40, 4)) * [1.0, scale, 1.0, 1.0]
    x[:, 2] = 0.0
    x[:, 3] = x[:, 0] + x[:, 1] / scale
    basis, y, both = basis_of(x), rng.standard_normal(40), x[:, :2] / [1.0, scale]
    np.testing.assert_allclose(basis.T @ basis, np.eye(2), atol=1e-12)
    rest = y - both @ np.linalg.lstsq(both, y)[0]
    np.testing.assert_allclose(project_out(basis, y), rest, atol=1e-9)
    # columns that differ by a share of 1e-3 are two, by 1e-6 one
    for share, count in ((1e-3, 2), (1e-6, 1)):
        near = np.column_stack([x[:, 0], x[:, 0] + share * x[:, 1] / scale])
        assert basis_of(near).shape[1] == count
    assert basis_of(np.zeros((5, 3))).shape == basis_of(np.zeros((5, 0))).shape == (5, 0)


@pytest.mark.parametrize("size", [np.ones(4), np.array([1e-3, 1.0, 1e3, 10.0])])
def test_truncated_least_squares_is_that_of_the_determined_directions(size):
    rng = np.random.default_rng(1)
    x = rng.standard_normal((200, 4)) * [1.0, 1e-3, 10.0, 0.0]
    y = x @ [1.0, -2.0, 0.5, 0.0] + 0.1 * rng.standard_normal(200)
    estimate, covariance, directions = truncated_least_squares(x, y, size)
    exact, inverse, power = least_squares(x[:, :3], y)
    np.testing.assert_allclose(estimate, [*exact, 0.0], rtol=1e-8)
    dense = np.pad(power / 197 * inverse, (0, 1))
    np.testing.assert_allclose(covariance, dense, rtol=1e-8, atol=1e-300)
    np.testing.assert_allclose(directions.T @ directions, np.eye(3), atol=1e-12)
    assert np.abs(directions[3]).max() < 1e-12
    # the sum of two equal columns' coefficients is determined, their difference is not
    same = np.column_stack([x[:, :3], x[:, 0]])
    estimate, _, directions = truncated_least_squares(same, y, np.ones(4))
    assert directions.shape == (4, 3)
    assert estimate[0] + estimate[3] == pytest.approx(exact[0])
    assert estimate[0] == pytest.approx(estimate[3])
    assert np.linalg.norm(directions.T @ [1.0, 0.0, 0.0, -1.0]) < 1e-6


# Scores


def sample(t, peaks=(), kind=SINUSOID):
    """Statistics of one candidate, and of a search."""
    return [np.atleast_1d(t)], np.zeros(1), tuple(Scan(kind, p, 1.0) for p in peaks)


def hotelling_score(x, others, spread=0.0):
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
    z, null = standard_normal_scores(sample(x), [sample(row) for row in t])
    assert z[0] == pytest.approx(hotelling_score(x, t, 0.25), rel=1e-6)
    exact = [hotelling_score(t[i], np.delete(t, i, axis=0)) for i in range(n)]
    np.testing.assert_allclose(null[:, 0], exact, rtol=1e-6)


def gumbel_score(x, others):
    """Standard normal as unlikely as a peak among others, by scipy's Gumbel law."""
    scale = max(others.std(ddof=1), 1.0) * np.sqrt(6.0) / np.pi
    law = stats.gumbel_r(others.mean() - np.euler_gamma * scale, scale)
    return stats.norm.isf(law.sf(x) / 2.0)


@pytest.mark.parametrize("spread", [0.3, 4.0])
def test_a_searchs_score_is_gumbels_of_the_replicates_mean_and_spread(spread):
    """Of a spread of at least one: where replicates show nothing, that is a unit of chi squared."""
    rng = np.random.default_rng(7)
    peaks = 10.0 + spread * rng.standard_normal(24)
    replicates = [sample(t, (p,)) for t, p in zip(rng.standard_normal(24), peaks, strict=True)]
    z, null = standard_normal_scores(sample(0.0, (14.0,)), replicates)
    assert z[1] == pytest.approx(gumbel_score(14.0, peaks), rel=1e-6)
    exact = [gumbel_score(peaks[i], np.delete(peaks, i)) for i in range(24)]
    np.testing.assert_allclose(null[:, 1], exact, rtol=1e-6, atol=1e-9)
    # far out the logarithm of the probability is minus the standardised distance
    for g in (15.0, 19.9, 20.1, 25.0, 300.0):
        sd = max(peaks.std(ddof=1), 1.0)
        far = peaks.mean() + sd * (g - np.euler_gamma) * np.sqrt(6.0) / np.pi
        z = standard_normal_scores(sample(0.0, (far,)), replicates)[0][1]
        assert stats.norm.logsf(z) == pytest.approx(-g - np.log(2.0), rel=1e-6)


@pytest.mark.parametrize("undefined", ["recording", "replicate"])
def test_a_statistic_that_a_recording_or_replicate_lacks_scores_nothing(undefined):
    t, recorded = np.random.default_rng(8).standard_normal(24), 9.0
    if undefined == "recording":
        recorded = np.nan
    else:
        t[3] = np.nan
    z, null = standard_normal_scores(sample(recorded), [sample(x) for x in t])
    assert z[0] == 0.0
    assert (null == 0.0).all()
