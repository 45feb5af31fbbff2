"""The exported model in real MuJoCo, against our forward model, on SIMULATED recordings."""

import math
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.own_term import Term

from .made import (
    check_reported_torque,
    exported_vector,
    finished_posterior,
    numbers,
    posterior_of,
    rms,
    swung,
)

SECONDS = 2.0


def moved(xml, torque, period, before=None, start=(0.0, 0.0)):
    """Positions of MuJoCo's joint under a torque held over each period."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = start
    friction = before(model) if before else lambda *_: None
    steps = round(period / model.opt.timestep)
    out = np.empty(torque.size)
    for i, now in enumerate(torque):
        out[i] = data.qpos[0]
        data.ctrl[0] = now
        for _ in range(steps):
            friction(model, data)
            mujoco.mj_step(model, data)
    return out


def friction_of(exported):
    namespace = {}
    exec(exported.files["joint_friction.py"], namespace)
    return namespace["Friction"]


@pytest.mark.parametrize("name", ["plain", "motor-axis"])
def test_what_mujoco_can_carry_moves_as_the_fitted_joint(name):
    run = finished_posterior(name)
    torque, period = swung(0.6, SECONDS)
    exported = bf.export(run, "mujoco")
    motion = simulate(run.joint, exported_vector(run), torque, period, hold="zero").q
    assert np.ptp(motion) > 0.3
    assert rms(moved(exported.main, torque, period) - motion) < 1e-3
    assert not exported.record["lost"]
    assert exported.record["error"]["motor"]["largest"] < 1e-12


@pytest.mark.parametrize("name", ["rabbit-knee", "servo-pendulum"])
def test_the_torque_it_takes_is_wrong_by_what_was_announced(name):
    """Recorded motion through MuJoCo's own inverse dynamics."""
    run = finished_posterior(name)
    exported = bf.export(run, "mujoco")
    model = mujoco.MjModel.from_xml_string(exported.main)
    data = mujoco.MjData(model)

    def torque_of(*motion):
        data.qpos[0], data.qvel[0], data.qacc[0] = motion
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse[0] / model.actuator_gear[0, 0]

    check_reported_torque(run, exported, torque_of)


@pytest.mark.parametrize("name", ["rabbit-knee", "servo-pendulum"])
def test_friction_set_at_each_step_gives_the_load_loss_back(name):
    run = finished_posterior(name)
    torque, period = swung(0.5, SECONDS)
    exported = bf.export(run, "mujoco")
    motion = simulate(run.joint, exported_vector(run), torque, period, hold="zero").q
    plain = rms(moved(exported.main, torque, period) - motion)
    set_anew = rms(moved(exported.main, torque, period, friction_of(exported)) - motion)
    assert set_anew < 1e-3 < plain
    assert set_anew < 0.1 * plain


def test_three_numbers_of_damping_are_a_cubic():
    exported = bf.export(finished_posterior("plain"), "mujoco")
    model = mujoco.MjModel.from_xml_string(exported.main)
    data, exported_numbers = mujoco.MjData(model), numbers(exported)
    for speed in (-3.0, 0.5, 2.0):
        data.qpos[0], data.qvel[0] = 0.4, speed
        mujoco.mj_forward(model, data)
        expected = -exported_numbers["joint damping"] * speed
        expected -= exported_numbers["joint damping, second number"] * speed * abs(speed)
        expected -= exported_numbers["joint stiffness"] * 0.4
        assert data.qfrc_passive[0] == pytest.approx(expected, rel=1e-12)


MODEL = """<mujoco>
  <!-- <joint name="knee" damping="9"/> is no joint -->
  <default><default class="leg"><joint armature="0.5"/></default></default>
  <worldbody>
    <body name='thigh'><geom size="0.1"/><joint name="hip" axis="1 0 0"/>
      <body><geom size="0.1"/>
        <joint name='knee' class="leg"   axis="0 1 0"
               damping = "0.25"
               pos="0 0 0" />
      </body></body>
  </worldbody>
  <actuator><motor name="knee" joint="knee"/></actuator>
  <equality><joint name="knee" joint1="knee" joint2="hip"/></equality>
</mujoco>
"""


def test_a_joint_of_a_model_is_changed_and_nothing_else(tmp_path):
    path = tmp_path / "leg.xml"
    path.write_text(MODEL)
    exported = bf.export(finished_posterior("rabbit-knee"), "mujoco", into=path, joint="knee")
    assert next(iter(exported.files)) == "leg.xml"
    before, after = MODEL.splitlines(), exported.main.splitlines()
    changed = [k for k, (a, b) in enumerate(zip(before, after, strict=True)) if a != b]
    assert changed == [7, 8]
    model = mujoco.MjModel.from_xml_string(exported.main)
    dof = model.joint("knee").dofadr[0]
    exported_numbers = numbers(exported)
    assert model.dof_damping[dof] == exported_numbers["joint damping"]
    assert model.dof_frictionloss[dof] == exported_numbers["joint frictionloss"]
    assert model.dof_armature[dof] == exported_numbers["joint armature"]
    assert model.dof_damping[model.joint("hip").dofadr[0]] == 0.0
    # what was set before is replaced, and set once
    joint = ElementTree.fromstring(exported.main).findall(".//body/joint")[1]
    assert joint.get("class") == "leg"
    # changing it again with the same gives the same bytes
    again = tmp_path / "again.xml"
    again.write_text(exported.main)
    run = finished_posterior("rabbit-knee")
    assert bf.export(run, "mujoco", into=again, joint="knee").main == exported.main
    assert path.read_text() == MODEL


def test_a_joint_that_is_not_there_is_refused_by_its_nearest_name(tmp_path):
    path = tmp_path / "leg.xml"
    path.write_text(MODEL)
    with pytest.raises(BadInput, match="has no joint 'kne'; did you mean 'knee'"):
        bf.export(finished_posterior("rabbit-knee"), "mujoco", into=path, joint="kne")
    path.write_text("<mujoco>")
    with pytest.raises(BadInput, match="is no XML"):
        bf.export(finished_posterior("rabbit-knee"), "mujoco", into=path, joint="knee")


def test_a_sliding_joint_behind_a_spindle_moves_as_the_fitted_one():
    joint = Joint(
        elements=(
            Element("motor", ratio=300.0, inertia=True, viscous=True),
            Element("slide", motion="linear", coulomb="symmetric", viscous=True),
        ),
        load=Load(motion="linear", inertia=True),
    )
    values = {
        "motor.inertia": 1e-4,
        "motor.viscous": 1e-3,
        "slide.coulomb": 40.0,
        "slide.viscous": 20.0,
        "load.inertia": 5.0,
    }
    run = posterior_of(joint, values, 0.5)
    exported = bf.export(run, "mujoco")
    torque, period = swung(0.5, SECONDS)
    motion = simulate(joint, exported_vector(run), torque, period, hold="zero").q
    assert np.ptp(motion) > 0.1
    assert rms(moved(exported.main, torque, period) - motion) < 1e-3
    rows = {row["attribute"]: row for row in exported.record["numbers"]}
    assert rows["joint frictionloss"]["unit"] == "N"
    vector = dict(zip(joint.names, exported_vector(run), strict=True))
    armature = vector["motor.inertia"] * 300.0**2
    assert rows["joint armature"]["value"] == pytest.approx(armature)


@pytest.mark.parametrize("size", [abs, math.fabs])
def test_a_term_of_ones_own_is_fitted_and_no_controller_is_written_without_a_formula(size):
    """Its quadratic loss is what MuJoCo has a number for; its square of position is lost."""
    joint = Joint(elements=(Element("motor", inertia=True, viscous=True),), load=Load())
    joint = joint.with_term(Term("motor.square", lambda m: m.speed * size(m.speed)))
    joint = joint.with_term(Term("motor.bent", lambda m: m.position * m.position))
    values = {"motor.inertia": 0.01, "motor.viscous": 0.05, "motor.square": 0.01}
    exported = bf.export(posterior_of(joint, values | {"motor.bent": 0.02}, 0.6), "mujoco")
    assert list(exported.files) == ["joint.xml", *(["joint_friction.py"] if size is abs else [])]
    assert numbers(exported)["joint damping, second number"] == pytest.approx(0.01, rel=0.2)
    lost = {row["parameters"][0]: row for row in exported.record["lost"]}
    assert 0.5 < lost["motor.bent"]["left"] / lost["motor.bent"]["torque"] <= 1.0
    assert lost["motor.square"]["left"] < 0.3 * lost["motor.square"]["torque"]
