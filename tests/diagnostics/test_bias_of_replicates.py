"""One Gauss-Newton step on a replicate's exact torque, against dense generalised least squares."""

from copy import copy
from types import SimpleNamespace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.diagnostics.autocorrelation import Autocorrelation
from bayesfric.diagnostics.calibration_check import calibration_check
from bayesfric.diagnostics.explanation import Explanation
from bayesfric.diagnostics.regression import Replicate
from bayesfric.fit.model import Model
from bayesfric.inference.target import units_of
from bayesfric.mechanism.inverse import inverse_torque
from tests.axis import AXIS, VALUES, swing
from tests.diagnostics.bench import dense_covariance, laid_out

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
    made = Model(AXIS, source, priors=priors)
    return made.target(VALUES)


def checked(target, replicates=(), reason=None, status="reliable", rest=None):
    median = np.array([(VALUES | KNOWN)[name] for name in target.names])
    posterior = SimpleNamespace(median=median, diagnostics=SimpleNamespace(status=status))
    explained = Explanation(replicates=tuple(replicates), reason=reason)
    seen = [SimpleNamespace(rest=None), SimpleNamespace(rest=rest)]
    return median, calibration_check(target, posterior, seen, explained)


@pytest.mark.parametrize("size", [1e-9, 1e-6, 0.1])
def test_a_twins_fit_is_one_step_of_generalised_least_squares(target, size):
    """With the noise of the posterior, and of the prior only what it says of a change."""
    rng, where = np.random.default_rng(2), laid_out(80, gaps=[20, 21, 50])
    assert target.names[-1] != "noise.sigma"
    values = AXIS.vector(VALUES) * [1.1, 0.9, 1.0, 1.05, 0.8]
    base, left = rng.standard_normal((where.outputs, 5)), size * rng.standard_normal(where.outputs)
    median, result = checked(target, [Replicate(values, base, left, where)] * 2)
    (fit, again), k = result.fits, len(target.free)
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
    assert fit.unexplained == pytest.approx(np.mean((y - x @ step) ** 2), rel=1e-6)
    # a way of a thousandth of a unit at most, along logarithms: to first order in the step
    unit = units_of(target, result.truth[0]).units
    assert fit.share == pytest.approx(min(1.0, 1e-3 / np.abs(step / unit).max()), rel=1e-6)
    gone = (fit.near_truth - result.truth[0])[:k]
    np.testing.assert_allclose(gone / unit, fit.share * step / unit, atol=2e-6, rtol=1e-3)
    np.testing.assert_array_equal(fit.near_truth[k:], median[k:])
    np.testing.assert_array_equal(fit.near_truth, again.near_truth)


def test_it_says_why_there_is_none(target):
    rest = SimpleNamespace()
    replicate = Replicate(AXIS.vector(VALUES), np.ones((9, 5)), np.ones(9), laid_out(9))
    for told, reason in (
        ({"reason": "few"}, "few"),
        ({"rest": rest}, "rest"),
        ({"status": "unusable"}, "sampling"),
        ({"reason": "still"}, "still"),
        ({"reason": "still", "rest": rest}, "rest"),
    ):
        _, result = checked(target, [replicate], **told)
        assert (result.reason, result.fits) == (reason, ())
        assert result.truth.shape == (0, len(target.names))
    other = copy(target)
    other.likelihood = SimpleNamespace(chain=AXIS)
    assert checked(other, [replicate])[1].reason == "likelihood"
