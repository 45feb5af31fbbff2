"""A joint that stood still under a torque its law would not hold is told; one that could is not."""

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.export.exported import export
from bayesfric.report.terminal import messages_of
from tests.axis import AXIS, VALUES

pytestmark = pytest.mark.usefixtures("nothing_explained")

QUICK = {"min_ess": 400, "ensembles": 2, "walkers": 24}
T = np.arange(0.0, 9.0, 2e-3)
MOVES = 7.0  # s, then it rests
STEP = 2.0 * np.pi / 8192
COULOMB = VALUES["motor.coulomb"]


def fitted(held, **processing):
    """Move, then rest under gravity's torque and so many times the constant loss."""
    settling = np.clip((T - (MOVES - 1.0)) / 1.0, 0.0, 1.0)
    envelope = 0.5 * (1.0 + np.cos(np.pi * settling))
    swing = 0.9 * np.sin(2 * np.pi * 0.4 * T) + 0.3 * np.sin(2 * np.pi * 1.1 * T + 1)
    q = 0.4 + swing * envelope
    speed = np.gradient(q, T)
    acceleration = np.gradient(speed, T)
    torque = AXIS.torque(VALUES, q, speed, acceleration)
    gravity = AXIS.torque(VALUES | {"motor.coulomb": 0.0}, 0.4, 0.0, 0.0)[0]
    torque = np.where(T < MOVES, torque, gravity + held * COULOMB)
    torque += 0.01 * np.random.default_rng(6).standard_normal(T.size)
    one = bf.Recording.from_arrays(T, np.round(q / STEP) * STEP, torque, name="bench")
    model = bf.Model(AXIS, one, processing=processing, self_check={"recordings": 0}, sampling=QUICK)
    return model.fit(seed=1)


def told(result):
    return [a.text for a in messages_of(result.summary) if a.kind == "rests"]


def static_friction(folder, form="isaac", name="friction"):
    rows = export(folder, form).record["numbers"]
    return next(row for row in rows if row["attribute"] == name)


def test_a_law_that_holds_its_rests_is_not_spoken_of(tmp_path):
    found = fitted(0.9)
    assert found.summary.fit.rests == []
    assert told(found) == []
    found.write(tmp_path / "run", draws=200)
    row = static_friction(tmp_path / "run")
    # nothing but the constant loss is known of standstill, and it is no limit
    assert not row["at_least"]
    assert row["value"] == pytest.approx(COULOMB, rel=0.1)


@pytest.mark.parametrize("held", [1.6, -1.6])
def test_rests_that_the_law_would_leave_are_told_with_what_to_do(tmp_path, held):
    found = fitted(held)
    (one,) = found.summary.fit.rests
    assert one.recording == "bench"
    assert one.share > 0.9
    assert MOVES - 0.3 < one.start < one.stop < T[-1]
    # beyond by what is more than the constant loss, give or take the noise and what is unknown
    assert one.beyond == pytest.approx((abs(held) - 1.0) * COULOMB, rel=0.15)
    (text,) = told(found)
    assert "rest = true under [processing]" in text
    found.write(tmp_path / "run", draws=200)
    assert "sticks less than yours" in export(tmp_path / "run", "mujoco").text()
    # what held it is a limit of static friction, in every format that has a place for it
    assert one.held == pytest.approx(abs(held) * COULOMB, rel=0.1)
    places = {"isaac": "friction", "ros2-control": "friction.static", "csv": "static_friction"}
    for form, name in (places | {"c": "about: static_friction"}).items():
        row = static_friction(tmp_path / "run", form, name)
        assert (row["at_least"], row["interval"]) == (True, None)
        assert row["value"] == pytest.approx(one.held, rel=0.02)
    said = export(tmp_path / "run", "isaac")
    assert f"staticFrictionEffort = {one.held:.3f}"[:-1] in said.files["joint.usda"]
    assert "friction: at least 0." in said.main


def test_a_fit_that_uses_its_rests_is_not_asked():
    assert fitted(1.6, rest=True).summary.fit.rests == []
