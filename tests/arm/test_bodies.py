"""Torques of bodies beside MuJoCo's, and URDFs that are none."""

import numpy as np
import pytest

from bayesfric.arm.arm_options import Payload, Uncertainty
from bayesfric.arm.bodies import Bodies
from bayesfric.base.errors import BadInput

from . import bench

GRAVITY = (0.0, 0.0, -9.81)  # MuJoCo's


def made(tmp_path, text, gravity=GRAVITY):
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    return Bodies(path, gravity)


def somewhere(joints, n=5):
    return np.random.default_rng(1).normal(size=(3, joints, n))


def nominal(bodies, motion, **payload):
    doubt = bodies.doubt(Uncertainty(), Payload(**payload))
    parameters = np.repeat(doubt.nominal[None, :, None], len(bodies.joints), axis=0)
    return bodies.torques(motion, parameters)[:, 0]


@pytest.mark.parametrize("slides", [False, True])
def test_torques_are_those_of_mujoco(tmp_path, slides):
    text = bench.urdf(slides=slides)
    motion = somewhere(2 + slides)
    expected = bench.rigid_torque(text, *np.swapaxes(motion, 1, 2)).T
    assert nominal(made(tmp_path, text), motion) == pytest.approx(expected, abs=1e-9)


def test_a_payload_is_a_body_more(tmp_path):
    at, mass = np.array([0.05, -0.1, 0.2]), 1.5
    point = (
        f'<link name="point"><inertial><mass value="{mass}"/><origin xyz="0 0 0"/>'
        '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="bolt" type="fixed"><parent link="tool"/><child link="point"/>'
        f'<origin xyz="{" ".join(map(str, at))}"/></joint></robot>'
    )
    motion = somewhere(3)
    whole = nominal(made(tmp_path, bench.urdf(slides=True).replace("</robot>", point)), motion)
    bolted = nominal(
        made(tmp_path, bench.urdf(slides=True)), motion, link="tool", mass=mass, centre=tuple(at)
    )
    assert bolted == pytest.approx(whole, abs=1e-9)


def test_a_mimic_joint_moves_with_another_whose_motor_carries_both(tmp_path):
    """Power of the one motor is that of both joints."""
    mimic = f'<mimic joint="{bench.SHOULDER}" multiplier="-0.5" offset="0.2"/>'
    links = [bench.link(name) for name in bench.LINKS]
    joints = (
        bench.joint(bench.SHOULDER, "base", "upper"),
        bench.joint(bench.SLIDE, "lower", "tool", "fixed"),
    )
    free = made(tmp_path, bench.robot(*links, *joints, bench.joint("e", "upper", "lower")))
    one = somewhere(1)
    both = np.concatenate([one, -0.5 * one], axis=1)
    both[0, 1] += 0.2
    shoulder, elbow = nominal(free, both)
    coupled = bench.robot(*links, *joints, bench.joint("e", "upper", "lower", more=mimic))
    assert nominal(made(tmp_path, coupled), one)[0] == pytest.approx(shoulder - 0.5 * elbow)


def test_directions_hold_all_of_the_doubt_but_a_little(tmp_path):
    bodies = made(tmp_path, bench.urdf())
    doubt = bodies.doubt(Uncertainty(), Payload())
    time, *motion = bench.motion(5.0, rate=50.0)
    motion = np.swapaxes(np.stack(motion), 1, 2)
    small = np.array([0.05, np.inf])
    shoulder, elbow = bodies.directions(motion, doubt, small)
    assert shoulder.T @ shoulder == pytest.approx(np.eye(shoulder.shape[1]), abs=1e-9)
    assert elbow.shape[1] == 0
    each = bodies.torques(motion, np.repeat(doubt.spread[None], 2, axis=0))[0]
    left = each - shoulder @ (shoulder.T @ each)
    assert np.sqrt(np.sum(left**2) / time.size) <= small[0]


LINKS = "".join(map(bench.link, bench.LINKS))
MOVES = bench.joint(bench.SHOULDER, "base", "upper")


@pytest.mark.parametrize(
    ("text", "told"),
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
def test_what_is_no_urdf_of_an_arm_is_refused(tmp_path, capfd, text, told):
    with pytest.raises(BadInput, match=told):
        made(tmp_path, text)
    assert capfd.readouterr().err == ""


def test_a_payload_is_on_a_link(tmp_path):
    with pytest.raises(BadInput, match=r"payload\.link"):
        made(tmp_path, bench.urdf()).doubt(Uncertainty(), Payload(link="tol"))
