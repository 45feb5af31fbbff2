"""Effort limits and mimic joints of an arm's exported files in the programs that read them."""

import numpy as np

from bayesfric.arm.exports import Identified, written_mjcf, written_urdf

from ..arm.test_arm_files import coupled

LIMIT, MULTIPLIER = 90.0, -1.0 / 3.0  # of ``coupled``, as effort of the first joint


def mujoco(path, _form):
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    return model.jnt_actfrcrange[0, 1], model.eq_data[0, 1] if model.neq else 0.0


def newton(path, form):
    import newton
    import warp

    warp.config.quiet = True
    builder = newton.ModelBuilder()
    (builder.add_urdf if form == "arm-urdf" else builder.add_mjcf)(str(path))
    model = builder.finalize(device="cpu")
    coefficients = [*model.constraint_mimic_coef1.numpy()] if model.constraint_mimic_count else []
    follower = model.joint_mimic_joint.numpy() if model.joint_mimic_joint is not None else []
    if np.any(np.asarray(follower) >= 0):
        coefficients = [model.joint_mimic_coeffs.numpy()[np.argmax(follower), 1]]
    return model.joint_effort_limit.numpy()[-2], [*coefficients, 0.0][0]


def pinocchio(path, form):
    import pinocchio

    if form == "arm-mujoco":
        model = pinocchio.buildModelFromMJCF(str(path))
        return model.effortLimit[0], 0.0 if model.nv == 2 else MULTIPLIER
    model = pinocchio.buildModelFromUrdf(str(path), mimic=True)
    return model.effortLimit[0], 0.0 if model.nv == 2 else MULTIPLIER


def drake(path, _form):
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    plant = MultibodyPlant(1e-3)
    Parser(plant).AddModels(str(path))
    plant.Finalize()
    limits = [plant.get_joint_actuator(i).effort_limit() for i in plant.GetJointActuatorIndices()]
    limits = [x for x in limits if np.isfinite(x)]
    return limits[0] if limits else 0.0, MULTIPLIER if plant.num_constraints() else 0.0


def idyntree(path, _form):
    import idyntree.bindings as idyntree

    loader = idyntree.ModelLoader()
    assert loader.loadModelFromFile(str(path))
    model = loader.model()
    joint = model.getJoint(model.getJointIndex("shoulder_joint"))
    limit = joint.getEffortLimit(0) if joint.hasEffortLimits() else 0.0
    return limit, 0.0 if model.getNrOfDOFs() == 2 else MULTIPLIER


def pybullet(path, _form):
    import pybullet

    pybullet.connect(pybullet.DIRECT)
    body = pybullet.loadURDF(str(path), useFixedBase=True)
    return pybullet.getJointInfo(body, 0)[10], MULTIPLIER if pybullet.getNumConstraints() else 0.0


def roboticstoolbox(path, _form):
    import roboticstoolbox

    robot = roboticstoolbox.Robot.URDF(str(path))
    return 0.0, 0.0 if robot.n == 2 else MULTIPLIER  # its links have no limit of effort


BOTH = ("arm-urdf", "arm-mujoco")
ARM_PROGRAMS = {
    "mujoco": (BOTH, mujoco),
    "newton-mujoco": (BOTH, newton),
    "pinocchio": (BOTH, pinocchio),
    "drake": (BOTH, drake),
    "idyntree": (BOTH[:1], idyntree),
    "pybullet": (BOTH[:1], pybullet),
    "roboticstoolbox": (BOTH[:1], roboticstoolbox),
}


def arm_row(name, form, folder):
    """Measure which of effort limit and mimic joint arrive."""
    identified = Identified({"shoulder_joint": {"viscous": 1.0}}, {}, [])
    urdf = coupled(folder)
    write = written_urdf if form == "arm-urdf" else written_mjcf
    path = folder / f"{form}.{'urdf' if form == 'arm-urdf' else 'xml'}"
    path.write_text(write(urdf, identified))
    limit, multiplier = ARM_PROGRAMS[name][1](path, form)
    row = {"effort_limit": float(limit) / LIMIT, "mimic": float(multiplier) / MULTIPLIER}
    return {key: abs(round(x, 6)) for key, x in row.items()}
