"""What rests say: closed forms of the probability, and a friction that only rests tell."""

import numpy as np
import pytest
from scipy import stats

import bayesfric as bf
from bayesfric.inference.likelihood import StaticFriction
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


@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_far_outside_nothing_cancels(way):
    """Thirty sds off, either way: the tail's own series, log phi(z) - log z."""
    coulomb = VALUES["motor.coulomb"]
    standstill = static(0.0, VALUES["offset"] + way * (coulomb + 3.0))
    log_probability = standstill.log_terms(vectors(), stats.norm(scale=np.array([[0.1]])))[0, 0]
    assert log_probability == pytest.approx(stats.norm.logpdf(30.0) - np.log(30.0), rel=1e-3)


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


def test_rests_correct_what_motion_beside_them_gets_wrong():
    """Starts and stops are not what filters can follow: motion alone takes friction for less."""
    with_rests = held(rest=True).fit(seed=1)
    before, after = (
        r.summary.parameters["motor.coulomb"] for r in (held().fit(seed=1), with_rests)
    )
    assert sum(o.rest.q.size for o in with_rests.fit.observations) > 20
    assert after.interval[0] < 1.0 < after.interval[1]
    assert not before.interval[0] < 1.0 < before.interval[1]
