"""Rigid-body torques compared with MuJoCo's, and refused URDFs."""

import numpy as np
import pytest

from bayesfric.arm.arm_options import Coupling, Payload, Uncertainty
from bayesfric.arm.inertial_prior import Bodies, directions, resolution
from bayesfric.base.errors import BadInput

from . import bench

GRAVITY = (0.0, 0.0, -9.81)  # MuJoCo's


def bodies_of(tmp_path, text, gravity=GRAVITY):
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    return Bodies(path, gravity)


def random_motion(joints, n=5):
    return np.random.default_rng(1).normal(size=(3, joints, n))


def nominal(bodies, motion, **payload):
    prior = bodies.prior(Uncertainty(), Payload(**payload))
    parameters = np.repeat(prior.nominal[None, :, None], len(bodies.joints), axis=0)
    return bodies.torques(motion, parameters)[:, 0]


@pytest.mark.parametrize("slides", [False, True])
def test_torques_are_those_of_mujoco(tmp_path, slides):
    text = bench.urdf(slides=slides)
    motion = random_motion(2 + slides)
    expected = bench.rigid_torque(text, *np.swapaxes(motion, 1, 2)).T
    assert nominal(bodies_of(tmp_path, text), motion) == pytest.approx(expected, abs=1e-9)


def test_a_payload_is_a_body_on_a_link(tmp_path):
    at, mass = np.array([0.05, -0.1, 0.2]), 1.5
    point = (
        f'<link name="point"><inertial><mass value="{mass}"/><origin xyz="0 0 0"/>'
        '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="bolt" type="fixed"><parent link="tool"/><child link="point"/>'
        f'<origin xyz="{" ".join(map(str, at))}"/></joint></robot>'
    )
    motion = random_motion(3)
    text = bench.urdf(slides=True)
    expected = nominal(bodies_of(tmp_path, text.replace("</robot>", point)), motion)
    computed = nominal(bodies_of(tmp_path, text), motion, link="tool", mass=mass, centre=tuple(at))
    assert computed == pytest.approx(expected, abs=1e-9)


def test_a_chain_of_mimic_joints_moves_with_the_joint_whose_motor_carries_all(tmp_path):
    """Power of the one motor is that of all joints; the third turns by 2 (0.2 - q/2) + 0.1."""
    links = [bench.link(name) for name in bench.LINKS]
    first = bench.joint(bench.SHOULDER, "base", "upper")

    def arm(second="", third=""):
        joints = (
            bench.joint("e", "upper", "lower", extra=second),
            bench.joint("w", "lower", "tool", extra=third),
        )
        return bodies_of(tmp_path, bench.robot(*links, first, *joints))

    motion = random_motion(1)
    every = np.concatenate([motion, -0.5 * motion, -motion], axis=1)
    every[0] += np.array([[0.0], [0.2], [0.5]])
    torques = nominal(arm(), every)
    second = f'<mimic joint="{bench.SHOULDER}" multiplier="-0.5" offset="0.2"/>'
    coupled = arm(second, '<mimic joint="e" multiplier="2" offset="0.1"/>')
    assert nominal(coupled, motion)[0] == pytest.approx([1.0, -0.5, -1.0] @ torques)
    with pytest.raises(BadInput, match="mimic each other"):
        arm(second, '<mimic joint="w"/>')


def test_torques_of_coupled_joints_are_those_of_their_motors(tmp_path):
    """By virtual work: their power is that of the joints."""
    matrix = ((1.0, 0.25), (-0.5, 2.0))
    (tmp_path / "arm.urdf").write_text(bench.urdf())
    coupling = Coupling(joints=(bench.ELBOW, bench.SHOULDER), matrix=matrix)
    coupled = Bodies(tmp_path / "arm.urdf", GRAVITY, coupling)
    motion = random_motion(2)
    speed = np.linalg.solve(coupled.motors, motion[1])
    joints = np.stack([np.linalg.solve(coupled.motors, x) for x in motion])
    assert motion[1, 1] == pytest.approx(speed[1] + 0.25 * speed[0])  # the elbow's motor
    free = nominal(bodies_of(tmp_path, bench.urdf()), joints)
    power = np.sum(free * joints[1], axis=0)
    assert np.sum(nominal(coupled, motion) * motion[1], axis=0) == pytest.approx(power)
    with pytest.raises(BadInput, match=r"coupling\.joints"):
        Bodies(tmp_path / "arm.urdf", GRAVITY, Coupling(joints=("x",), matrix=((1.0,),)))


def test_directions_leave_less_than_the_threshold(tmp_path):
    bodies = bodies_of(tmp_path, bench.urdf())
    prior = bodies.prior(Uncertainty(), Payload())
    time, *motion = bench.motion(5.0, rate=50.0)
    motion = np.swapaxes(np.stack(motion), 1, 2)
    torque = bodies.torques(motion, np.repeat(prior.spread[None], 2, axis=0))[0]
    basis = directions(torque, 0.05)
    assert basis.T @ basis == pytest.approx(np.eye(basis.shape[1]), abs=1e-9)
    left = torque - basis @ (basis.T @ torque)
    assert np.sqrt(np.sum(left**2) / time.size) <= 0.05
    assert directions(torque, np.inf).shape[1] == 0


def test_resolution_is_the_standard_error_of_a_mean():
    """White noise of 0.3 N m, 4000 samples, within a tenth: 8 columns are fitted."""
    noise = np.random.default_rng(1)
    q, qd, qdd, bodies = noise.normal(size=(4, 4000))
    torque = 2.0 * bodies + 3.0 * np.sign(qd) + qd + 0.3 * noise.normal(size=4000)
    error = resolution(torque, qd, qdd, np.stack([bodies, q]))
    assert error == pytest.approx(0.3 / np.sqrt(4000.0), rel=0.1)


LINKS = "".join(map(bench.link, bench.LINKS))
MOVES = bench.joint(bench.SHOULDER, "base", "upper")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot", "no URDF"),
        (bench.robot(), "no joint that moves"),
        (bench.robot('<link name="base"/><link name="upper"/>', MOVES), "<inertial>"),
        (bench.robot(bench.link("base"), MOVES), "link upper"),
        (bench.robot(LINKS, MOVES, bench.joint("f", "upper", "lower", "floating")), "floating"),
        (bench.urdf().replace('value="6.0"', 'value="heavy"'), "mass"),
        (bench.urdf().replace("</joint>", '<mimic joint="x"/></joint>', 1), "mimics 'x'"),
        (bench.urdf().replace("</joint>", '<mimic joint="x" offset="?"/></joint>', 1), "no URDF"),
    ],
)
def test_an_unusable_urdf_is_refused(tmp_path, capfd, text, message):
    with pytest.raises(BadInput, match=message):
        bodies_of(tmp_path, text)
    assert capfd.readouterr().err == ""


def test_a_payload_needs_a_link_of_the_urdf(tmp_path):
    with pytest.raises(BadInput, match=r"payload\.link"):
        bodies_of(tmp_path, bench.urdf()).prior(Uncertainty(), Payload(link="tol"))
