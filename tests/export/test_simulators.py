"""Exports in the programs they are for, on SIMULATED recordings; what is not installed is skipped.

Run them with ``pip install bayesfric[simulators]``, and ``python-sdformat`` without what it wants.
"""

import json

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import inverse_torque

from .made import check_reported_torque, exported_vector, finished_posterior, numbers, rms, swung

NAMES = ("plain", "rabbit-knee", "servo-pendulum", "motor-axis")


def module(module):
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
    module("pinocchio")
    run = finished_posterior(name)
    exported = bf.export(run, "pinocchio")
    torque, period = swung(0.6, 2.0)
    motion = simulate(run.joint, exported_vector(run), torque, period, hold="zero").q
    assert rms(stepped(pinocchio_of(exported, tmp_path), torque, period) - motion) < 1e-3
    assert not exported.record["lost"]


def drake_of(text, kind):
    module("pydrake")
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
    run = finished_posterior(name)
    exported = bf.export(run, "drake")
    plant = drake_of(exported.main, "urdf")
    context, exported_numbers = plant.CreateDefaultContext(), numbers(exported)
    gain, offset = (
        exported_numbers["joint torque per motor torque"],
        exported_numbers.get("joint torque, less", 0.0),
    )
    from pydrake.multibody.tree import MultibodyForces

    def torque_of(q, qd, qdd):
        plant.SetPositions(context, [q])
        plant.SetVelocities(context, [qd])
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        torque = plant.CalcInverseDynamics(context, np.array([qdd]), forces)[0]
        return (torque + offset) / gain

    check_reported_torque(run, exported, torque_of)
    assert exported.record["lost"]


@pytest.mark.parametrize("name", NAMES)
def test_urdf_is_read_alike_by_yourdfpy_and_pinocchio(name, tmp_path):
    yourdfpy, pinocchio = module("yourdfpy"), module("pinocchio")
    exported = bf.export(finished_posterior(name), "urdf")
    path = tmp_path / "joint.urdf"
    path.write_text(exported.main)
    exported_numbers = numbers(exported)
    read = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=False)
    dynamics = read.joint_map["joint"].dynamics
    model = pinocchio.buildModelFromUrdf(str(path))
    assert float(dynamics.damping) == model.damping[0] == exported_numbers["dynamics damping"]
    assert float(dynamics.friction) == model.friction[0] == exported_numbers["dynamics friction"]
    data = model.createData()
    mass = pinocchio.crba(model, data, np.zeros(1))[0, 0]
    full = numbers(bf.export(finished_posterior(name), "csv"))
    inertia = full["armature"] + full.get("link_inertia", 0.0)
    assert mass == pytest.approx(inertia, rel=1e-9)
    weight = pinocchio.rnea(model, data, np.array([0.3]), np.zeros(1), np.zeros(1))[0]
    swing = np.sin(0.3 + full.get("link_gravity_angle", 0.0))
    assert weight == pytest.approx(9.81 * full.get("link_moment", 0.0) * swing, abs=1e-9)


@pytest.mark.parametrize("name", NAMES)
# pysdf's own use of what its libraries will take away
@pytest.mark.filterwarnings("ignore::DeprecationWarning:pysdf", "ignore:.*pkg_resources")
def test_sdf_is_read_alike_by_drake_and_pysdf(name):
    exported = bf.export(finished_posterior(name), "sdf")
    exported_numbers = numbers(exported)
    plant = drake_of(exported.main, "sdf")
    assert plant.GetJointByName("joint").default_damping() == exported_numbers["dynamics damping"]
    context = plant.CreateDefaultContext()
    full = numbers(bf.export(finished_posterior(name), "csv"))
    inertia = full["armature"] + full.get("link_inertia", 0.0)
    assert plant.CalcMassMatrix(context)[0, 0] == pytest.approx(inertia, rel=1e-9)
    pysdf = module("pysdf")
    joint = pysdf.SDF.from_xml(exported.main.partition("-->")[2]).models[0].joints[0]
    dynamics = joint.axis.dynamics
    assert float(dynamics.damping) == exported_numbers["dynamics damping"]
    assert float(dynamics.friction) == exported_numbers["dynamics friction"]


def test_isaac_lab_takes_the_keywords_that_are_written():
    exported = bf.export(finished_posterior("rabbit-knee"), "isaac", joint="knee")
    given = {}
    text = exported.files["knee_isaac_lab.py"]
    # its import needs a GPU's simulator: what is called is looked at
    text = text.replace("from isaaclab.actuators import ImplicitActuatorCfg", "")
    exec(text, {"ImplicitActuatorCfg": lambda **named: given.update(named)})
    exported_numbers = numbers(exported)
    assert given["joint_names_expr"] == ["knee"]
    for name in ("armature", "friction", "dynamic_friction", "viscous_friction"):
        assert given[name] == exported_numbers[name]


def bam_friction(p, motor, external, speed):
    """BAM's friction budget, eqs. of its paper and of bam/model.py."""
    low = np.exp(-(np.abs(speed / p["dtheta_stribeck"]) ** p["alpha"])) if "alpha" in p else 0.0
    base = p["friction_base"] + low * p.get("friction_stribeck", 0.0)
    share = p.get("load_friction_base", 0.0) + low * p.get("load_friction_stribeck", 0.0)
    return base + share * np.abs(external - motor) + p["friction_viscous"] * np.abs(speed)


@pytest.mark.parametrize(
    ("name", "model"), [("plain", "m1"), ("servo-pendulum", "m3"), ("rabbit-knee", "m3")]
)
def test_bam_is_the_nearest_to_the_law_along_the_motion(name, model):
    """No coefficient can move without a larger error of BAM's friction; torque as reported."""
    run = finished_posterior(name)
    exported = bf.export(run, "bam")
    p = json.loads(exported.main)
    assert p.pop("model") == model
    assert p.pop("actuator") == "mx106"
    vector, joint, o = exported_vector(run), run.joint, run.model.observations[0]
    q, v, a = o.q[o.filter.centres], o.qd[o.filter.centres], o.acceleration
    value = numbers(exported)
    full = numbers(bf.export(run, "csv"))
    gain, offset = full["gain"], full.get("torque_offset", 0.0)
    motor = gain * inverse_torque(joint, vector, q, v, a, inputs=o.inputs) - offset
    moment, angle = full["link_moment"], full.get("link_gravity_angle", 0.0)
    external = -joint.load.gravity * moment * np.sin(q + angle) - full.get("stiffness", 0.0) * q
    free = (full["armature"] + full.get("link_inertia", 0.0)) * a - external
    loss = np.sign(v) * (motor - free)

    def error(parameters):
        return rms(np.sign(v) * (bam_friction(parameters, motor, external, v) - loss))

    for key in set(p) - {"armature", "dtheta_stribeck", "alpha"}:
        for factor in (0.99, 1.01):
            assert p[key] == 0.0 or error(p | {key: factor * p[key]}) > error(p)
    assert value["armature"] == p["armature"] == full["armature"]
    # its own torque, in which friction depends on the motor's torque; it has no spring
    spring = full.get("stiffness", 0.0) * q
    free, external = free - spring, external + spring
    torque = free.copy()
    for _ in range(100):
        torque = free + np.sign(v) * bam_friction(p, torque, external, v)
    reported = exported.record["error"]["motor"]["rms"]
    assert rms((torque - motor) / gain) == pytest.approx(reported, rel=1e-6)
