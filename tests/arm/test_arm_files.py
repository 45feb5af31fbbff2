"""Exported files of an arm, read back by iDynTree, MuJoCo, YAML and Python."""

import sys

import mujoco
import numpy as np
import pytest

from bayesfric.arm.arm_options import NUMBERS, Payload, Uncertainty
from bayesfric.arm.exports import Identified, rendered, written_mjcf, written_urdf
from bayesfric.arm.inertial_prior import Bodies
from bayesfric.base.errors import BadInput
from tests.conftest import DATA, imported

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
    """Bodies of a URDF with a mass, with three points added, so that no axis is principal."""
    rng, bodies = np.random.default_rng(1), inertias(path)
    for body in bodies.values():
        for at in rng.normal(scale=0.1, size=(3, 3)) if body[0] else ():
            inertia = at @ at * np.eye(3) - np.outer(at, at)
            body += body[0] / 5.0 * np.array([1.0, *at, *inertia[np.triu_indices(3)]])
    return bodies


def random_motion(joints, n=5):
    return np.random.default_rng(2).normal(size=(3, joints, n))


def rigid(path, motion):
    bodies = Bodies(path, GRAVITY)
    nominal = bodies.prior(Uncertainty(), Payload()).nominal
    return bodies.torques(motion, np.repeat(nominal[None, :, None], motion.shape[1], axis=0))[:, 0]


def each(path, joints, key):
    """Look up a number of all joints of a URDF, ``(n_joints, 1)``."""
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


def test_urdf_has_the_identified_bodies(arm, tmp_path):
    path, identified = arm
    for name, body in inertias(made(tmp_path, written_urdf(path, identified))).items():
        assert body == pytest.approx(identified.bodies[name], abs=1e-9), name


def test_unknown_numbers_leave_the_urdf_as_it_is(tmp_path):
    path = made(tmp_path, FULL)
    identified = Identified({SHOULDER: {"viscous": 2.5}}, {}, [])
    text = written_urdf(path, identified)
    dynamics = '<dynamics damping="2.5" />'
    assert text.count(dynamics) == 1
    # how an empty element ends is no part of it
    assert text.replace(dynamics, "").replace(" />", "/>") == FULL


def test_joints_of_mujoco_have_the_identified_numbers(arm):
    path, identified = arm
    text = written_mjcf(path, identified, typical=TYPICAL)
    assert text.count("<motor") == len(Bodies(path, GRAVITY).joints)
    model = mujoco.MjModel.from_xml_string(text)
    assert {model.actuator(k).name for k in range(model.nu)} == {*Bodies(path, GRAVITY).joints}
    for name in Bodies(path, GRAVITY).joints:
        numbers = identified.joints.get(name, dict.fromkeys(NUMBERS, 0.0))
        joint = model.joint(name)
        assert joint.armature == numbers["armature"]
        assert joint.damping == numbers["viscous"]
        assert joint.frictionloss == numbers["coulomb"] + numbers["load"] * TYPICAL.get(name, 0.0)
        motor = model.actuator(name)
        assert (motor.trnid[0], motor.gear[0], motor.gainprm[0]) == (joint.id, 1.0, 1.0)


def test_torque_of_mujoco_is_that_of_the_urdf(arm, tmp_path):
    path, identified = arm
    motion = random_motion(len(Bodies(path, GRAVITY).joints))
    text = written_mjcf(path, identified, gravity=GRAVITY)
    result = bench.rigid_torque(text, *np.swapaxes(motion, 1, 2)).T
    expected = rigid(made(tmp_path, written_urdf(path, identified)), motion)
    expected += each(path, identified.joints, "armature") * motion[2]
    expected += each(path, identified.joints, "viscous") * motion[1]
    assert result == pytest.approx(expected, abs=1e-6)


def test_moving_frames_have_negligible_mass_in_mujoco(tmp_path):
    """Two joints of one place have a link between them that is none."""
    text = bench.robot(
        *(bench.link("base"), '<link name="upper"/>', bench.link("lower"), '<link name="tip"/>'),
        bench.joint(SHOULDER, "base", "upper", "prismatic"),
        bench.joint(ELBOW, "upper", "lower"),
        bench.joint("last", "lower", "tip"),
    )
    path, motion = made(tmp_path, text), random_motion(3)
    text = written_mjcf(path, Identified({}, {}, []), gravity=GRAVITY)
    result = bench.rigid_torque(text, *np.swapaxes(motion, 1, 2)).T
    assert result == pytest.approx(rigid(path, motion), abs=1e-6)


def coupled(folder):
    mimic = f'<mimic joint="{SHOULDER}" multiplier="-0.3333333333333333" offset="0.2"/>'
    links = [bench.link(name) for name in ("base", "upper", "lower")]
    joints = (
        bench.joint(SHOULDER, "base", "upper"),
        bench.joint(ELBOW, "upper", "lower", extra=mimic),
    )
    return made(folder, bench.robot(*links, *joints))


def test_a_joint_that_mimics_has_no_motor_in_mujoco(tmp_path):
    text = written_mjcf(coupled(tmp_path), Identified({}, {}, []))
    model = mujoco.MjModel.from_xml_string(text)
    assert [model.actuator(k).name for k in range(model.nu)] == [SHOULDER]
    assert model.eq_data[0, :3].tolist() == [0.2, -1.0 / 3.0, 0.0]


def test_mujoco_refuses_an_unphysical_body(tmp_path):
    path = made(tmp_path, bench.urdf().replace('ixx="0.12"', 'ixx="9.0"'))
    with pytest.raises(BadInput, match="upper"):
        written_mjcf(path, Identified({}, {}, []))


def test_mjcf_without_mujoco_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(BadInput, match="pip install mujoco"):
        written_mjcf(made(tmp_path, FULL), Identified({}, {}, []))


def test_a_link_without_an_inertial_gets_one(tmp_path):
    body = np.array([0.5, 0.05, 0.0, 0.0, 0.01, 0.0, 0.0, 0.02, 0.0, 0.02])
    identified = Identified({}, {"frame": body}, [])
    result = inertias(made(tmp_path, written_urdf(made(tmp_path, FULL), identified)))
    assert result["frame"] == pytest.approx(body, abs=1e-12)


def test_ros2_control_reads_the_numbers():
    yaml = pytest.importorskip("yaml")
    identified = Identified({**JOINTS, "no: 1": {}}, {}, ["one: two"])
    tree = yaml.safe_load(rendered("ros2_control.yaml", identified))
    controller, friction = (
        tree[name]["ros__parameters"]
        for name in ("joint_trajectory_controller", "friction_compensation")
    )
    assert controller["joints"] == friction.pop("joints") == [*JOINTS, "no: 1"]
    assert controller["command_interfaces"] == ["effort"]
    scales = {name: {"ff_velocity_scale": numbers["viscous"]} for name, numbers in JOINTS.items()}
    assert controller["gains"] == scales
    for numbers in friction.values():
        numbers["load"] = numbers.pop("load_loss")
    assert friction == JOINTS


def module(folder, path, identified):
    """Import the module that is written, with its URDF."""
    made(folder, written_urdf(path, identified))
    file = folder / "feedforward.py"
    text = rendered("feedforward.py", identified, urdf="arm.urdf", gravity=GRAVITY)
    file.write_text(text, encoding="utf-8")
    return imported(file)


@pytest.mark.parametrize("smooth", [0.0, 0.5])
def test_feedforward_is_friction_and_the_torque_of_the_urdf(arm, tmp_path, smooth):
    path, identified = arm
    _, qd, qdd = motion = random_motion(len(Bodies(path, GRAVITY).joints))
    feedforward = module(tmp_path, path, identified)
    assert list(Bodies(path, GRAVITY).joints) == feedforward.JOINTS
    torque = rigid(tmp_path / "arm.urdf", motion)
    share = np.where(np.abs(qd) < smooth, np.abs(qd) / (smooth or 1.0), 1.0)
    keys = [key for key in NUMBERS if key != "gain"]
    armature, coulomb, viscous, load, offset = (each(path, identified.joints, k) for k in keys)
    friction = (coulomb + load * np.abs(torque)) * share * np.sign(qd) + viscous * qd
    expected = torque + armature * qdd + friction + offset
    computed = [feedforward.torque(*x, smooth=smooth) for x in np.moveaxis(motion, 2, 0)]
    assert np.transpose(computed) == pytest.approx(expected, abs=1e-9)


def test_feedforward_has_the_bodies_by_which_a_joint_was_fitted(tmp_path):
    path, motion = made(tmp_path, FULL), random_motion(3)
    linear = {ELBOW: np.concatenate([*other(path).values()])}
    expected = rigid(path, motion)
    expected[1] = rigid(
        made(tmp_path, written_urdf(path, Identified({}, other(path), []))), motion
    )[1]
    path = made(tmp_path, FULL)
    feedforward = module(tmp_path, path, Identified({}, {}, [], linear))
    computed = [feedforward.torque(*x) for x in np.moveaxis(motion, 2, 0)]
    assert np.transpose(computed) == pytest.approx(expected, abs=1e-9)


def test_feedforward_moves_a_joint_that_mimics(tmp_path):
    path, motion = coupled(tmp_path), random_motion(1)
    expected = rigid(path, motion)
    feedforward = module(tmp_path, path, Identified({}, {}, []))
    assert feedforward.JOINTS == [SHOULDER]
    computed = [feedforward.torque(*x) for x in np.moveaxis(motion, 2, 0)]
    assert np.transpose(computed) == pytest.approx(expected, abs=1e-9)
