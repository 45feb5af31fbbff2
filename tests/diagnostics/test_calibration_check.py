"""The bias of a fit by its filters: dense generalised least squares, and central differences."""

import json
from copy import copy
from types import SimpleNamespace

import numpy as np
import pytest
from numba import get_num_threads, set_num_threads
from scipy.stats import norm

import bayesfric as bf
from bayesfric.diagnostics.explanation import Explanation, calibration_check
from bayesfric.diagnostics.statistics import REPLICATES, Autocorrelation, Columns
from bayesfric.fit.model import Model
from bayesfric.inference.target import units_of
from bayesfric.mechanism.inverse import inverse_torque
from tests.axis import AXIS, VALUES, swing
from tests.diagnostics.bench import CENTRAL, TRUTH, dense_covariance, laid_out, model

KNOWN = {"noise.sigma": 0.02, "noise.pacf_1": 0.6, "noise.pacf_2": -0.2, "noise.pacf_3": 0.1}


@pytest.fixture(scope="module")
def target():
    """Of autocorrelated noise, with one parameter known and one whose prior says much."""
    time, autocorrelation = 0.004 * np.arange(1500), Autocorrelation(np.array([0.97]))
    motion = swing(time, ((0.4, 1.0), (1.3, 0.3)))
    torque = inverse_torque(AXIS, AXIS.vector(VALUES), *motion)
    torque = torque + 0.02 * autocorrelation.drawn(laid_out(1500), np.random.default_rng(1))
    priors = {
        "motor.coulomb": 0.3,
        "load.first_moment": {"distribution": "norm", "loc": 0.3, "scale": 1e-3},
    }
    source = bf.Recording.from_arrays(time, motion[0], torque)
    return Model(AXIS, source, priors=priors).target(VALUES)


def checked(target, replicates=(), reason=None, status="reliable", rest=None):
    median = np.array([(VALUES | KNOWN)[name] for name in target.names])
    posterior = SimpleNamespace(median=median, diagnostics=SimpleNamespace(status=status))
    explained = Explanation(replicates=tuple(replicates), reason=reason)
    observations = [SimpleNamespace(rest=None), SimpleNamespace(rest=rest)]
    return median, calibration_check(target, posterior, observations, explained)


@pytest.mark.parametrize("size", [1e-9, 1e-6, 0.1])
def test_a_replicates_fit_is_one_step_of_generalised_least_squares(target, size):
    """With the noise of the posterior, and of the prior only what it says of a change."""
    rng, where = np.random.default_rng(2), laid_out(80, gaps=[20, 21, 50])
    assert target.names[-1] != "noise.sigma"
    values = AXIS.vector(VALUES) * [1.1, 0.9, 1.0, 1.05, 0.8]
    base, left = rng.standard_normal((where.outputs, 5)), size * rng.standard_normal(where.outputs)
    median, result = checked(
        target, [(values, Columns(base, np.empty((len(base), 0)), left, where, ()))] * 2
    )
    k = len(target.free)
    free = [AXIS.names.index(name) for name in target.free]
    assert len(free) == 4
    np.testing.assert_allclose(result.truth, [[*values[free], *median[k:]]] * 2)
    assert result.reason is None
    # runs are independent of each other, as the likelihood has them
    blocks = [dense_covariance(Autocorrelation(median[k + 1 :]), laid_out(n)) for n in (20, 28, 29)]
    root = np.zeros((77, 77))
    begin = 0
    for block in blocks:
        part = slice(begin, begin := begin + len(block))
        root[part, part] = np.linalg.inv(np.linalg.cholesky(block)) / median[k]
    x, y = root @ base[:, free], root @ left
    sds = np.array([prior.sd() for prior in target.priors[:k]])
    step = np.linalg.solve(x.T @ x + np.diag(sds**-2.0), x.T @ y)
    assert result.unexplained[0] == pytest.approx(np.mean((y - x @ step) ** 2), rel=1e-6)
    # a way of a thousandth of a unit at most, along logarithms: to first order in the step
    unit = units_of(target, result.truth[0]).units
    assert result.steps[0] == pytest.approx(min(1.0, 1e-3 / np.abs(step / unit).max()), rel=1e-6)
    moved = (result.near_truth - result.truth)[0, :k]
    exact = result.steps[0] * step / unit
    np.testing.assert_allclose(moved / unit, exact, atol=2e-6, rtol=1e-3)
    np.testing.assert_array_equal(result.near_truth[0, k:], median[k:])
    np.testing.assert_array_equal(*result.near_truth)


def test_a_check_that_is_not_made_has_a_reason(target):
    rest = SimpleNamespace()
    replicate = (
        AXIS.vector(VALUES),
        Columns(np.ones((9, 5)), np.empty((9, 0)), np.ones(9), laid_out(9), ()),
    )
    for state, reason in (
        ({"reason": "few"}, "few"),
        ({"rest": rest}, "rest"),
        ({"status": "unusable"}, "sampling"),
        ({"reason": "still"}, "still"),
        ({"reason": "still", "rest": rest}, "rest"),
    ):
        _, result = checked(target, [replicate], **state)
        assert (result.reason, result.unexplained.size) == (reason, 0)
        assert result.truth.shape == (0, len(target.names))
    other = copy(target)
    other.likelihood = SimpleNamespace(chain=AXIS)
    assert checked(other, [replicate])[1].reason == "likelihood"


@pytest.fixture(scope="module")
def exact():
    return model().fit(seed=1)


@pytest.fixture(scope="module")
def central():
    return model(processing=CENTRAL).fit(seed=1)


def test_the_bias_of_central_differences_is_found_and_doubted(central):
    row = central.summary.parameters["motor.inertia"]
    check = central.summary.self_check["rows"]["motor.inertia"]
    off = (row.mean - TRUTH["motor.inertia"]) / row.sd
    assert off > 1.5  # the gain of central differences is too small, so the inertia too large
    assert check["bias"] == pytest.approx(off, abs=1.5)
    assert check["bias"] > 10.0 * check["bias_error"]
    assert check["coverage"] < 0.75
    (doubt,) = (doubt for doubt in central.summary.doubts if doubt.kind == "self-check")
    assert "motor.inertia" in doubt.parameters
    assert row.reported.status == "doubtful"


def test_exact_derivatives_have_next_to_no_bias(exact):
    """What is left, the low-pass does at reversals: 0.02 % of the viscous loss."""
    check = exact.summary.self_check
    assert check["made"] == check["asked"] == REPLICATES
    assert check["unexplained"] < 0.2
    for name, row in check["rows"].items():
        assert abs(row["bias"]) < 0.5, name
        summary_row = exact.summary.rows[name]
        reach = norm.ppf(0.95) * summary_row.reported.sd / summary_row.sd
        assert row["coverage"] == pytest.approx(2.0 * norm.cdf(reach) - 1.0, abs=0.03), name


def test_the_same_seed_gives_the_same_numbers_whatever_the_threads(exact):
    before = get_num_threads()
    set_num_threads(1)
    try:
        again = model().fit(seed=1)
    finally:
        set_num_threads(before)
    timeless = {"seconds": 0, "cpu_seconds": 0}
    records = [fit.summary.self_check | timeless for fit in (exact, again)]
    assert json.dumps(records[0]) == json.dumps(records[1])
