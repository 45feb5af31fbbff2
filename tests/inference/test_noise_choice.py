"""The order of the noise is choice again, and what is left is tested."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from bayesfric.estimates.autoregression import burg, long_run_variance, simulated
from bayesfric.inference.fitting import read_priors
from bayesfric.inference.noise import choose_noise, choose_order
from bayesfric.inference.priors import read_prior
from tests.axis import AXIS, VALUES, torque_columns
from tests.inference.test_autoregression import covariance

FOLLOWS = np.ones(2999, dtype=bool)
FOLLOWS[[500, 501, 1700]] = False


@pytest.mark.parametrize("per_recording", [False, True])
@pytest.mark.parametrize("partial", [[], [0.6], [0.8, -0.5], [0.5, 0.3, -0.3]])
def test_the_order_of_a_simulated_series_is_recovered(partial, per_recording):
    rng = np.random.default_rng(4)
    residuals = [0.1 * simulated(np.array(partial), FOLLOWS, 1, rng)[0] for _ in range(2)]
    choice = choose_order(residuals, [FOLLOWS, FOLLOWS], per_recording)
    assert choice.order == max(len(partial), 1)
    assert (choice.evidence[choice.order].bic < -6.0) == bool(partial)
    # what is open to the first where none is shown begins with none
    assert partial or choice.partial == (choice.half_range,)
    assert choice.evidence[0].bic == 0.0


def test_default_priors_are_restricted_to_the_autocorrelation_of_the_residuals():
    """Whose partial autocorrelations are known to one over the root of their number."""
    rng = np.random.default_rng(4)
    truth = np.array([0.8, -0.5])
    n = FOLLOWS.size + 1
    choice = choose_order([simulated(truth, FOLLOWS, 1, rng)[0]], [FOLLOWS], True)
    assert np.abs(np.array(choice.partial) - truth).max() < 3.3 / np.sqrt(n)
    free = read_prior("noise.pacf_1", [-0.95, 0.95], lower=-1.0, upper=1.0, default=True)
    second = read_prior("noise.pacf_2", [-0.1, 0.1], lower=-1.0, upper=1.0, default=False)
    restricted = choice.priors({"noise.pacf_1": free, "noise.pacf_2": second})
    assert restricted["noise.pacf_2"] is second
    assert restricted["noise.pacf_1"].default  # another estimate may say another
    low, high = restricted["noise.pacf_1"].limits
    assert low < choice.partial[0] < high
    assert high - low == pytest.approx(2.0 / np.sqrt(n))


@pytest.mark.parametrize("residual", [np.zeros(100), np.random.default_rng(1).standard_normal(15)])
def test_nothing_and_a_handful_of_residuals_are_white(residual):
    assert choose_order([residual], [FOLLOWS[: residual.size - 1]], True).order == 0


def closed_loop_like(seed, n=3000):
    """A slow torque, and an acceleration with noise in it: what a unit root believes instead."""
    rng = np.random.default_rng(seed)
    slow = np.cumsum(rng.standard_normal(n))
    slow = (slow - slow.mean()) / slow.std()
    seen = slow + 0.3 * rng.standard_normal(n)  # the regressor, as it is measured
    return 5.0 * slow + 0.05 * rng.standard_normal(n), seen


def test_an_autocorrelation_that_moves_the_estimate_is_refused():
    """With AR(1) near one the factor of 5 falls to next to nothing (errors in variables)."""
    torque, seen = closed_loop_like(1)
    factor = float(seen @ torque / (seen @ seen))
    assert factor == pytest.approx(5.0, rel=0.1)
    # what plain least squares leaves is white here; make it slow, as a missing term would be
    residual = torque - factor * seen + 0.6 * np.roll(torque, 40)
    residual -= seen * (seen @ residual) / (seen @ seen)
    follows = np.ones(residual.size - 1, dtype=bool)
    free = choose_order([residual], [follows], True)
    bound = choose_order([residual], [follows], True, effects=[5.0 * seen[:, None]])
    assert free.order == 4
    assert bound.order == 0
    assert all(evidence.shift > 3.0 for evidence in bound.evidence[1:])
    # residuals rise with it, as much as the estimate moves
    assert bound.evidence[4].rise > 1.1


def test_without_evidence_the_first_partial_autocorrelation_is_open():
    """From none to four standard errors beyond what residuals show."""
    rng = np.random.default_rng(3)
    follows = np.ones(199, dtype=bool)
    gains = []
    for _ in range(200):
        series = rng.standard_normal(200)
        choice = choose_order([series], [follows], True)
        gains.append(min(evidence.bic for evidence in choice.evidence))
        if gains[-1] >= -6.0:
            shown = burg([series], [follows], 1)[0]
            assert choice.order == 1
            assert choice.partial[0] - choice.half_range == 0.0
            assert choice.partial[0] + choice.half_range == pytest.approx(
                shown + 4.0 / np.sqrt(200)
            )
    assert min(gains) < 0.0  # some would have been taken for a memory that is known


def test_an_open_autocorrelation_moves_the_estimate_by_less_than_a_sd():
    """By a sd, in dense generalised least squares; twice as far it would, or is not left open."""
    n, slow = 60, np.sin(np.arange(60) / 6.0)
    follows, held = np.ones(n - 1, dtype=bool), []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        seen = slow + 0.3 * rng.standard_normal(n)  # the regressor, as it is measured
        residual = 0.6 * np.sin(np.arange(n) / 12.0) + rng.standard_normal(n)
        residual -= seen * (seen @ residual) / (seen @ seen)
        choice = choose_order([residual], [follows], True, effects=[50.0 * seen[:, None]])
        if choice.evidence[choice.order].bic < -6.0:
            continue
        x, y = seen / np.linalg.norm(seen), residual / np.sqrt(np.mean(residual**2))
        sd = np.sqrt(max(long_run_variance(x * y, np.arange(n)), 1.0))

        def moved(end, x=x, y=y, sd=sd):
            inverse = np.linalg.inv(covariance(np.array([min(end, 0.95)]), n))
            return abs(x @ inverse @ y / (x @ inverse @ x)) / sd

        end, max_count = 2.0 * choice.half_range, burg([y], [follows], 1)[0] + 4.0 / np.sqrt(n)
        assert moved(end) <= 1.0 + 1e-6
        held.append(end < 0.99 * max_count)
        assert held[-1] == (moved(max_count) > 1.0)
        assert not held[-1] or moved(2.0 * end) > 1.0
    assert 3 < sum(held) < len(held) - 3


@pytest.mark.parametrize("per_recording", [False, True])
def test_the_criterion_is_that_of_the_exact_density(per_recording):
    """Multivariate normals of two runs each, their size at its estimate."""
    rng = np.random.default_rng(2)
    lengths, factors = (50, 40), (0.1, 0.3)
    follows = np.ones(sum(lengths) - 1, dtype=bool)
    follows[lengths[0] - 1] = False
    residuals = [s * simulated(np.array([0.6, -0.3]), follows, 1, rng)[0] for s in factors]
    evidence_of = choose_order(residuals, [follows, follows], per_recording).evidence
    n = 2 * sum(lengths)

    def deviance(order):
        groups = [[r] for r in residuals] if per_recording else [residuals]
        scaled = [r / np.sqrt(np.mean(np.square(g))) for g in groups for r in g]
        series = burg(scaled, [follows, follows], order)
        inverse = [np.linalg.inv(covariance(series, k)) for k in lengths]
        total = -2.0 * sum(np.linalg.slogdet(block)[1] for block in inverse)
        for group in groups:
            runs = [np.split(r, [lengths[0]]) for r in group]
            squares = sum(x @ w @ x for pair in runs for x, w in zip(pair, inverse, strict=True))
            size = sum(r.size for r in group)
            total += size * np.log(squares / size)
        return total + order * np.log(n)

    for evidence in evidence_of[1:]:
        assert evidence.bic == pytest.approx(deviance(evidence.order) - deviance(0), abs=1e-8)


@pytest.mark.parametrize("per_recording", [False, True])
def test_shift_and_rise_are_those_of_generalised_least_squares(per_recording):
    """Of what residuals tell of orthogonal effects; one that they tell less of does not count."""
    rng = np.random.default_rng(11)
    lengths = (400, 200), (300, 1)
    joined = [np.ones(sum(k) - 1, dtype=bool) for k in lengths]
    for f, k in zip(joined, lengths, strict=True):
        f[k[0] - 1] = False
    residuals = [
        s * simulated(np.array([0.8]), f, 1, rng)[0]
        for s, f in zip((0.1, 0.4), joined, strict=True)
    ]
    residual = np.concatenate(residuals)
    parts = np.split(np.arange(residual.size), [residuals[0].size])
    size = np.full(residual.size, np.sqrt(np.mean(residual**2)))
    if per_recording:
        for p in parts:
            size[p] = np.sqrt(np.mean(residual[p] ** 2))
    time = np.arange(residual.size)
    slow = np.stack([np.sin(0.02 * time), np.cos(0.3 * time), np.sin(2.0 * time)], axis=1)
    basis, _ = np.linalg.qr(slow)
    effects = size[:, None] * basis * [40.0, 4.0, 2.0]
    choice = choose_order(residuals, joined, per_recording, [effects[p] for p in parts])
    scaled, informed = residual / size, basis[:, :2]
    plain = informed.T @ scaled
    # runs are far apart, so that their scores are not correlated
    places = np.arange(residual.size) + 1000 * np.repeat(np.arange(4), [400, 200, 300, 1])
    sds = [
        np.sqrt(max(long_run_variance(score, places), np.mean(scaled**2)))
        for score in informed.T * scaled
    ]
    pieces = [residual[p] / size[p] for p in parts]
    for evidence in choice.evidence[1:]:
        partial = burg(pieces, joined, evidence.order)
        inverse = np.linalg.inv(
            block_diag(*(covariance(partial, k) for pair in lengths for k in pair))
        )
        weighted = np.linalg.solve(informed.T @ inverse @ informed, informed.T @ inverse @ scaled)
        assert evidence.shift == pytest.approx(np.max(np.abs(weighted - plain) / sds), rel=1e-3)
        left = [np.linalg.norm(scaled - informed @ step) for step in (weighted, plain)]
        assert evidence.rise == pytest.approx(left[0] / left[1], rel=1e-9)


def test_the_choice_at_an_estimate_is_that_of_its_residuals_and_of_prior_effects(make_observation):
    """In closed form, for a torque that is linear in its parameters."""
    observations = [make_observation(AXIS, VALUES, n=900, seed=s, name=str(s)) for s in (0, 1)]
    point = VALUES | {"motor.viscous": 0.2, "offset": 0.0}
    texts = {"motor.inertia": [0.0, 0.2], "load.first_moment": 0.3}
    priors = read_priors(AXIS, texts, observations)
    columns = [torque_columns(o.q, o.qd, o.qdd) for o in observations]
    residuals = [
        o.measured - x @ AXIS.vector(point) for o, x in zip(observations, columns, strict=True)
    ]
    effects = [x * [priors[name].sd() for name in AXIS.names] for x in columns]
    joined = [np.ones(r.size - 1, dtype=bool) for r in residuals]
    for per_recording in (False, True):
        choice = choose_noise(AXIS, observations, priors, point, per_recording=per_recording)
        expected = choose_order(residuals, joined, per_recording, effects)
        assert choice.order == expected.order
        for evidence, reference in zip(choice.evidence, expected.evidence, strict=True):
            assert vars(evidence) == pytest.approx(vars(reference), rel=1e-3, abs=1e-6)
    fixed = AXIS.names.index("load.first_moment")
    assert priors["load.first_moment"].sd() == 0.0
    assert not any(e[:, fixed].any() for e in effects)
