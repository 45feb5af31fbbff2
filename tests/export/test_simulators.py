"""Exports in the programs they are for, on SIMULATED recordings; what is not installed is skipped.

Run them with ``pip install bayesfric[simulators]``, and ``python-sdformat`` without what it wants.
"""

import json

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.export.formats.bam import parameters
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint

from .made import check_announced_torque, found, middle, numbers, rms, swung

NAMES = ("plain", "rabbit-knee", "servo-pendulum", "motor-axis")


def wanted(module):
    return pytest.importorskip(module, reason=f"{module} is not installed")


def pinocchio_of(exported, folder):
    for name, text in exported.files.items():
        (folder / name).write_text(text)
    loader = {"__file__": str(folder / "joint_pinocchio.py")}
    exec(exported.files["joint_pinocchio.py"], loader)
    return loader


def stepped(loader, torque, period, finer=5):
    model = loader["load"]()
    data = model.createData()
    q, v, out = 0.0, 0.0, []
    for now in torque:
        out.append(q)
        for _ in range(finer):
            q, v = loader["step"](model, data, q, v, loader["joint_torque"](now), period / finer)
    return np.array(out)


@pytest.mark.parametrize("name", ["plain", "motor-axis"])
def test_pinocchio_moves_as_the_fitted_joint(name, tmp_path):
    wanted("pinocchio")
    done = found(name)
    exported = bf.export(done, "pinocchio")
    torque, period = swung(0.6, 2.0)
    motion = simulate(done.joint, middle(done), torque, period, hold="zero").q
    assert rms(stepped(pinocchio_of(exported, tmp_path), torque, period) - motion) < 1e-3
    assert not exported.record["lost"]


def drake_of(text, kind):
    wanted("pydrake")
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(text, kind)
    if kind == "urdf":
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -9.80665])
    plant.Finalize()
    return plant


@pytest.mark.parametrize("name", NAMES)
def test_drake_takes_the_torque_that_was_announced(name):
    """Recorded motion through Drake's inverse dynamics, damping and rotor included."""
    done = found(name)
    exported = bf.export(done, "drake")
    plant = drake_of(exported.main, "urdf")
    context, told = plant.CreateDefaultContext(), numbers(exported)
    gain, offset = told["joint torque per motor torque"], told.get("joint torque, less", 0.0)
    from pydrake.multibody.tree import MultibodyForces

    def taken(q, qd, qdd):
        plant.SetPositions(context, [q])
        plant.SetVelocities(context, [qd])
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        torque = plant.CalcInverseDynamics(context, np.array([qdd]), forces)[0]
        return (torque + offset) / gain

    check_announced_torque(done, exported, taken)
    assert exported.record["lost"][-1]["number"] in ("friction", "stiffness")


@pytest.mark.parametrize("name", NAMES)
def test_urdf_is_read_alike_by_yourdfpy_and_pinocchio(name, tmp_path):
    yourdfpy, pinocchio = wanted("yourdfpy"), wanted("pinocchio")
    exported = bf.export(found(name), "urdf")
    path = tmp_path / "joint.urdf"
    path.write_text(exported.main)
    told = numbers(exported)
    read = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=False)
    dynamics = read.joint_map["joint"].dynamics
    model = pinocchio.buildModelFromUrdf(str(path))
    assert float(dynamics.damping) == model.damping[0] == told["dynamics damping"]
    assert float(dynamics.friction) == model.friction[0] == told["dynamics friction"]
    data = model.createData()
    mass = pinocchio.crba(model, data, np.zeros(1))[0, 0]
    full = numbers(bf.export(found(name), "csv"))
    inertia = full["armature"] + full.get("link_inertia", 0.0)
    assert mass == pytest.approx(inertia, rel=1e-9)
    weight = pinocchio.rnea(model, data, np.array([0.3]), np.zeros(1), np.zeros(1))[0]
    swing = np.sin(0.3 + full.get("link_gravity_angle", 0.0))
    assert weight == pytest.approx(9.81 * full.get("link_moment", 0.0) * swing, abs=1e-9)


@pytest.mark.parametrize("name", NAMES)
# pysdf's own use of what its libraries will take away
@pytest.mark.filterwarnings("ignore::DeprecationWarning:pysdf", "ignore:.*pkg_resources")
def test_sdf_is_read_alike_by_drake_and_pysdf(name):
    exported = bf.export(found(name), "sdf")
    told = numbers(exported)
    plant = drake_of(exported.main, "sdf")
    assert plant.GetJointByName("joint").default_damping() == told["dynamics damping"]
    context = plant.CreateDefaultContext()
    full = numbers(bf.export(found(name), "csv"))
    inertia = full["armature"] + full.get("link_inertia", 0.0)
    assert plant.CalcMassMatrix(context)[0, 0] == pytest.approx(inertia, rel=1e-9)
    pysdf = wanted("pysdf")
    joint = pysdf.SDF.from_xml(exported.main.partition("-->")[2]).models[0].joints[0]
    dynamics = joint.axis.dynamics
    assert float(dynamics.damping) == told["dynamics damping"]
    assert float(dynamics.friction) == told["dynamics friction"]


def test_usd_joint_attributes_are_read_back_per_degree():
    usd = wanted("pxr.Usd")
    from pxr import Sdf

    exported = bf.export(found("rabbit-knee"), "isaac", joint="knee")
    layer = Sdf.Layer.CreateAnonymous(".usda")
    assert layer.ImportFromString(exported.files["knee.usda"])
    stage = usd.Stage.Open(layer)
    prim = stage.GetPrimAtPath("/knee")
    assert "PhysxJointAxisAPI:angular" in str(prim.GetMetadata("apiSchemas"))

    def read(name):
        return prim.GetAttribute(f"physxJointAxis:angular:{name}").Get()

    told = numbers(exported)
    assert read("armature") == pytest.approx(told["armature"])
    assert read("staticFrictionEffort") == pytest.approx(told["friction"])
    assert read("dynamicFrictionEffort") == pytest.approx(told["dynamic_friction"])
    # N m at one degree a second
    torque_at_one_degree = told["viscous_friction"] * np.deg2rad(1.0)
    assert read("viscousFrictionCoefficient") == pytest.approx(torque_at_one_degree)


def test_isaac_lab_takes_the_keywords_that_are_written():
    exported = bf.export(found("rabbit-knee"), "isaac", joint="knee")
    given = {}
    text = exported.files["knee_isaac_lab.py"]
    # its import needs a GPU's simulator: what is called is looked at
    text = text.replace("from isaaclab.actuators import ImplicitActuatorCfg", "")
    exec(text, {"ImplicitActuatorCfg": lambda **named: given.update(named)})
    told = numbers(exported)
    assert given["joint_names_expr"] == ["knee"]
    for name in ("armature", "friction", "dynamic_friction", "viscous_friction"):
        assert given[name] == told[name]


def bam_friction(p, motor, external, speed):
    """BAM's friction budget, eqs. of its paper and of bam/model.py, in our own words."""
    low = np.exp(-(np.abs(speed / p["dtheta_stribeck"]) ** p["alpha"])) if "alpha" in p else 0.0
    base = p["friction_base"] + low * p.get("friction_stribeck", 0.0)
    if "load_friction_base" in p:
        share = p["load_friction_base"] + low * p.get("load_friction_stribeck", 0.0)
        base = base + share * abs(external - motor)
    if "load_friction_motor" in p:
        inner = external * p["load_friction_external"] - motor * p["load_friction_motor"]
        base = base + abs(inner)
    return base + p["friction_viscous"] * abs(speed)


def test_bam_loses_about_as_much_in_steady_motion():
    """The mean over driving and back-driving is right to second order in mu."""
    done = found("servo-pendulum")
    p = json.loads(bf.export(done, "bam").main)
    assert p["model"] == "m3"
    vector, joint = middle(done), done.joint
    angle = vector[joint.names.index("load.gravity_angle")]
    weight = 9.80665 * vector[joint.names.index("load.first_moment")]
    mu = vector[joint.names.index("gearbox.load")]
    for q, speed in ((0.9, 1.5), (0.9, -1.5), (-0.4, 2.0)):
        ours = inverse_torque(joint, vector, [q], [speed], [0.0])[0]
        external = -weight * np.sin(q + angle)
        friction = ours + external  # of motor torque, after the load's
        theirs = np.sign(speed) * bam_friction(p, ours, external, speed)
        # and BAM counts what constant and viscous loss take of the motor among the load
        rest = p["load_friction_base"] * (p["friction_base"] + p["friction_viscous"] * abs(speed))
        assert theirs == pytest.approx(friction, abs=0.6 * mu**2 * abs(external) + 1.2 * rest)
    # about half of a mu
    assert p["load_friction_base"] == pytest.approx(mu / 2.0, rel=0.02)


def test_bam_told_apart_by_power_is_exact_in_steady_motion():
    joint = Joint(
        elements=(Element("motor", inertia=True), Element("gearbox", ratio=9.0, load_loss="two")),
        load=Load(inertia=True, first_moment=True),
    )
    values = {
        "motor.inertia": 1e-3,
        "gearbox.load_drive": 0.3,
        "gearbox.load_back": 0.25,
        "load.inertia": 0.05,
        "load.first_moment": 0.3,
    }
    p = parameters(joint, joint.vector(values), [])
    assert p["model"] == "m5"
    assert p["armature"] == pytest.approx(1e-3 * 81.0)
    p |= {"dtheta_stribeck": 0.2, "alpha": 1.0}  # of what has no rise
    for q, speed in ((0.9, 1.5), (0.9, -1.5)):
        motor = 9.0 * inverse_torque(joint, joint.vector(values), [q], [speed], [0.0])[0]
        external = -9.80665 * 0.3 * np.sin(q)
        theirs = np.sign(speed) * bam_friction(p, motor, external, speed)
        assert theirs == pytest.approx(motor + external, rel=1e-9)
