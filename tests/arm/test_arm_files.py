"""Files of an identified arm, read back by iDynTree, by MuJoCo, by YAML and by Python."""

import importlib.util
import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from bayesfric.arm.arm_options import Payload, Uncertainty
from bayesfric.arm.exports import (
    Identified,
    written_mjcf,
    written_python,
    written_ros2_control,
    written_urdf,
)
from bayesfric.arm.inertial_prior import Bodies
from bayesfric.base.errors import BadInput
from tests.conftest import DATA

from . import bench
from .bench import ELBOW, SHOULDER, SLIDE

GRAVITY = (0.3, -0.2, -9.80665)
MESH = '<visual><geometry><mesh filename="package://nowhere/a.dae"/></geometry></visual>'
FRAME = '<link name="frame"/>' + bench.joint("bolt", "tool", "frame", "fixed")
FULL = '<?xml version="1.0"?>\n<!-- by hand -->\n' + bench.urdf(slides=True).replace(
    "<inertial>", f"{MESH}<inertial>", 2
).replace("</robot>", f"{FRAME}<!-- the end --></robot>\n<!-- behind -->\n")
JOINTS = {
    SHOULDER: {"armature": 1.2, "coulomb": 5.0, "viscous": 1.0 / 3.0, "load": 0.15, "offset": 0.2},
    SLIDE: {"armature": 2.0 / 3.0, "coulomb": 2.0, "viscous": 1.5e-5, "load": 0.1, "offset": -0.1},
}
TYPICAL = {SHOULDER: 40.0}
REAL = DATA / "ur10-arm" / "ur10.urdf"


def made(folder, text):
    path = folder / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    return path


def inertias(path):
    """Inertial parameters by link, as iDynTree reads them."""
    bodies = Bodies(path, GRAVITY)
    nominal = bodies.prior(Uncertainty(), Payload()).nominal
    return dict(zip(bodies.links, nominal.reshape(-1, 10), strict=True))


def other(path):
    """Each body of a URDF with a mass, with points bolted on, so that no axis is principal."""
    random = np.random.default_rng(1)
    found = {}
    for name, body in inertias(path).items():
        body = body.copy()
        for at in random.normal(scale=0.1, size=(3, 3)) if body[0] else ():
            inertia = at @ at * np.eye(3) - np.outer(at, at)
            body += body[0] / 5.0 * np.array([1.0, *at, *inertia[np.triu_indices(3)]])
        found[name] = body
    return found


def somewhere(joints, n=5):
    return np.random.default_rng(2).normal(size=(3, joints, n))


def rigid(path, motion):
    bodies = Bodies(path, GRAVITY)
    nominal = bodies.prior(Uncertainty(), Payload()).nominal
    return bodies.torques(motion, np.repeat(nominal[None, :, None], motion.shape[1], axis=0))[:, 0]


def each(path, joints, key):
    """Say what a quantity is of all joints of a URDF, ``(n_joints, 1)``."""
    return np.array([[joints.get(name, {}).get(key, 0.0)] for name in Bodies(path, GRAVITY).joints])


@pytest.fixture(params=["bench", "ur10"])
def arm(request, tmp_path):
    """A URDF, and what is identified of it."""
    if request.param == "bench":
        path, joints = made(tmp_path, FULL), JOINTS
    elif REAL.is_file():
        path = REAL
        names = list(Bodies(path, GRAVITY).joints)
        joints = {name: {**JOINTS[SHOULDER], "armature": 1.0 + k} for k, name in enumerate(names)}
    else:
        pytest.skip(f"there is no {REAL}")
    return path, Identified(joints, other(path), ["by -- a fit ---", "of\ntwo"])


def test_bodies_of_the_urdf_are_those_that_were_given(arm, tmp_path):
    path, given = arm
    for name, body in inertias(made(tmp_path, written_urdf(path, given))).items():
        assert body == pytest.approx(given.bodies[name], abs=1e-9), name


def test_bodies_as_they_were_ask_for_the_torque_that_they_did(arm, tmp_path):
    path, given = arm
    motion = somewhere(len(Bodies(path, GRAVITY).joints))
    expected = rigid(path, motion)
    text = written_urdf(path, replace(given, bodies=inertias(path)))
    assert rigid(made(tmp_path, text), motion) == pytest.approx(expected, abs=1e-9)


def test_what_is_not_known_stays_as_it_is(tmp_path):
    path = made(tmp_path, FULL)
    given = Identified({SHOULDER: {"viscous": 2.5}}, {}, [])
    text = written_urdf(path, given)
    dynamics = '<dynamics damping="2.5" />'
    assert text.count(dynamics) == 1
    # how an empty element ends is no part of it
    assert text.replace(dynamics, "").replace(" />", "/>") == FULL


def test_joints_of_mujoco_have_what_was_given(arm):
    path, given = arm
    text = written_mjcf(path, given, typical=TYPICAL)
    assert text.count("<motor") == len(Bodies(path, GRAVITY).joints)
    model = mujoco.MjModel.from_xml_string(text)
    assert {model.actuator(k).name for k in range(model.nu)} == {*Bodies(path, GRAVITY).joints}
    for name in Bodies(path, GRAVITY).joints:
        own, joint = given.joints.get(name, dict.fromkeys(JOINTS[SHOULDER], 0.0)), model.joint(name)
        assert joint.armature == own["armature"]
        assert joint.damping == own["viscous"]
        assert joint.frictionloss == own["coulomb"] + own["load"] * TYPICAL.get(name, 0.0)
        motor = model.actuator(name)
        assert (motor.trnid[0], motor.gear[0], motor.gainprm[0]) == (joint.id, 1.0, 1.0)


def test_mujoco_asks_for_the_torque_of_the_urdf(arm, tmp_path):
    path, given = arm
    motion = somewhere(len(Bodies(path, GRAVITY).joints))
    text = written_mjcf(path, given, gravity=GRAVITY)
    found = bench.rigid_torque(text, *np.swapaxes(motion, 1, 2)).T
    expected = rigid(made(tmp_path, written_urdf(path, given)), motion)
    expected += each(path, given.joints, "armature") * motion[2]
    expected += each(path, given.joints, "viscous") * motion[1]
    assert found == pytest.approx(expected, abs=1e-6)


def test_frames_that_move_are_as_good_as_without_a_mass_in_mujoco(tmp_path):
    """Two joints of one place have a link between them that is none."""
    text = bench.robot(
        *(bench.link("base"), '<link name="upper"/>', bench.link("lower"), '<link name="tip"/>'),
        bench.joint(SHOULDER, "base", "upper", "prismatic"),
        bench.joint(ELBOW, "upper", "lower"),
        bench.joint("last", "lower", "tip"),
    )
    path, motion = made(tmp_path, text), somewhere(3)
    found = written_mjcf(path, Identified({}, {}, []), gravity=GRAVITY)
    found = bench.rigid_torque(found, *np.swapaxes(motion, 1, 2)).T
    assert found == pytest.approx(rigid(path, motion), abs=1e-6)


def coupled(folder):
    mimic = f'<mimic joint="{SHOULDER}" multiplier="-0.3333333333333333" offset="0.2"/>'
    links = [bench.link(name) for name in ("base", "upper", "lower")]
    joints = (
        bench.joint(SHOULDER, "base", "upper"),
        bench.joint(ELBOW, "upper", "lower", more=mimic),
    )
    return made(folder, bench.robot(*links, *joints))


def test_a_joint_that_mimics_has_no_motor_in_mujoco(tmp_path):
    text = written_mjcf(coupled(tmp_path), Identified({}, {}, []))
    model = mujoco.MjModel.from_xml_string(text)
    assert [model.actuator(k).name for k in range(model.nu)] == [SHOULDER]
    assert model.eq_data[0, :3].tolist() == [0.2, -1.0 / 3.0, 0.0]


def test_mujoco_refuses_a_body_that_is_none(tmp_path):
    path = made(tmp_path, bench.urdf().replace('ixx="0.12"', 'ixx="9.0"'))
    with pytest.raises(BadInput, match="upper"):
        written_mjcf(path, Identified({}, {}, []))


def test_mjcf_without_mujoco_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(BadInput, match="pip install mujoco"):
        written_mjcf(made(tmp_path, FULL), Identified({}, {}, []))


@pytest.mark.parametrize(
    "body",
    [
        (-1.0, 0, 0, 0, 0.1, 0, 0, 0.1, 0, 0.1),
        (1.0, 0, 0, 0, 0.1, 0, 0, 0.1, 0, 0.3),  # no triangle
        (1.0, 0, 0, 0, 0.1, 0.2, 0, 0.1, 0, 0.1),
        (1.0, 1.0, 0, 0, 0.1, 0, 0, 0.1, 0, 0.1),  # less than that of a point there
    ],
)
def test_what_is_no_body_is_refused(tmp_path, body):
    given = Identified({}, {"upper": np.array(body)}, [])
    with pytest.raises(ValueError, match="link upper"):
        written_urdf(made(tmp_path, FULL), given)


def test_what_is_no_xml_is_refused(tmp_path):
    with pytest.raises(BadInput, match="no URDF"):
        written_urdf(made(tmp_path, "<robot"), Identified({}, {}, []))


def test_a_link_without_an_inertial_gets_one(tmp_path):
    body = np.array([0.5, 0.05, 0.0, 0.0, 0.01, 0.0, 0.0, 0.02, 0.0, 0.02])
    given = Identified({}, {"frame": body}, [])
    found = inertias(made(tmp_path, written_urdf(made(tmp_path, FULL), given)))
    assert found["frame"] == pytest.approx(body, abs=1e-12)


def test_ros2_control_reads_the_numbers():
    yaml = pytest.importorskip("yaml")
    given = Identified({**JOINTS, "no: 1": {}}, {}, ["one: two"])
    tree = yaml.safe_load(written_ros2_control(given))
    controller, friction = (
        tree[name]["ros__parameters"]
        for name in ("joint_trajectory_controller", "friction_compensation")
    )
    assert controller["joints"] == friction.pop("joints") == [*JOINTS, "no: 1"]
    assert controller["command_interfaces"] == ["effort"]
    scales = {name: {"ff_velocity_scale": own["viscous"]} for name, own in JOINTS.items()}
    assert controller["gains"] == scales
    for own in friction.values():
        own["load"] = own.pop("load_loss")
    assert friction == JOINTS
    nothing = yaml.safe_load(written_ros2_control(Identified({"a": {}}, {}, [])))
    assert "gains" not in nothing["joint_trajectory_controller"]["ros__parameters"]


def module(folder, path, given):
    """Import the module that is written, beside its URDF."""
    made(folder, written_urdf(path, given))
    where = folder / "feedforward.py"
    where.write_text(written_python(given, "arm.urdf", gravity=GRAVITY), encoding="utf-8")
    spec = importlib.util.spec_from_file_location("feedforward", where)
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


@pytest.mark.parametrize("smooth", [0.0, 0.5])
def test_python_gives_the_torque(arm, tmp_path, smooth):
    path, given = arm
    _, qd, qdd = motion = somewhere(len(Bodies(path, GRAVITY).joints))
    joints, own = given.joints, module(tmp_path, path, given)
    assert list(Bodies(path, GRAVITY).joints) == own.JOINTS
    carried = rigid(tmp_path / "arm.urdf", motion)
    share = np.where(np.abs(qd) < smooth, np.abs(qd) / (smooth or 1.0), 1.0)
    a, c, v, m, o = (
        each(path, joints, key) for key in ("armature", "coulomb", "viscous", "load", "offset")
    )
    expected = carried + a * qdd + (c + m * np.abs(carried)) * share * np.sign(qd) + v * qd + o
    found = [own.torque(*one, smooth=smooth) for one in np.moveaxis(motion, 2, 0)]
    assert np.transpose(found) == pytest.approx(expected, abs=1e-9)


def test_python_moves_what_mimics(tmp_path):
    path, motion = coupled(tmp_path), somewhere(1)
    expected = rigid(path, motion)
    own = module(tmp_path, path, Identified({}, {}, []))
    assert own.JOINTS == [SHOULDER]
    found = [own.torque(*one) for one in np.moveaxis(motion, 2, 0)]
    assert np.transpose(found) == pytest.approx(expected, abs=1e-9)
