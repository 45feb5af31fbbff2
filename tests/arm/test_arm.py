"""A simulated arm, its joints fitted in addition to a URDF that is not quite right."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayesfric.arm.arm import Arm, remarks
from bayesfric.arm.arm_columns import layout_of
from bayesfric.arm.arm_log import ArmLog
from bayesfric.arm.arm_options import Repeatability
from bayesfric.arm.departures import coupled_joint
from bayesfric.arm.exports import files_of
from bayesfric.arm.inertial_prior import UrdfJoint
from bayesfric.base.errors import BadInput
from tests.commands.bench import Bench
from tests.conftest import DATA, REPOSITORY, imported, made_recording

from . import bench
from .bench import ELBOW, SHOULDER

pytestmark = pytest.mark.usefixtures("unexplained", "here")

QUICK = {"terms": "as written", "fit": {"self_check": {"recordings": 0}}}
KEYS = ("motor.inertia", "motor.coulomb", "motor.viscous", "motor.load")
TRUTH = {
    SHOULDER: dict(zip(KEYS, (1.2, 5.0, 4.0, 0.15), strict=True)),
    ELBOW: dict(zip(KEYS, (0.4, 2.0, 1.5, 0.1), strict=True)),
}


@pytest.fixture
def here(tmp_path, monkeypatch, capfd):
    """A folder with a URDF and a log, and the command, which tries few motions."""
    monkeypatch.setattr("bayesfric.arm.excitation._TRIES", 100)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(bench.urdf())
    return Bench(tmp_path, monkeypatch, capfd)


def record(change=lambda frame: frame, name="log", factors=None, **options):
    """Write a log in the current folder."""
    frame = change(bench.log(bench.urdf(factors or {}), TRUTH, **options))
    frame.to_csv(f"{name}.csv", index=False)


def test_a_body_that_is_far_off_departs_from_the_urdf():
    """As two joints show it, by another scale of efforts or by its width: neither is identified."""
    record(factors={"lower": 2.0})
    arm = Arm("arm.urdf", {**QUICK, "payload": {"mass_sd": "0.1 kg"}}).fit("log.csv", seed=1)
    assert arm.departures.changes
    coulomb = {name: x.rows["motor.coulomb"].reported for name, x in arm.joints.items()}
    statuses = {row.status for row in coulomb.values()}
    assert arm.inertial_estimate["p"] < 0.01 or statuses == {"doubtful"}
    for name, row in coulomb.items():  # whichever it is
        assert row.interval[0] < TRUTH[name]["motor.coulomb"] < row.interval[1]


@pytest.mark.parametrize(("factor", "loaded"), [(1.0, True), (1e-6, False)])
def test_friction_by_a_load_that_the_log_does_not_resolve_is_left_out(factor, loaded):
    """Bodies of milligrams load their joints with less than the noise of 0.3 N m lets resolve."""
    factors = dict.fromkeys(bench.LINKS, factor)
    Path("arm.urdf").write_text(bench.urdf(factors))
    record(factors=factors)
    _, models, _ = Arm("arm.urdf", QUICK).prepared([Path("log.csv")])
    assert {"motor.load" in model.chain.names for model in models.values()} == {loaded}


def test_a_payload_in_one_of_two_logs_is_weighed():
    """Two kilograms in addition to a tool of one; the mass within three of its sds."""
    for name, factor in (("bare", 1.0), ("loaded", 3.0)):
        record(name=name, factors={"tool": factor}, seconds=10.0)
    logs = ["bare.csv", "loaded.csv"]
    payload = {"logs": ["loaded"], "mass_sd": "2 kg"}
    urdf = {"factor": 0.01, "centre": "1 mm"}
    options = {**QUICK, "urdf": urdf, "payload": payload, "samples": 3000}
    arm = Arm("arm.urdf", options).fit(logs, seed=1)
    assert [log.fitted for log in arm.logs] == [1500, 1500]
    assert arm.as_json()["samples"] == {"fitted": 3000, "of": 4000}
    assert set(arm.consistency.agreed) == set(TRUTH)
    causes = arm.inertial_estimate["causes"]
    mass = next(cause for cause in causes if cause["name"] == "payload of tool")
    assert mass["sd"] < 0.3
    assert abs(mass["value"] - 2.0) < 3.0 * mass["sd"]
    with pytest.raises(BadInput, match=r"payload\.logs"):
        Arm("arm.urdf", {"payload": {"logs": ["load"]}}).fit(logs)


def test_a_late_log_and_wrong_drive_gains_with_a_known_payload():
    """Efforts 8 ms early, and 12 and 6 % low: numbers within 3.3 sds, of which none in 1000 is."""
    gains, late = {SHOULDER: 1.12, ELBOW: 1.06}, 0.008

    def wrong(frame):
        time = frame["time [s]"]
        for name, gain in gains.items():
            effort = frame[f"effort[{name}] [N m]"]
            frame[f"effort[{name}] [N m]"] = np.interp(time + late, time, effort / gain)
        return frame

    for name, factor in (("bare", 1.0), ("loaded", 3.0)):
        record(wrong, name=name, factors={"tool": factor}, seconds=10.0)
    payload = {"logs": ["loaded"], "mass": 2.0, "mass_sd": "20 g"}
    arm = Arm("arm.urdf", {**QUICK, "payload": payload, "gain": 0.1})
    fitted = arm.fit(["bare.csv", "loaded.csv"], seed=1)
    assert fitted.late.evident
    assert abs(fitted.late.value - late) < 3.3 * fitted.late.sd < 0.002
    assert fitted.joints[SHOULDER].rows["drive.gain"].reported.sd < 0.02
    for name, truth in TRUTH.items():
        for key, value in {**truth, "drive.gain": gains[name]}.items():
            row = fitted.joints[name].rows[key].reported
            assert abs(row.value - value) < 3.3 * row.sd, (name, key)


MOTORS = np.array([[1.0, 0.0], [1.0, 1.0]])


@pytest.mark.parametrize("ratio", [0.0, 1.0, -0.6])
def test_a_motor_that_turns_with_two_joints_is_named(monkeypatch, ratio):
    """Within 3 % of its ratio, and none where each motor turns with its joint alone."""
    motors, results = np.array([[1.0, 0.0], [ratio, 1.0]]), {}
    record(factors=bench.FACTORS, motors=motors)

    def searched(*arguments):
        results[arguments[3]] = coupled_joint(*arguments)

    def refused(*_, **__):
        raise BadInput("the fit", "is not needed", "")

    monkeypatch.setattr("bayesfric.arm.arm.coupled_joint", searched)
    monkeypatch.setattr("bayesfric.arm.arm.Model.fit", refused)
    with pytest.raises(BadInput, match="not needed"):
        Arm("arm.urdf", QUICK).fit("log.csv")
    assert results[SHOULDER] is None
    if ratio:
        other, fitted, *_ = results[ELBOW]
        assert other == SHOULDER
        assert fitted == pytest.approx(ratio, rel=0.03)
    else:
        assert results[ELBOW] is None


def test_coupled_joints_have_the_friction_of_their_motors(here):
    """Within 3.3 sds; the feed-forward takes the motion of joints, and leaves the noise of 0.3."""
    record(factors=bench.FACTORS, motors=MOTORS)
    coupling = {"joints": [SHOULDER, ELBOW], "matrix": MOTORS.tolist()}
    arm = Arm("arm.urdf", {**QUICK, "coupling": coupling}).fit("log.csv", seed=1)
    for name, truth in TRUTH.items():
        for key, value in truth.items():
            row = arm.joints[name].rows[key].reported
            assert abs(row.value - value) < 3.3 * row.sd, (name, key)
    for name, text in files_of(arm).items():
        (here.folder / name).write_text(text)
    feedforward = imported(here.folder / "feedforward.py")
    _, *motion = bench.motion(20.0)
    effort = pd.read_csv("log.csv")[[f"effort[{name}] [N m]" for name in TRUTH]].to_numpy()
    torque = np.array([feedforward.torque(*x) for x in np.swapaxes(motion, 0, 1)[::10]])
    assert np.sqrt(np.mean((torque - effort[::10]) ** 2, axis=0)) == pytest.approx(0.3, rel=0.15)


def test_a_joint_without_effort_does_not_spoil_another(here):
    """The command, from init to the page."""
    record(lambda frame: frame.assign(**{f"effort[{SHOULDER}] [N m]": 0.0}), seconds=10.0)
    here.run("init", "arm", "--from", "log.csv", "--urdf", "arm.urdf", "-o", "arm.toml")
    text = (here.folder / "arm.toml").read_text()
    quick = f"{text}\ngear_ratio = 50\n[fit.self_check]\nrecordings = 0\n"
    (here.folder / "arm.toml").write_text(quick)
    words = ("arm.urdf", "log.csv", "-o", "out", "--config", "arm.toml", "--seed", "1")
    options = f"--export --rollout 1 --advise --wanted {ELBOW}.viscous --seconds 5".split()
    result = here.run("arm", *words, *options)
    assert result.code == 0, result
    files = {path.name for path in (here.folder / "out").iterdir()}
    assert {"identified-arm.urdf", "robot.xml", "rollout.csv", "exciting.csv"} <= files
    assert len(result.out.splitlines()) <= 30
    joints = json.loads((here.folder / "out" / "arm.json").read_text())["joints"]
    assert "effort" in joints[SHOULDER]["why"]
    armature = joints[ELBOW]["parameters"]["motor.inertia"]["value"]
    assert joints[ELBOW]["rotor_inertia"] == pytest.approx(armature / 50**2)
    assert ELBOW in (here.folder / "out" / "arm.html").read_text()
    # the joint's folder is a run directory
    assert here.run("report", f"out/{ELBOW}").code == 0


def test_a_constant_position_is_the_reason_why_a_joint_is_not_fitted():
    record(lambda frame: frame.assign(**{f"position[{SHOULDER}] [rad]": 0.5}), seconds=5.0)
    options = {**QUICK, "joints": {ELBOW: {"fit": False}}}
    with pytest.raises(BadInput, match=r"position is 0\.5 in every sample"):
        Arm("arm.urdf", options).fit("log.csv")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({f"[{SHOULDER}]": "[hip]"}, f"joint '{SHOULDER}'"),
        ({f"[{SHOULDER}]": "[a]", f"[{ELBOW}]": "[b]"}, "arm.toml"),
        ({"time [s]": None}, "time"),
    ],
)
def test_a_log_that_does_not_match_the_urdf_is_refused(here, changes, message):
    def renamed(frame):
        for old, new in changes.items():
            if new is None:
                return frame.drop(columns=old)
            frame.columns = [name.replace(old, new) for name in frame.columns]
        return frame

    record(renamed, seconds=3.0)
    assert message in here.refused("arm", "arm.urdf", "log.csv", "-o", "out")


def test_columns_follow_patterns_and_currents_drive_gains(here):
    def numbered(frame):
        names = ["t", "q_1", "i_1", "q_2", "i_2"]
        return frame.set_axis(names, axis=1).assign(i_2=lambda f: f["i_2"] / 12.5)

    record(numbered, seconds=3.0)
    current = {"column": "i_{number}", "unit": "A", "torque_constant": "{torque_constant}"}
    options = {
        "recording": {
            "time": {"column": "t", "unit": "s"},
            "position": {"column": "q_{number}", "unit": "rad"},
            "current": current,
        },
        "joints": {
            SHOULDER: {"torque_constant": "1 N m/A"},
            ELBOW: {"torque_constant": "12.5 N m/A"},
        },
    }
    arm = Arm("arm.urdf", options)
    layout, _ = layout_of(here.folder / "log.csv", arm.bodies.joints, arm.options)
    log = ArmLog(here.folder / "log.csv", "log", arm.options, layout, arm.bodies.joints, 600)
    expected = bench.log(bench.urdf(), TRUTH, seconds=3.0)[f"effort[{ELBOW}] [N m]"]
    torque = log.measured(arm.bodies.joints[ELBOW]).torque
    np.testing.assert_allclose(torque, expected, rtol=1e-9)
    del options["joints"][ELBOW]
    with pytest.raises(BadInput, match=rf"joints\.{ELBOW}\.torque_constant"):
        Arm("arm.urdf", options).fit("log.csv")


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("span", [{}, {"start": "5 s", "stop": "17 s"}])
def test_segments_of_a_long_log_are_fitted(here, timed, span):
    record()
    clock = {"time": {"column": "time [s]", "unit": "s"}} if timed else {"rate": "200 Hz"}
    position = {"column": "position[{joint}] [rad]", "unit": "rad"}
    torque = {"column": "effort[{joint}] [N m]", "unit": "N m"}
    recording = {**clock, "position": position, "torque": torque, **span}
    arm = Arm("arm.urdf", {"recording": recording})
    joint = arm.bodies.joints[ELBOW]
    layout, _ = layout_of(here.folder / "log.csv", arm.bodies.joints, arm.options)
    full, reduced = (
        ArmLog(here.folder / "log.csv", "log", arm.options, layout, arm.bodies.joints, size)
        for size in (4000, 2000)
    )
    assert full.fitted == full.rows == reduced.rows == 4000
    assert 2000 <= reduced.fitted <= 2001
    # two of 1000 samples, at both ends of the span
    assert np.count_nonzero(np.diff(reduced.time) > 0.0051) == 1
    assert (reduced.time[0], reduced.time[-1]) == pytest.approx((full.time[0], full.time[-1]))
    at = np.searchsorted(full.time, reduced.time - 1e-6)
    for name in ("time", "position", "torque"):
        values, expected = (getattr(log.measured(joint), name) for log in (reduced, full))
        np.testing.assert_allclose(values, expected[at], atol=1e-9)
    # added columns are at the stamps of their rows
    table = reduced.recording(joint, np.sin(full.time)[None, at]).table
    stamps = table.column("time [s]" if timed else "stamps in s")
    rows = stamps >= reduced.time[0]
    added = table.column("urdf_torque")
    np.testing.assert_allclose(added[rows], np.sin(stamps[rows]), atol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"joints": {"shoulder": {"fit": False}}}, f"did you mean '{SHOULDER}'|{SHOULDER}"),
        ({"joints": {SHOULDER: {"rotor_inertia": 1e-4}}}, "gear_ratio"),
        ({"payload": {"mass": -1.0}}, r"payload\.mass"),
        ({"recording": {"position": {"column": "q"}}}, "recording"),
    ],
)
def test_wrong_options_are_refused(options, message):
    record(seconds=3.0)
    with pytest.raises(BadInput, match=message):
        Arm("arm.urdf", options).fit("log.csv")


def test_positions_beyond_the_limits_of_the_urdf_are_remarked():
    time = np.arange(0.0, 10.0, 0.01)
    joint = UrdfJoint("elbow", "rotary", low=-3.0, high=3.0)
    for degrees in (1.0, 57.3):
        recording = made_recording(time, degrees * np.sin(time), np.cos(time), 0.01)
        assert len([*remarks(joint, recording)]) == (degrees > 1.0)


@pytest.mark.skipif(not DATA.is_dir(), reason=f"the real recordings are not at {DATA}")
def test_one_motion_of_a_measured_ur10_predicts_another(tmp_path):
    """Petrone et al. 2025: better than least squares on the URDF's torque and friction."""
    study = imported(REPOSITORY / "studies" / "ur10-arm" / "run.py")
    study.validation_log(tmp_path / "other.csv")
    outcomes, _ = study.compared(study.LOG, tmp_path / "other.csv", ["elbow_joint"])
    result = outcomes["elbow_joint"]
    assert result["separate"]["rms"] < result["least squares"]["rms"]


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason=f"the real recordings are not at {DATA}")
def test_the_feedforward_of_a_measured_ur10_is_what_was_predicted(tmp_path):
    """Each joint within one per cent on the motion held out, bodies of separate fits included."""
    study = imported(REPOSITORY / "studies" / "ur10-arm" / "run.py")
    study.validation_log(tmp_path / "other.csv")
    _, fitted = study.compared(study.LOG, tmp_path / "other.csv")
    rms = bench.held_out_rms(fitted, tmp_path)
    assert len(rms) == 6
    for name, (exported, predicted) in rms.items():
        assert exported == pytest.approx(predicted, rel=0.01), name


@pytest.mark.parametrize("friction", [{}, {"stribeck": True, "quadratic": True}])
def test_the_feedforward_of_a_joint_of_a_separate_fit_is_what_was_predicted(here, friction):
    """The elbow excluded, as one that contradicts two others would be; terms that it has not."""
    for name, options in (("log", {}), ("other", {"seed": 2, "faster": 1.3})):
        record(name=name, factors=bench.FACTORS, **options)
    options = {**QUICK, "friction": friction}
    arm = Arm("arm.urdf", options).fit("log.csv", predict="other.csv", seed=1)
    # bands whose efforts differ by a half: its variance is added, about the same mean
    for joint in arm.joints.values():
        wide, exact = (
            replace(joint, repeatability=Repeatability(friction=0.0, effort=effort))
            .updated(arm.consistency, np.random.default_rng(1))
            .validation["pooled"]
            for effort in (0.5, 0.0)
        )
        added = 0.5 * np.sqrt(np.mean(joint.fitted.model.held_out[0].observation.measured ** 2))
        expected = np.hypot(exact["predictive_sd"], added)
        assert wide["predictive_sd"] == pytest.approx(expected, rel=0.02)
        assert wide["residual_rms"] == pytest.approx(exact["residual_rms"], rel=1e-9)
    consistency, rng = replace(arm.consistency, agreed=(SHOULDER,)), np.random.default_rng(1)
    joints = {name: joint.updated(consistency, rng) for name, joint in arm.joints.items()}
    arm = replace(arm, joints=joints, consistency=consistency)
    assert [arm.joints[name].by_all for name in TRUTH] == [True, False]
    for name, (exported, predicted) in bench.held_out_rms(arm, here.folder).items():
        _, left, size = arm.joints[name].feedforward()
        assert (left > 1e-6 * size) == bool(friction)
        # a faster motion may need more of what is left out
        assert exported == pytest.approx(predicted, rel=0.01, abs=2.0 * left), name
