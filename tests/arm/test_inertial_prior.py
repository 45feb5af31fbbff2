"""Torques of bodies beside MuJoCo's, and URDFs that are none."""

import numpy as np
import pytest

from bayesfric.arm.arm_options import Payload, Uncertainty
from bayesfric.arm.inertial_prior import Bodies, directions, resolution
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
    prior = bodies.prior(Uncertainty(), Payload(**payload))
    parameters = np.repeat(prior.nominal[None, :, None], len(bodies.joints), axis=0)
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
    prior = bodies.prior(Uncertainty(), Payload())
    time, *motion = bench.motion(5.0, rate=50.0)
    motion = np.swapaxes(np.stack(motion), 1, 2)
    each = bodies.torques(motion, np.repeat(prior.spread[None], 2, axis=0))[0]
    found = directions(each, 0.05)
    assert found.T @ found == pytest.approx(np.eye(found.shape[1]), abs=1e-9)
    left = each - found @ (found.T @ each)
    assert np.sqrt(np.sum(left**2) / time.size) <= 0.05
    assert directions(each, np.inf).shape[1] == 0


def test_resolution_is_the_standard_error_of_a_mean():
    """White noise of 0.3 N m, 4000 samples, within a tenth: 8 columns are fitted."""
    noise = np.random.default_rng(1)
    q, qd, qdd, bodies = noise.normal(size=(4, 4000))
    torque = 2.0 * bodies + 3.0 * np.sign(qd) + qd + 0.3 * noise.normal(size=4000)
    found = resolution(torque, qd, qdd, np.stack([bodies, q]))
    assert found == pytest.approx(0.3 / np.sqrt(4000.0), rel=0.1)


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
        made(tmp_path, bench.urdf()).prior(Uncertainty(), Payload(link="tol"))
