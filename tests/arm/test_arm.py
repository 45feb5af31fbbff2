"""A simulated arm, its joints fitted one by one beside a URDF that is not quite right."""

import json

import numpy as np
import pytest

from bayesfric.arm.arm import Arm, remarks
from bayesfric.arm.arm_log import ArmLog, Layout
from bayesfric.arm.inertial_prior import UrdfJoint
from bayesfric.base.errors import BadInput
from tests.commands.bench import Bench
from tests.conftest import DATA, made_recording

from . import bench
from .bench import ELBOW, SHOULDER

pytestmark = pytest.mark.usefixtures("unexplained")

# Less of what is not asked here.
QUICK = {"terms": "as written", "fit": {"self_check": {"recordings": 0}}}
TRUTH = {
    SHOULDER: {
        "motor.inertia": 1.2,
        "motor.coulomb": 5.0,
        "motor.viscous": 4.0,
        "motor.load": 0.15,
    },
    ELBOW: {"motor.inertia": 0.4, "motor.coulomb": 2.0, "motor.viscous": 1.5, "motor.load": 0.1},
}


@pytest.fixture
def here(tmp_path, monkeypatch, capfd):
    """A folder with a URDF and a log, and the command, which tries few motions."""
    monkeypatch.setattr("bayesfric.arm.excitation._TRIES", 100)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(bench.urdf())
    return Bench(tmp_path, monkeypatch, capfd)


def recorded(folder, change=lambda frame: frame, **more):
    change(bench.log(bench.urdf(), TRUTH, **more)).to_csv(folder / "log.csv", index=False)


def test_a_body_that_is_far_off_contradicts_the_urdf(here):
    bench.log(bench.urdf({"lower": 2.0}), TRUTH).to_csv(here.folder / "log.csv", index=False)
    options = {**QUICK, "joints": {SHOULDER: {"fit": False}}, "payload": {"mass_sd": "0.1 kg"}}
    found = (
        Arm(here.folder / "arm.urdf", options)
        .fit(here.folder / "log.csv", seed=1)
        .inertial_estimate
    )
    assert found["p"] < 0.01
    assert max(found["causes"][:3], key=lambda cause: cause["value"])["value"] > 0.0


def test_a_payload_that_is_on_for_one_of_two_logs_is_weighed(here):
    """Two kilograms beside a tool that weighs one; the mass within three of its sds."""
    for name, factor in (("bare", 1.0), ("loaded", 3.0)):
        frame = bench.log(bench.urdf({"tool": factor}), TRUTH, seconds=10.0)
        frame.to_csv(here.folder / f"{name}.csv", index=False)
    logs = [here.folder / "bare.csv", here.folder / "loaded.csv"]
    known = {"urdf": {"factor": 0.01, "centre": "1 mm"}}
    payload = {"logs": ["loaded"], "mass_sd": "2 kg"}
    options = {**QUICK, **known, "payload": payload, "samples": 3000}
    found = Arm(here.folder / "arm.urdf", options).fit(logs, seed=1)
    assert [one.fitted for one in found.logs] == [1500, 1500]
    assert found.as_json()["samples"] == {"fitted": 3000, "of": 4000}
    assert set(found.consistency.agreed) == set(TRUTH)
    told = next(c for c in found.inertial_estimate["causes"] if c["name"] == "payload of tool")
    assert told["sd"] < 0.3
    assert abs(told["value"] - 2.0) < 3.0 * told["sd"]
    with pytest.raises(BadInput, match=r"payload\.logs"):
        Arm(here.folder / "arm.urdf", {"payload": {"logs": ["load"]}}).fit(logs)


def test_what_one_joint_lacks_does_not_spoil_another(here):
    """The command, from init to the page: the shoulder's effort is a constant."""

    def silent(frame):
        frame[f"effort[{SHOULDER}] [N m]"] = 0.0
        return frame

    recorded(here.folder, silent, seconds=10.0)
    here.run("init", "arm", "--from", "log.csv", "--urdf", "arm.urdf", "-o", "arm.toml")
    text = (here.folder / "arm.toml").read_text()
    quick = f"{text}\ngear_ratio = 50\n[fit.self_check]\nrecordings = 0\n"
    (here.folder / "arm.toml").write_text(quick)
    given = ("arm.urdf", "log.csv", "-o", "out", "--config", "arm.toml", "--seed", "1")
    more = f"--export --rollout 1 --advise --wanted {ELBOW}.viscous --seconds 5".split()
    ended = here.run("arm", *given, *more)
    assert ended.code == 0, ended
    made = {path.name for path in (here.folder / "out").iterdir()}
    assert {"identified-arm.urdf", "robot.xml", "rollout.csv", "exciting.csv"} <= made
    assert len(ended.out.splitlines()) <= 30
    told = json.loads((here.folder / "out" / "arm.json").read_text())["joints"]
    assert "effort" in told[SHOULDER]["why"]
    armature = told[ELBOW]["parameters"]["motor.inertia"]["value"]
    assert told[ELBOW]["rotor_inertia"] == pytest.approx(armature / 50**2)
    assert ELBOW in (here.folder / "out" / "arm.html").read_text()
    # the joint's folder is a run of its own
    assert here.run("report", f"out/{ELBOW}").code == 0


def test_a_joint_that_stands_still_is_said_and_carried_along(here):
    def still(frame):
        frame[f"position[{SHOULDER}] [rad]"] = 0.5
        return frame

    recorded(here.folder, still, seconds=5.0)
    options = {**QUICK, "joints": {ELBOW: {"fit": False}}}
    with pytest.raises(BadInput, match=r"position is 0\.5 in every sample"):
        Arm(here.folder / "arm.urdf", options).fit(here.folder / "log.csv")


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (f"[{SHOULDER}]", "[hip]", f"joint '{SHOULDER}'"),
        ("[shoulder_joint]", "[a]", "arm.toml"),
        ("time [s]", "clock", "log.csv"),
    ],
)
def test_a_log_that_does_not_go_with_the_urdf_is_refused(here, old, new, told):
    def renamed(frame):
        frame.columns = [name.replace(old, new) for name in frame.columns]
        if new == "[a]":
            frame.columns = [name.replace(f"[{ELBOW}]", "[b]") for name in frame.columns]
        return frame

    recorded(here.folder, renamed, seconds=3.0)
    line = here.refused("arm", "arm.urdf", "log.csv", "-o", "out")
    assert told in line


def test_columns_go_by_patterns_and_currents_by_drive_gains(here):
    def numbered(frame):
        names = ["t", "q_1", "i_1", "q_2", "i_2"]
        return frame.set_axis(names, axis=1).assign(i_2=lambda f: f["i_2"] / 12.5)

    recorded(here.folder, numbered, seconds=3.0)
    options = {
        "recording": {
            "time": {"column": "t", "unit": "s"},
            "position": {"column": "q_{number}", "unit": "rad"},
            "current": {
                "column": "i_{number}",
                "unit": "A",
                "torque_constant": "{torque_constant}",
            },
        },
        "joints": {
            SHOULDER: {"torque_constant": "1 N m/A"},
            ELBOW: {"torque_constant": "12.5 N m/A"},
        },
    }
    arm = Arm(here.folder / "arm.urdf", options)
    layout = Layout(arm.options.recording, {})
    made = ArmLog(here.folder / "log.csv", "log", arm.options, layout, arm.bodies.joints, 600)
    expected = bench.log(bench.urdf(), TRUTH, seconds=3.0)[f"effort[{ELBOW}] [N m]"]
    found = made.measured(arm.bodies.joints[ELBOW]).torque
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    del options["joints"][ELBOW]
    with pytest.raises(BadInput, match=rf"joints\.{ELBOW}\.torque_constant"):
        Arm(here.folder / "arm.urdf", options).fit(here.folder / "log.csv")


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("span", [{}, {"start": "5 s", "stop": "17 s"}])
def test_of_a_long_log_stretches_are_fitted(here, timed, span):
    recorded(here.folder)
    clock = {"time": {"column": "time [s]", "unit": "s"}} if timed else {"rate": "200 Hz"}
    position = {"column": "position[{joint}] [rad]", "unit": "rad"}
    torque = {"column": "effort[{joint}] [N m]", "unit": "N m"}
    recording = {**clock, "position": position, "torque": torque, **span}
    arm = Arm(here.folder / "arm.urdf", {"recording": recording})
    told = here.folder / "log.csv", "log", arm.options, Layout(arm.options.recording, {})
    joint = arm.bodies.joints[ELBOW]
    whole, some = (ArmLog(*told, arm.bodies.joints, most) for most in (4000, 2000))
    assert whole.fitted == whole.rows == some.rows == 4000
    assert 2000 <= some.fitted <= 2001
    # two of 1000 samples, at both ends of what is asked for
    assert np.count_nonzero(np.diff(some.time) > 0.0051) == 1
    assert (some.time[0], some.time[-1]) == pytest.approx((whole.time[0], whole.time[-1]))
    at = np.searchsorted(whole.time, some.time - 1e-6)
    for name in ("time", "position", "torque"):
        found, expected = (getattr(one.measured(joint), name) for one in (some, whole))
        np.testing.assert_allclose(found, expected[at], atol=1e-9)
    # what is put beside the columns of a stretch stands where it was
    carried = np.sin(whole.time)[None]
    table = some.recording(joint, carried[:, at]).table
    stamps = table.column("time [s]" if timed else "time")
    kept = stamps >= some.time[0]
    found = table.column("urdf_torque")
    np.testing.assert_allclose(found[kept], np.sin(stamps[kept]), atol=1e-9)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"joints": {"shoulder": {"fit": False}}}, f"did you mean '{SHOULDER}'|{SHOULDER}"),
        ({"joints": {SHOULDER: {"rotor_inertia": 1e-4}}}, "gear_ratio"),
        ({"payload": {"mass": -1.0}}, r"payload\.mass"),
        ({"recording": {"position": {"column": "q"}}}, "recording"),
    ],
)
def test_options_that_cannot_be_are_refused(here, options, told):
    recorded(here.folder, seconds=3.0)
    with pytest.raises(BadInput, match=told):
        Arm(here.folder / "arm.urdf", options).fit(here.folder / "log.csv")


@pytest.mark.parametrize(
    ("factor", "degrees", "said"),
    [(1.0, 1.0, None), (-1.0, 1.0, "sign"), (0.08, 1.0, "drive gain"), (1.0, 57.3, "unit")],
)
def test_what_the_bodies_contradict_is_said(factor, degrees, said):
    time = np.arange(0.0, 10.0, 0.01)
    position = degrees * np.sin(time)
    urdf = 20.0 * np.cos(2.0 * time)
    joint = UrdfJoint("elbow", "rotary", 6.0, None)
    effort = factor * urdf + 0.1 * np.sign(np.cos(time))
    found = [*remarks(joint, made_recording(time, position, effort, 0.01), urdf)]
    assert (len(found) == 1 and said in found[0]) if said else not found


@pytest.mark.skipif(not DATA.is_dir(), reason=f"the real recordings are not at {DATA}")
def test_one_motion_of_a_measured_ur10_predicts_another(tmp_path):
    """Petrone et al. 2025: better than least squares on the URDF's torque and friction."""
    from tests.conftest import REPOSITORY, imported

    study = imported(REPOSITORY / "studies" / "ur10-arm" / "run.py")
    found = study.compared(tmp_path, joints=["elbow_joint"])[0]["elbow_joint"]
    assert found["arm"]["rms"] < found["least squares"]["rms"]
