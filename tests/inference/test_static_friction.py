"""What rests say: closed forms of the probability, and a friction that only rests tell."""

import numpy as np
import pytest
from scipy import stats

import bayesfric as bf
from bayesfric.inference.likelihood.static_friction import StaticFriction
from bayesfric.mechanism.forward import simulate
from bayesfric.recordings.checks import Rest
from bayesfric.recordings.measurement import Inputs
from tests.axis import AXIS, VALUES

pytestmark = pytest.mark.usefixtures("nothing_explained")

QUICK = {"min_ess": 400, "ensembles": 2, "walkers": 24}


def static(q, torque):
    q, torque = np.atleast_1d(q).astype(float), np.atleast_1d(torque).astype(float)
    return StaticFriction(AXIS, Rest(q, torque, np.zeros(q.size)), Inputs())


def vectors(**changes):
    return np.atleast_2d(AXIS.vector(VALUES | {f"motor.{k}": v for k, v in changes.items()}))


def test_limits_are_gravity_offset_and_friction_to_either_side():
    low, high = static([0.0, 0.4, -1.2], np.zeros(3)).limits(vectors())
    middle = 9.80665 * VALUES["load.first_moment"] * np.sin([0.0, 0.4, -1.2]) + VALUES["offset"]
    assert low[0] == pytest.approx(middle - VALUES["motor.coulomb"], rel=1e-3)
    assert high[0] == pytest.approx(middle + VALUES["motor.coulomb"], rel=1e-3)


@pytest.mark.parametrize("torque", [-0.6, -0.2, 0.05, 0.33, 0.7])
def test_the_probability_is_that_of_a_normal_between_limits(torque):
    one = static(0.0, torque)
    low, high = (x[0, 0] for x in one.limits(vectors()))
    sd = np.array([[0.1]])
    found = one.log_terms(vectors(), stats.norm(scale=sd))
    expected = np.log(stats.norm.cdf((high - torque) / 0.1) - stats.norm.cdf((low - torque) / 0.1))
    assert found[0, 0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_far_outside_nothing_cancels(way):
    """Thirty sds off, either way: the tail's own series, log phi(z) - log z."""
    coulomb = VALUES["motor.coulomb"]
    one = static(0.0, VALUES["offset"] + way * (coulomb + 3.0))
    found = one.log_terms(vectors(), stats.norm(scale=np.array([[0.1]])))[0, 0]
    assert found == pytest.approx(stats.norm.logpdf(30.0) - np.log(30.0), rel=1e-3)


def test_more_static_friction_rests_no_less_probably():
    one = static(np.linspace(-1, 1, 9), np.linspace(-2.5, 2.5, 9))
    rows = np.concatenate([vectors(coulomb=c) for c in np.linspace(0.01, 3.0, 40)])
    noise = stats.norm(scale=np.full((40, 1), 0.2))
    assert (np.diff(one.log_terms(rows, noise).sum(axis=1)) >= -1e-12).all()


def held(**processing):
    """A joint that holds half of the time: a slow torque, up to its limits and beyond."""
    time = np.arange(0.0, 20.0, 1e-3)
    pushed = 1.5 * np.sin(2.0 * np.pi * 0.4 * time) + 0.3 * np.sin(2.0 * np.pi * 1.7 * time)
    motion = simulate(AXIS, AXIS.vector(VALUES | {"motor.coulomb": 1.0}), pushed, 1e-3)
    step = 2.0 * np.pi / 4096
    measured = pushed + 0.02 * np.random.default_rng(5).standard_normal(time.size)
    made = bf.Recording.from_arrays(time, np.round(motion.q / step) * step, measured)
    processing |= {"lowpass": "60 Hz", "decimate": 5}
    return bf.Model(AXIS, made, processing=processing, self_check={"recordings": 0}, sampling=QUICK)


@pytest.fixture(scope="module")
def with_rests():
    return held(rest=True).fit(seed=1)


def test_rests_correct_what_motion_beside_them_gets_wrong(with_rests):
    """Starts and stops are not what filters can follow: motion alone takes friction for less."""
    before, after = (
        r.summary.parameters["motor.coulomb"] for r in (held().fit(seed=1), with_rests)
    )
    assert sum(o.rest.q.size for o in with_rests.fit.observations) > 20
    assert after.interval[0] < 1.0 < after.interval[1]
    assert not before.interval[0] < 1.0 < before.interval[1]


def test_the_density_has_the_rests_as_a_factor(with_rests):
    target = with_rests.fit.target
    values = np.concatenate([vectors(coulomb=c) for c in (0.8, 1.0, 1.2)])
    scales = np.full((3, 1, target.noise.places.shape[1]), 0.05)
    likelihood = target.likelihood
    (one,) = likelihood._static
    plain, moments = likelihood._plain, likelihood.moments.at(values)
    moving = likelihood.noise.log_density(moments, plain.counts, plain.head_counts, scales)
    terms = one.log_terms(values, likelihood.noise.marginal(scales[:, 0]))
    found = likelihood.log_density(values, scales)
    assert found - moving == pytest.approx(terms.sum(axis=1))
    outputs = likelihood.standardised(values, scales[0])[0].shape[1]
    assert outputs == likelihood.outputs[0].measured.size + terms.shape[1]
