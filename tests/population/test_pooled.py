"""Recordings that differ in one parameter: their posterior, closed forms, and refusals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

import bayesfric as bf
from bayesfric.diagnostics.explanation import Explanation
from bayesfric.diagnostics.regression import Finding
from bayesfric.fit.model import Model
from bayesfric.inference.discrepancy import Discrepancy
from bayesfric.population.joint_runs import JointTarget
from tests.axis import AXIS, VALUES, swing
from tests.inference.test_discrepancy import regression

pytestmark = pytest.mark.usefixtures("nothing_explained")

QUICK = {"min_ess": 400, "ensembles": 2, "walkers": 48}
VISCOUS = [0.085, 0.118, 0.101, 0.094]


def recording(number, viscous):
    time = np.arange(0.0, 6.0, 0.005)
    q, qd, qdd = swing(time, [(0.31 + 0.04 * number, 0.9), (0.9, 0.4), (1.9, 0.12)])
    torque = AXIS.torque(VALUES | {"motor.viscous": viscous}, q, qd, qdd)
    noise = 0.1 * np.random.default_rng(number).standard_normal(time.size)
    return bf.Recording.from_arrays(time, q, torque + noise, name=f"day {number}")


def model(vary=("motor.viscous",), count=4, **tables):
    recordings = [recording(k, v) for k, v in enumerate(VISCOUS[:count])]
    tables = {"sampling": QUICK, "noise": "white"} | tables
    return bf.Model(AXIS, recordings, vary=dict.fromkeys(vary, "recording"), **tables)


@pytest.fixture(scope="module")
def pool():
    return bf.pool(model(), seed=1)


def test_each_recordings_value_is_recovered_and_the_others_are_shared(pool):
    assert pool.status == "reliable"
    (viscous,) = pool.varying
    for true, run in zip(VISCOUS, viscous.jointly.runs, strict=True):
        # twice the 90 % interval: four values are looked at
        half = run.high - run.low
        assert abs(run.median - true) < half
    shared = {parameter.name: parameter.value for parameter in pool.shared}
    assert set(shared) == set(AXIS.names) - {"motor.viscous"}
    for name, interval in shared.items():
        assert abs(interval.median - VALUES[name]) < interval.high - interval.low


def test_an_effect_missing_in_all_recordings_does_not_average_out(pool, monkeypatch):
    """A score of one size in each, to either side in all at once; the median stays."""
    score = 400.0

    def discrepancy(target, posterior, _):
        k = len(target.free)
        covariance = np.cov(target.unbounded(posterior.flat())[:, :k].T)
        scores = score * (np.array(target.free) == "offset")
        return Discrepancy(1.0, np.zeros((10, k)), covariance @ scores, covariance)

    monkeypatch.setattr("bayesfric.fit.pooled_fit.discrepancy", discrepancy)
    before, after = (
        {parameter.name: parameter.value for parameter in each.shared}["offset"]
        for each in (pool, bf.pool(model(), seed=1))
    )
    # of two normals 90 % intervals are 3.29 sds wide
    sds = [(interval.high - interval.low) / 3.29 for interval in (before, after)]
    moved = len(VISCOUS) * score * sds[0] ** 2
    assert moved > 2.0 * sds[0]
    assert sds[1] == pytest.approx(np.hypot(sds[0], moved), rel=0.15)
    assert after.median == pytest.approx(before.median, abs=0.1 * sds[1])


@pytest.mark.parametrize("widened", [True, False])
def test_marginalised_effects_are_notes_and_others_are_doubts(widened, monkeypatch):
    """As of a fit: what is marginalised is a note, and only a doubt makes a number doubtful."""
    missing = replace(regression(1.0), kinds={"stribeck": ((0,),)})
    effect = Finding("stribeck", "doubt", 5.0, 0.01, moves={"motor.viscous": 3.0})
    explained = Explanation(findings=(effect,), kinds=("stribeck",), missing=missing)
    monkeypatch.setattr(Model, "explain", lambda *_, **__: explained)

    def discrepancy(target, *_):
        k = len(target.free)
        return Discrepancy(float(widened), np.zeros((1, k)), np.zeros(k), np.eye(k))

    monkeypatch.setattr("bayesfric.fit.pooled_fit.discrepancy", discrepancy)
    pool = bf.pool(model(count=2, sampling=QUICK | {"min_ess": 100}), seed=3)
    assert {finding.severity for finding in pool.findings} == {"note" if widened else "doubt"}
    assert [parameter.findings for parameter in pool.varying] == [() if widened else ("stribeck",)]
    assert pool.outcome == ("usable" if widened else "doubtful")


def test_the_population_mean_is_integrated_exactly():
    """The prior of what varies is the integral over a flat mean of independent normals."""
    target = JointTarget.__new__(JointTarget)
    theta, tau = np.array([0.3, 0.9, 0.4]), 0.35
    target._shared, target.priors = 0, ()
    target._spreads, target._varying = np.array([3]), np.array([[0, 1, 2]])
    target._sds = np.full((1, 3), 0.2)

    def density(t):
        return quad(
            lambda m: np.prod(np.exp(-0.5 * ((theta - m) / t) ** 2) / t), -20.0, 20.0, points=[0.5]
        )[0]

    def reference(t):
        return np.sqrt(3.0 * t**2 / (0.2**2 + t**2) ** 2)

    at = target.log_prior(np.array([[*theta, tau], [*theta, 2.0 * tau]]))
    expected = np.log(density(tau) * reference(tau) / (density(2 * tau) * reference(2 * tau)))
    assert at[0] - at[1] == pytest.approx(expected, rel=1e-6)


def test_the_same_seed_gives_the_same_numbers():
    few = QUICK | {"min_ess": 100}
    first, second = (bf.pool(model(count=2, sampling=few), seed=3) for _ in range(2))
    assert first.varying == second.varying
    assert first.shared == second.shared


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"vary": ()}, "names no parameter that varies"),
        ({"vary": ("motor.viscos",)}, "motor.viscous"),
        ({"vary": ("offset",), "priors": {"offset": 0.0}}, "is fixed"),
        ({"vary": AXIS.names}, "nothing is shared"),
        ({"count": 1}, "one recording is not a population"),
        ({"likelihood": {"method": "output-error"}}, "input-error"),
    ],
)
def test_what_cannot_be_pooled_is_refused(changes, message):
    with pytest.raises(bf.BadInput, match=r"pooling|likelihood|recordings") as error:
        bf.pool(model(**changes))
    assert message in str(error.value)
