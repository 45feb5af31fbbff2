"""Standstill: its probability, the friction it determines, and a law that it contradicts."""

import numpy as np
import pytest
from scipy import stats

import bayesfric as bf
from bayesfric.export.exported import export
from bayesfric.inference.likelihood import StaticFriction
from bayesfric.mechanism.forward import simulate
from bayesfric.recordings.checks import Rest
from bayesfric.recordings.measurement import Inputs
from bayesfric.report.terminal import messages_of
from tests.axis import AXIS, VALUES

pytestmark = pytest.mark.usefixtures("nothing_explained")

QUICK = {"min_ess": 400, "ensembles": 2, "walkers": 24}


def model(recording, **processing):
    tables = {"processing": processing, "self_check": {"recordings": 0}, "sampling": QUICK}
    return bf.Model(AXIS, recording, **tables)


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
    recording = bf.Recording.from_arrays(time, np.round(motion.q / step) * step, measured)
    processing |= {"lowpass": "60 Hz", "decimate": 5}
    return model(recording, **processing)


def test_standstill_corrects_friction_that_motion_alone_underestimates():
    """Starts and stops are not what filters can follow: motion alone takes friction for less."""
    with_standstill = held(rest=True).fit(seed=1)
    before, after = (
        r.summary.parameters["motor.coulomb"] for r in (held().fit(seed=1), with_standstill)
    )
    assert sum(o.rest.q.size for o in with_standstill.fit.observations) > 20
    assert after.interval[0] < 1.0 < after.interval[1]
    assert not before.interval[0] < 1.0 < before.interval[1]


# --- standstills that a law contradicts

T = np.arange(0.0, 9.0, 2e-3)
MOVES = 7.0  # s, then it rests
STEP = 2.0 * np.pi / 8192
COULOMB = VALUES["motor.coulomb"]


def fitted(share, **processing):
    """Move, then rest under gravity's torque and so many times the constant loss."""
    settling = np.clip((T - (MOVES - 1.0)) / 1.0, 0.0, 1.0)
    envelope = 0.5 * (1.0 + np.cos(np.pi * settling))
    swing = 0.9 * np.sin(2 * np.pi * 0.4 * T) + 0.3 * np.sin(2 * np.pi * 1.1 * T + 1)
    q = 0.4 + swing * envelope
    speed = np.gradient(q, T)
    acceleration = np.gradient(speed, T)
    torque = AXIS.torque(VALUES, q, speed, acceleration)
    gravity = AXIS.torque(VALUES | {"motor.coulomb": 0.0}, 0.4, 0.0, 0.0)[0]
    torque = np.where(T < MOVES, torque, gravity + share * COULOMB)
    torque += 0.01 * np.random.default_rng(6).standard_normal(T.size)
    recording = bf.Recording.from_arrays(T, np.round(q / STEP) * STEP, torque, name="bench")
    return model(recording, **processing).fit(seed=1)


def messages(result):
    return [message.text for message in messages_of(result.summary) if message.kind == "rests"]


def static_friction(folder, form="isaac", name="friction"):
    rows = export(folder, form).record["numbers"]
    return next(row for row in rows if row["attribute"] == name)


def test_standstills_within_the_law_are_no_violation(tmp_path):
    result = fitted(0.9)
    assert (result.summary.fit.rests, messages(result)) == ([], [])
    result.write(tmp_path / "run", draws=200)
    row = static_friction(tmp_path / "run")
    # of standstill only the constant loss is known, and it is no limit
    assert not row["at_least"]
    assert row["value"] == pytest.approx(COULOMB, rel=0.1)


@pytest.mark.parametrize("share", [1.6, -1.6])
def test_standstills_beyond_the_law_bound_static_friction(tmp_path, share):
    result = fitted(share)
    (violation,) = result.summary.fit.rests
    assert violation["recording"] == "bench"
    assert violation["share"] > 0.9
    assert MOVES - 0.3 < violation["start"] < violation["stop"] < T[-1]
    # up to the noise and what is unknown
    assert violation["beyond"] == pytest.approx((abs(share) - 1.0) * COULOMB, rel=0.15)
    assert violation["held"] == pytest.approx(abs(share) * COULOMB, rel=0.1)
    (text,) = messages(result)
    assert "rest = true under [processing]" in text
    result.write(tmp_path / "run", draws=200)
    assert "sticks less than yours" in export(tmp_path / "run", "mujoco").text()
    places = {"isaac": "friction", "ros2-control": "friction.static", "csv": "static_friction"}
    for form, name in (places | {"c": "about: static_friction"}).items():
        row = static_friction(tmp_path / "run", form, name)
        assert (row["at_least"], row["interval"]) == (True, None)
        assert row["value"] == pytest.approx(violation["held"], rel=0.02)


def test_a_fit_that_uses_its_standstills_is_not_checked():
    assert fitted(1.6, rest=True).summary.fit.rests == []
