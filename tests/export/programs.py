"""What programs take of exported files, measured in them on a SIMULATED joint.

``python -m tests.export.programs`` loads every file in every program that is installed, and writes
``bayesfric/export/programs.toml``; rows of what is not installed stay as they were seen last.
"""

import importlib
import logging
import os
import sys
import tempfile
import tomllib
import warnings
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import tomlkit

from bayesfric.export.exported import export_to
from bayesfric.export.formats import formats
from bayesfric.export.joint_model import (
    Trajectory,
    exact_numbers,
    simulator_numbers,
    torque_along,
)
from bayesfric.export.programs import programs
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.measurement import Inputs
from tests.conftest import REPOSITORY

from .arm_programs import ARM_PROGRAMS, arm_row
from .made import exported_vector, posterior_of, preset, rms

GRAVITY = 9.7  # not a program's default
STEP = 1e-4  # s, of programs that only step


class Loaded(NamedTuple):
    """A file in a program: its torque at the joint for a motion, and numbers that it stores."""

    # of (q, qd, qdd), or of BAM's (motor torque, external torque, speed); None without dynamics
    torque: Any = None
    link_inertia: float | None = None  # of a body without weight that is not of the file
    stored: Mapping[str, float] = MappingProxyType({})
    acts: Mapping[str, float] = MappingProxyType(
        {}
    )  # numbers of the drive that it was seen to apply
    warned: str = ""


def by_steps(accelerate):
    """Torque for a motion of a program that only gives accelerations, by a secant."""

    def torque(q, qd, qdd):
        at = 0.0
        for width in (200.0, 5.0):  # MuJoCo's friction turns with 105 qd + qdd: end near it
            low, high = (accelerate(q, qd, at + x) for x in (-width, width))
            at += width * (2.0 * (qdd - low) / (high - low) - 1.0)
        return at

    return torque


# ------------------------------------------------------------------ programs


def mujoco(path, form):
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    if form != "mujoco":
        model.opt.gravity[2] = -GRAVITY
    data = mujoco.MjData(model)

    def torque(q, qd, qdd):
        data.qpos[0], data.qvel[0], data.qacc[0] = q, qd, qdd
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse[0]

    return Loaded(torque, acts=mujoco_drive(model) if model.nu else {})


def mujoco_drive(model):
    import mujoco

    data, torques = mujoco.MjData(model), []
    for control in (0.0, 1.0):
        data.ctrl[0] = control
        mujoco.mj_forward(model, data)
        torques.append(data.qfrc_actuator[0])
    return {"gain": torques[1] - torques[0], "torque_offset": -torques[0]}


def mujoco_warp(path, _form):
    import mujoco
    import mujoco_warp as mjw
    import warp

    warp.config.quiet = True
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    on_warp, state = mjw.put_model(model), mjw.put_data(model, data)

    def torque(q, qd, qdd):
        for array, x in ((state.qpos, q), (state.qvel, qd), (state.qacc, qdd)):
            array.fill_(x)
        mjw.inverse(on_warp, state)
        return float(state.qfrc_inverse.numpy()[0, 0])

    drive = []
    for control in (0.0, 1.0):
        state.ctrl.fill_(control)
        mjw.forward(on_warp, state)
        drive.append(float(state.qfrc_actuator.numpy()[0, 0]))
    return Loaded(torque, acts={"gain": drive[1] - drive[0], "torque_offset": -drive[0]})


def newton(path, form, solver):
    import newton
    import warp

    warp.config.quiet = True
    own = {} if form == "mujoco" else {"gravity": (0.0, 0.0, -GRAVITY)}
    builder = newton.ModelBuilder(**own)
    if form == "isaac":
        builder.add_usd(str(path), schema_resolvers=[newton.usd.SchemaResolverNewton()])
    else:
        (builder.add_mjcf if form == "mujoco" else builder.add_urdf)(str(path))
    model = builder.finalize(device="cpu")
    more = {"use_mujoco_cpu": True} if solver == "MuJoCo" else {}
    stepper = getattr(newton.solvers, f"Solver{solver}")(model, **more)
    dof, coordinate = model.joint_dof_count - 1, model.joint_coord_count - 1

    def accelerate(q, qd, torque):
        before, after, control = model.state(), model.state(), model.control()
        for array, k, x in (
            (before.joint_q, coordinate, q),
            (before.joint_qd, dof, qd),
            (control.joint_f, dof, torque),
        ):
            values = array.numpy()
            values[k] = x
            array.assign(values)
        newton.eval_fk(model, before.joint_q, before.joint_qd, before)
        stepper.step(before, after, control, None, STEP)
        return (float(after.joint_qd.numpy()[dof]) - qd) / STEP

    stored = {"armature": "armature", "friction": "friction", "damping": "damping"}
    stored = {x: float(getattr(model, f"joint_{y}").numpy()[dof]) for x, y in stored.items()}
    inertia = 1.0 if form == "isaac" else None  # of STAGE
    return Loaded(by_steps(accelerate), inertia, stored | {"static_friction": 0.0})


def pinocchio(path, form):
    import pinocchio

    if form == "pinocchio":
        loader: dict = {"__file__": str(path.with_name("joint_pinocchio.py"))}
        exec(path.with_name("joint_pinocchio.py").read_text(), loader)
        model = loader["load"]()
        data = model.createData()

        def accelerate(q, qd, torque):
            return (loader["step"](model, data, q, qd, torque, STEP)[1] - qd) / STEP

        start = loader["joint_torque"](0.0)
        drive = {"gain": loader["joint_torque"](1.0) - start, "torque_offset": -start}
        return Loaded(by_steps(accelerate), acts=drive)
    kind = {"mujoco": "MJCF"}.get(form, "Urdf")
    model = getattr(pinocchio, f"buildModelFrom{kind}")(str(path))
    if kind != "MJCF":
        model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    data = model.createData()

    def torque(q, qd, qdd):
        return pinocchio.rnea(model, data, *(np.array([x]) for x in (q, qd, qdd)))[0]

    names = ("armature", "damping", "friction")
    stored = {name: float(getattr(model, name)[0]) for name in names}
    drive = {"gain": 0.0, "torque_offset": 0.0} if kind == "MJCF" else {}  # it has no actuators
    return Loaded(torque, None, stored, drive)


def drake(path, form):
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import MultibodyForces

    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(path))
    if plant.HasBodyNamed("base"):
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    if form != "mujoco":
        plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -GRAVITY])
    plant.Finalize()
    context = plant.CreateDefaultContext()

    def torque(q, qd, qdd):
        plant.SetPositions(context, [q])
        plant.SetVelocities(context, [qd])
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        return plant.CalcInverseDynamics(context, np.array([qdd]), forces)[0]

    acts = {}
    if form == "mujoco" and plant.num_actuators():
        plant.SetPositions(context, [0.0])
        plant.SetVelocities(context, [0.0])
        driven = []
        for control in (0.0, 1.0):
            plant.get_actuation_input_port().FixValue(context, [control])
            derivatives = plant.EvalTimeDerivatives(context).CopyToVector()[1]
            driven.append(derivatives * plant.CalcMassMatrix(context)[0, 0])
        acts = {"gain": driven[1] - driven[0], "torque_offset": 0.0}
    return Loaded(torque, acts=acts)


def idyntree(path, _form):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import idyntree.bindings as idyntree

    loader = idyntree.ModelLoader()
    assert loader.loadModelFromFile(str(path))
    engine, model = idyntree.KinDynComputations(), loader.model()
    engine.loadRobotModel(model)
    free = idyntree.FreeFloatingGeneralizedTorques(model)
    wrenches = idyntree.LinkWrenches(model)

    def torque(q, qd, qdd):
        down = np.array([0.0, 0.0, -GRAVITY])
        engine.setRobotState(np.eye(4), np.array([q]), np.zeros(6), np.array([qd]), down)
        engine.inverseDynamics(np.zeros(6), np.array([qdd]), wrenches, free)
        return float(free.jointTorques().toNumPy()[0])

    joint = model.getJoint(model.getJointIndex("joint"))
    stored = {"damping": joint.getDamping(0), "friction": joint.getStaticFriction(0)}
    return Loaded(torque, None, stored)


def pybullet(path, _form):
    import pybullet

    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0.0, 0.0, -GRAVITY)
    pybullet.setTimeStep(STEP)
    body = pybullet.loadURDF(
        str(path), useFixedBase=True, flags=pybullet.URDF_USE_INERTIA_FROM_FILE
    )
    pybullet.setJointMotorControl2(body, 0, pybullet.VELOCITY_CONTROL, force=0.0)

    def accelerate(q, qd, torque):
        pybullet.resetJointState(body, 0, q, qd)
        pybullet.setJointMotorControl2(body, 0, pybullet.TORQUE_CONTROL, force=torque)
        pybullet.stepSimulation()
        return (pybullet.getJointState(body, 0)[1] - qd) / STEP

    info = pybullet.getJointInfo(body, 0)
    assert client >= 0
    return Loaded(by_steps(accelerate), None, {"damping": info[6], "friction": info[7]})


def roboticstoolbox(path, _form):
    import roboticstoolbox

    robot = roboticstoolbox.Robot.URDF(str(path))
    robot.gravity = [0.0, 0.0, -GRAVITY]

    def torque(q, qd, qdd):
        return float(np.ravel(robot.rne(*(np.array([x]) for x in (q, qd, qdd))))[0])

    (link,) = (x for x in robot.links if x.isjoint)
    stored = {"damping": float(link.B), "friction": float(np.max(np.abs(link.Tc)))}
    return Loaded(torque, None, stored)


def genesis(path, form):
    import genesis
    import torch

    if not genesis._initialized:
        genesis.init(backend=genesis.cpu, precision="64", logging_level="error")
    options = genesis.options.SimOptions(dt=STEP, gravity=(0.0, 0.0, -GRAVITY))
    scene = genesis.Scene(show_viewer=False, sim_options=options)
    morphs = genesis.morphs
    file = (
        morphs.MJCF(file=str(path)) if form == "mujoco" else morphs.URDF(file=str(path), fixed=True)
    )
    joint = scene.add_entity(file)
    scene.build()

    def accelerate(q, qd, torque):
        joint.set_dofs_position(torch.tensor([q]))
        joint.set_dofs_velocity(torch.tensor([qd]))
        joint.control_dofs_force(torch.tensor([torque]))
        scene.step()
        return (float(joint.get_dofs_velocity()[0]) - qd) / STEP

    return Loaded(by_steps(accelerate))


def brax(path, _form):
    import jax
    from brax import actuator
    from brax.generalized import pipeline
    from brax.io import mjcf

    # its pipeline steps by Euler's method, a model with geometry
    text = path.read_text().replace("implicitfast", "Euler")
    text = text.replace("<inertial", '<geom size="0.01" contype="0" conaffinity="0"/><inertial')
    system = mjcf.loads(text).tree_replace({"opt.timestep": STEP})
    step = jax.jit(partial(pipeline.step, system))
    start = jax.jit(partial(pipeline.init, system))

    def accelerate(q, qd, control):
        state = start(np.array([q]), np.array([qd]))
        return (float(step(state, np.array([control])).qd[0]) - qd) / STEP

    still = np.zeros(1)
    start_torque, driven = (
        float(actuator.to_tau(system, np.array([x]), still, still)[0]) for x in (0.0, 1.0)
    )
    gain = driven - start_torque
    torque = by_steps(lambda q, qd, x: accelerate(q, qd, (x - start_torque) / gain))
    return Loaded(torque, acts={"gain": gain, "torque_offset": -start_torque})


def bam(path, _form):
    import json

    from bam.model import load_model

    model = load_model(str(path))

    def loss(motor, external, speed):
        friction, damping = model.compute_frictions(motor, external, speed)
        return friction + damping * abs(speed)

    states = np.random.default_rng(1).normal(size=(20, 3))
    columns = [[1.0, abs(speed), abs(external - motor)] for motor, external, speed in states]
    names = ("friction", "damping", "load_friction")
    fitted = np.linalg.lstsq(np.array(columns), [loss(*state) for state in states])[0]
    acts = dict(zip(names, fitted, strict=True))
    return Loaded(loss, acts=acts | {"armature": json.loads(path.read_text()).get("armature", 0.0)})


def usd(path, _form):
    from pxr import Usd

    stage = Usd.Stage.Open(str(path))
    prim = stage.GetPrimAtPath("/joint")
    names = {
        "armature": "armature",
        "static_friction": "staticFrictionEffort",
        "friction": "dynamicFrictionEffort",
        "damping": "viscousFrictionCoefficient",
    }
    stored = {
        number: prim.GetAttribute(f"physxJointAxis:angular:{name}").Get()
        for number, name in names.items()
    }
    return Loaded(stored=stored | {"damping": stored["damping"] * 180.0 / np.pi})


_EVERY = ("mujoco", "urdf", "isaac")
_SOLVERS = {"MuJoCo": "newton mujoco_warp", "Featherstone": "newton"}
# Program: modules, distribution, formats, reader.
PROGRAMS = {
    "mujoco": ("mujoco", "mujoco", ("mujoco", "urdf"), mujoco),
    "mujoco-warp": ("mujoco_warp", "mujoco-warp", ("mujoco",), mujoco_warp),
    **{
        f"newton-{solver.lower()}": (modules, "newton", _EVERY, partial(newton, solver=solver))
        for solver, modules in _SOLVERS.items()
    },
    "pinocchio": ("pinocchio", "pin", ("mujoco", "urdf", "pinocchio"), pinocchio),
    "drake": ("pydrake", "drake", ("mujoco", "urdf", "sdf", "drake"), drake),
    "idyntree": ("idyntree", "idyntree", ("urdf",), idyntree),
    "pybullet": ("pybullet", "pybullet", ("urdf",), pybullet),
    "roboticstoolbox": (
        "roboticstoolbox", "roboticstoolbox-python", ("urdf",), roboticstoolbox,
    ),
    "genesis": ("genesis", "genesis-world", ("mujoco", "urdf"), genesis),
    "brax": ("brax", "brax", ("mujoco",), brax),
    "bam": ("bam", "better-actuator-models", ("bam",), bam),
    "usd-core": ("pxr.Usd", "usd-core", ("isaac",), usd),
}  # fmt: skip


# --------------------------------------------------------------- measurement


@cache
def run_of(name):
    """Posterior of a joint with every number that formats have, or of one with load friction."""
    if name == "rabbit-knee":
        joint, values = preset(name)
        joint = replace(joint, load=replace(joint.load, gravity=GRAVITY))
        return posterior_of(joint, values, 0.6, spread=0.0)
    losses = {"coulomb": "symmetric", "viscous": True, "quadratic": True}
    load = Load(
        inertia=True, first_moment=True, gravity_angle=True, spring="stiffening", gravity=GRAVITY
    )
    motor = Element("motor", ratio=50.0, inertia=True)
    joint = Joint(elements=(motor, Element("joint", **losses)), load=load, offset=True)
    numbers = (3.56e-4, 5.0, 13.12, 0.5, 0.206, 0.42, 0.1, 2.0, 0.3, 0.01)
    names = "motor.inertia joint.coulomb joint.viscous joint.quadratic load.inertia"
    names += " load.first_moment load.gravity_angle load.spring load.spring_cubic offset"
    return posterior_of(joint, dict(zip(names.split(), numbers, strict=True)), 0.6, spread=0.0)


def states():
    """Forty states that move: positions, speeds and accelerations."""
    rng = np.random.default_rng(7)
    speed = rng.uniform(0.5, 3.0, 40) * rng.choice([-1.0, 1.0], 40)
    return np.array([rng.uniform(-3.0, 3.0, 40), speed, rng.uniform(-20.0, 20.0, 40)])


def chirp():
    """Sine of .2 to .8 Hz in 4 s, where it moves: not faster than the recorded motion."""
    t = np.linspace(0.02, 4.0, 100)
    phase, rate = 2 * np.pi * (0.2 * t + 0.075 * t**2), 2 * np.pi * (0.2 + 0.15 * t)
    wave = np.array([np.sin(phase), rate * np.cos(phase), 0.0 * t])
    wave[2] = 2 * np.pi * 0.15 * np.cos(phase) - rate**2 * np.sin(phase)
    return 0.25 * wave[:, 0.25 * np.abs(wave[1]) > 0.1]


def fitted_numbers(torque, expected):
    """Least squares for the numbers of a simulator's joint in a program's torque."""
    q, v, a = states()
    ones = np.ones_like(q)
    columns = [a, v, v * np.abs(v), np.sign(v), np.sin(q), np.cos(q), q, q**3, -ones]
    y = np.array([torque(*row) for row in zip(q, v, a, strict=True)])
    x = np.linalg.lstsq(np.stack(columns, axis=1), y)[0]
    angle, link = expected.get("link_gravity_angle", 0.0), expected.get("link_inertia", 1.0)
    moment = (x[4] * np.cos(angle) + x[5] * np.sin(angle)) / GRAVITY
    return {
        "armature": x[0] - link,
        "link_inertia": min(x[0], link),
        "damping": x[1],
        "quadratic": x[2],
        "friction": x[3],
        "link_moment": moment,
        "stiffness": x[6],
        "stiffness_cubic": x[7],
    }


def load(name, form, exported, folder):
    """Load the files of an export in a program; what it writes or warns goes with it."""
    for file, text in exported.files.items():
        (folder / file).write_text(text)
    main = folder / {"isaac": "joint.usda"}.get(form, next(iter(exported.files)))
    if form == "isaac" and name != "usd-core":
        over = main.read_text().partition('over "joint"')[2].partition("{")[2]
        main.write_text(STAGE.replace("OVER", over.rpartition("}")[0]))
    log, kept = folder / "log.txt", [os.dup(1), os.dup(2)]
    with log.open("w") as file, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        handler = logging.StreamHandler(file)
        logging.getLogger().addHandler(handler)
        for k in (1, 2):
            os.dup2(file.fileno(), k)
        try:
            loaded = PROGRAMS[name][3](main, form)
        finally:
            logging.getLogger().removeHandler(handler)
            for k, old in zip((1, 2), kept, strict=True):
                os.dup2(old, k)
                os.close(old)
    said = log.read_text(errors="replace") + " ".join(str(x.message) for x in caught)
    return loaded._replace(warned=said)


def exported_to(form, run, leave_out=()):
    """Export with some numbers left out of the format."""
    return export_to(formats()[form].without(leave_out), run)


def read(name, form, run, leave_out):
    """Factors of the numbers in a program, those that it only stores, and what it warns of.

    Last the armature that it adds to a file without one.
    """
    exported = exported_to(form, run, leave_out)
    expected = expected_numbers(exported, form)
    with tempfile.TemporaryDirectory() as folder:
        loaded = load(name, form, exported, Path(folder))
        measured = dict(loaded.acts)
        if loaded.torque is not None and form != "bam":
            measured |= fitted_numbers(loaded.torque, expected)
    factors, stored = {}, []
    for number, value in expected.items():
        if not value or number == "link_gravity_angle":
            continue
        if number in ("gain", "torque_offset") and number not in measured:
            continue  # not in the file, or the program was driven at the joint
        factor = measured.get(number, 0.0) / value
        kept = loaded.stored.get(number, 0.0) / value
        if abs(factor) < 0.03 and abs(kept - 1.0) < 1e-3:
            stored.append(number)
        near = round(factor)
        factors[number] = float(near if abs(factor - near) < 0.03 else round(factor, 3))
    warned = [x for x in factors if not factors[x] and x in loaded.warned.lower()]
    added = 0.0 if "armature" in expected else round(measured.get("armature", 0.0), 3)
    return factors, stored, warned, {"armature": added} if added > 0.01 else {}


def expected_numbers(exported, form):
    """Numbers that the format has, as they were written."""
    names = formats()[form].names
    rows = {row["attribute"]: row["value"] for row in exported.record["numbers"]}
    return {number: rows.get(attribute, 0.0) for attribute, number in names.items()}


# Numbers that not all readers know: in MJCF they are written in a form of their own.
_SUSPECTS = {
    "mujoco": ("quadratic", "stiffness_cubic", "torque_offset"),
    "urdf": ("friction",),
}


def measured(name, form):
    """Measure a program's row without suspects, and what each of these spoils."""
    run = run_of("every number" if form != "bam" else "rabbit-knee")
    suspects = _SUSPECTS.get(form, ())
    base, stored, warned, _ = read(name, form, run, suspects)
    adds = read(name, form, run, (*suspects, "armature"))[3]
    takes, spoils = dict(base), {}
    for number in suspects:
        rest = [x for x in suspects if x != number]
        try:
            factors, also_stored, also_warned, _ = read(name, form, run, rest)
        except Exception:  # whatever a program raises: it refuses the file
            spoils[number], takes[number] = [], 0.0
            continue
        takes |= {x: factors.pop(x) for x in (number,) if x in factors}
        lost = {x for x in stored if x not in also_stored}
        lost |= {x for x, f in factors.items() if f != base[x]}
        if lost:
            spoils[number] = sorted(lost)
        stored += [x for x in also_stored if x == number]
        warned += [x for x in also_warned if x == number]
    return {"takes": takes, "stored": stored, "warns": warned, "spoils": spoils, "adds": adds}


def motion_of(what):
    """Ten states within what the knee was recorded at, or a chirp."""
    return chirp() if "chirp" in what else states()[:, :10] * np.array([[0.1], [0.4], [0.5]])


# Motions of laws: with load friction, and with every number, a quadratic loss among them.
MOTIONS = {
    "states": "rabbit-knee",
    "chirp": "rabbit-knee",
    "quadratic chirp": "every number",
}


def torque_errors(name, form):
    """Errors of torque at ten states and along chirps, N m rms at the joint, by motion.

    Of the program with the plain file and with that for it (None where it refuses one), of the
    numbers of the latter file, which is what the program's format cannot carry, and the rms of the
    law itself.
    """
    errors = {}
    for what, law_name in MOTIONS.items():
        run, motion = run_of(law_name), motion_of(what)
        joint, vector = run.joint, exported_vector(run)[None]
        path = [Trajectory(*motion, np.zeros(motion.shape[1]), Inputs())]
        exact = {key: float(x[0]) for key, x in exact_numbers(joint, vector).items()}
        gain, offset = exact["gain"], exact["torque_offset"]
        law = gain * torque_along(joint, vector, path)[0] - offset
        row = []
        for leave_out in ((), programs()[form][name].unused):
            exported = exported_to(form, run, leave_out)
            with tempfile.TemporaryDirectory() as folder:
                try:
                    loaded = load(name, form, exported, Path(folder))
                    row.append(rms(seen(loaded, form, exact, motion) - law))
                except Exception:  # whatever a program raises: it refuses the file
                    row.append(None)
        target = formats()[form].without(leave_out)
        recorded = [Trajectory.of(o) for o in run.model.observations]
        numbers = simulator_numbers(joint, vector, recorded, target.carried)
        carried = gain * target.torque(joint, vector, numbers, path)[0] - offset
        row += [rms(carried - law), rms(law)]
        # what rounding leaves is 0
        errors[what] = ["refused" if x is None else float(f"{x:.3g}") * (x > 1e-4) for x in row]
    return errors


def seen(loaded, form, exact, motion):
    """Torque at the joint of a program along a motion, with the link of the law."""
    weight = GRAVITY * exact["link_moment"] * np.sin(motion[0] + exact["link_gravity_angle"])
    if form == "bam":
        free = (exact["armature"] + exact["link_inertia"]) * motion[2] + weight
        torque = free.copy()
        for k, speed in enumerate(motion[1]):
            for _ in range(100):  # its friction depends on the motor's torque
                loss = loaded.torque(torque[k], -weight[k], speed)
                torque[k] = free[k] + np.sign(speed) * loss
        return torque
    torque = np.array([loaded.torque(*state) for state in motion.T])
    if loaded.link_inertia is None:
        return torque
    return torque + (exact["link_inertia"] - loaded.link_inertia) * motion[2] + weight


def main(*names):
    """Measure in every program (or those named) that is installed; the rows of others stay."""
    path = files("bayesfric.export") / "programs.toml"
    rows = tomllib.loads(path.read_text())
    for name, (modules, distribution, forms, _) in PROGRAMS.items():
        if names and name not in names:
            continue
        try:
            for module in modules.split():
                importlib.import_module(module)
        except ImportError as error:
            print(f"{name}: not measured again, {error}")
            continue
        for form in forms:
            row = {"version": version(distribution), **measured(name, form)}
            rows.setdefault(form, {})[name] = {key: x for key, x in row.items() if x}
            path.write_text(tomlkit.dumps(rows))
            programs.cache_clear()
            if name != "usd-core":  # no dynamics
                rows[form][name]["torque"] = torque_errors(name, form)
        for form in ARM_PROGRAMS.get(name, ((), None))[0]:
            with tempfile.TemporaryDirectory() as folder:
                row = {"version": version(distribution), "takes": arm_row(name, form, Path(folder))}
            rows.setdefault(form, {})[name] = row
    path.write_text(written(rows))
    programs.cache_clear()
    page = REPOSITORY / "studies" / "reference" / "simulators.md"
    before, mark, rest = page.read_text().partition("<!-- programs -->\n")
    page.write_text(
        before + mark + table(rows) + "\n<!-- end -->" + rest.partition("<!-- end -->")[2]
    )


def table(rows):
    """Tabulate all programs for the page, a row each."""
    titles = ["`--to`", "`--for`", "arrives", "stored only", "lost", *MOTIONS]
    lines = [f"| {' | '.join(titles)} |", "|---" * len(titles) + "|"]
    for form, of_form in rows.items():
        for name, row in of_form.items():
            takes, stored, warns = row["takes"], row.get("stored", []), row.get("warns", [])
            lost = [x for x, factor in takes.items() if not factor and x not in stored]
            spoils = row.get("spoils", {}).items()
            cells = [
                [x if f == 1.0 else f"{x} times {f:.4g}" for x, f in takes.items() if f],
                sorted(stored),
                [f"{x} (it warns)" if x in warns else x for x in lost]
                + [f"with {x}: {', '.join(names) or 'refused'}" for x, names in spoils]
                + [f"adds {amount:g} to {x}" for x, amount in row.get("adds", {}).items()],
                *([torque_cell(*row["torque"][x])] if "torque" in row else [] for x in MOTIONS),
            ]
            texts = " | ".join(", ".join(cell).replace("_", " ") for cell in cells)
            lines.append(f"| `{form}` | `{name}` {row['version']} | {texts} |")
    return "\n".join(lines)


def torque_cell(*errors):
    """Write the errors of a row in N m, and in per cent of the law."""
    *errors, size = errors
    texts = [x if x == "refused" else f"{x:g} ({100 * x / size:.1f} %)" for x in errors]
    return "{} → {}; {}".format(*texts)


def written(rows):
    """Write rows as TOML, a line a key."""
    lines = ["# Made by python -m tests.export.programs."]
    for form, of_form in rows.items():
        for name, row in of_form.items():
            lines.append(f"\n[{form}.{name}]")
            for key, value in row.items():
                lines.append(f"{key} = {tomlkit.item(inline(value)).as_string()}")
    return "\n".join(lines) + "\n"


def inline(value):
    if not isinstance(value, dict):
        return value
    out = tomlkit.inline_table()
    out.update(value)
    return out


STAGE = """#usda 1.0
(
    upAxis = "Z"
    metersPerUnit = 1
    kilogramsPerUnit = 1
)
def Xform "robot" (prepend apiSchemas = ["PhysicsArticulationRootAPI"])
{
    def Xform "base" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"])
    {
        float physics:mass = 1
        float3 physics:diagonalInertia = (1, 1, 1)
    }
    def Xform "link" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"])
    {
        float physics:mass = 1
        float3 physics:diagonalInertia = (1, 1, 1)
    }
    def PhysicsFixedJoint "fixed"
    {
        rel physics:body1 = </robot/base>
    }
    def PhysicsRevoluteJoint "joint"
    {
        uniform token physics:axis = "Y"
        rel physics:body0 = </robot/base>
        rel physics:body1 = </robot/link>
OVER
    }
}
"""


if __name__ == "__main__":
    main(*sys.argv[1:])
