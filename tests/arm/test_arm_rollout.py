"""Roll-outs of an arm: closed forms, MuJoCo's forward dynamics, and a fitted arm."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from bayesfric.arm import arm_rollout
from bayesfric.arm.arm import Arm
from bayesfric.arm.arm_columns import layout_of
from bayesfric.arm.arm_log import ArmLog
from bayesfric.arm.arm_options import NUMBERS, Payload, Uncertainty
from bayesfric.arm.arm_rollout import rollout, simulate_arm
from bayesfric.arm.inertial_prior import Bodies
from bayesfric.base.errors import BadInput

from . import bench
from .bench import ELBOW, SHOULDER
from .test_arm import QUICK, TRUTH

pytestmark = pytest.mark.usefixtures("unexplained")
PERIOD = 0.005


def friction(**numbers):
    """Numbers of joints, the same in both directions; zero where left out."""
    zero = [0.0] * len(next(iter(numbers.values())))
    return {key: np.tile(numbers.get(key, zero), (2, 1)) for key in NUMBERS}


def simulated(dynamics, numbers, motion, effort):
    time, driven = PERIOD * np.arange(motion.shape[2]), np.arange(len(effort))
    return simulate_arm(dynamics, numbers, time, motion, effort, driven, time == 0.0)


def test_coulomb_friction_stops_a_joint_and_holds_it():
    """After ``v J / c`` and half as far as at its first speed; then less effort moves nothing."""
    inertia, coulomb, speed = 2.0, 3.0, 0.5
    motion = np.zeros((3, 1, 200))
    motion[1] = speed
    effort = np.zeros((1, 200))
    effort[0, 120:] = 0.99 * coulomb
    numbers = friction(armature=[0.5 * inertia], coulomb=[coulomb])
    (q,) = simulated(lambda *_: (np.array([[0.5 * inertia]]), np.zeros(1)), numbers, motion, effort)
    time, stops = PERIOD * np.arange(200), speed * inertia / coulomb
    assert stops < 120 * PERIOD
    t = np.minimum(time, stops)
    exact = speed * t - 0.5 * coulomb / inertia * t**2
    np.testing.assert_allclose(q, exact, atol=arm_rollout._STEP * speed)
    assert np.ptp(q[time > stops + PERIOD]) == 0.0


def test_friction_that_depends_on_direction_and_load():
    """The effort of uniform motion in each direction is the element's friction, and no other."""
    load = 4.0
    numbers = {
        "armature": np.full((2, 1), 0.1),
        "coulomb": np.array([[1.0], [2.0]]),
        "viscous": np.array([[0.5], [0.7]]),
        "load": np.array([[0.1], [0.3]]),
        "offset": np.full((2, 1), 0.2),
    }

    def dynamics(*_):
        return np.array([[1.0]]), np.array([load])

    for speed, effort in ((0.8, 1.0 + 0.4 + 0.1 * load), (-0.8, -2.0 - 0.56 - 0.3 * load)):
        motion = np.zeros((3, 1, 100))
        motion[1] = speed
        (q,) = simulated(dynamics, numbers, motion, np.full((1, 100), effort + load + 0.2))
        np.testing.assert_allclose(q, speed * PERIOD * np.arange(100), atol=1e-9)


def test_impulses_of_friction_minimise_their_convex_function():
    """By its subgradients: joints stick within the bounds, and slide at them."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        root = rng.normal(size=(4, 4))
        mass, free, loss = (
            root @ root.T + 0.1 * np.eye(4),
            rng.normal(size=4),
            rng.uniform(size=(2, 4)),
        )
        v = arm_rollout._with_friction(mass, free, loss, np.zeros(4))
        push = mass @ (free - v)
        assert np.all(push <= loss[0] + 1e-7)
        assert np.all(push >= -loss[1] - 1e-7)
        np.testing.assert_allclose(push[v > 1e-8], loss[0][v > 1e-8], atol=1e-7)
        np.testing.assert_allclose(push[v < -1e-8], -loss[1][v < -1e-8], atol=1e-7)


def test_motion_without_coulomb_friction_is_that_of_mujoco(tmp_path):
    (tmp_path / "arm.urdf").write_text(bench.urdf())
    bodies = Bodies(tmp_path / "arm.urdf", bench.GRAVITY)
    count = 200
    start, effort = np.array([0.4, -0.7]), np.array([3.0, -1.0])
    model = mujoco.MjModel.from_xml_string(bench.urdf())
    model.opt.gravity[:], model.opt.timestep = bench.GRAVITY, 1e-4
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    model.dof_armature[:], model.dof_damping[:] = (0.4, 0.2), (1.5, 0.8)
    data = mujoco.MjData(model)
    data.qpos[:] = start
    exact = [start]
    for _ in range(count - 1):
        for _ in range(round(PERIOD / 1e-4)):
            data.qfrc_applied[:] = effort
            mujoco.mj_step(model, data)
        exact.append(data.qpos.copy())
    motion = np.zeros((3, 2, count))
    motion[0, :, 0] = start
    numbers = friction(armature=[0.4, 0.2], viscous=[1.5, 0.8])
    dynamics = bodies.dynamics(bodies.prior(Uncertainty(), Payload()).columns(loaded=False)[:, 0])
    q = simulated(dynamics, numbers, motion, np.repeat(effort[:, None], count, axis=1))
    assert np.ptp(exact, axis=0).min() > 0.3
    np.testing.assert_allclose(q.T, exact, atol=1e-3)


@pytest.fixture(scope="module")
def predicting(arm):
    """The fitted arm with a log of another motion."""
    folder = arm.urdf.parent
    other = bench.log(bench.urdf(bench.FACTORS), TRUTH, seconds=10.0, seed=2, faster=1.37)
    other.to_csv(folder / "other.csv", index=False)
    options, joints = Arm(folder / "arm.urdf", QUICK).options, arm.bodies.joints
    layout, _ = layout_of(folder / "other.csv", joints, options)
    log = ArmLog(folder / "other.csv", "other", options, layout, joints, 10_000)
    return replace(arm, logs=(*arm.logs, log))


def test_bands_hold_another_motion(predicting):
    """20 repetitions: of 24 draws' ends 83 % are held, less than 50 once in a thousand times."""
    result = rollout(predicting, seconds=0.5, draws=24, seed=1)
    assert result.log == "other"
    record = result.as_json()
    assert set(record["held"]) == set(record["rms"]) == {SHOULDER, ELBOW}
    for name, coverage in record["held"].items():
        assert coverage > 0.5, name
        assert f"{name} {record['rms'][name]:.2g} rad off" in result.text()
    # and are narrow: a tenth of how far it moves
    low, _, high = result.bands
    assert np.all((high - low).mean(axis=1) < 0.1 * np.std(result.measured, axis=1))
    first, repeated = (rollout(predicting, seconds=0.5, draws=2, seed=1) for _ in range(2))
    assert first.as_csv() == repeated.as_csv()


def test_error_is_about_zero_and_not_about_a_mean():
    measured, restarts = np.zeros((1, 4)), np.array([True, False, False, False])
    bands = np.full((3, 1, 4), 0.3) + np.array([-0.1, 0.0, 0.1])[:, None, None]
    units, time = {"a": "rad"}, np.arange(4.0)
    result = arm_rollout.ArmRollOut("log", 0.5, units, time, restarts, measured, bands)
    assert result.rms == {"a": pytest.approx(0.3)}
    assert result.coverage == {"a": 0.0}


def test_unsupported_roll_outs_are_refused(arm):
    with pytest.raises(BadInput, match="seconds"):
        rollout(arm, seconds=1e-4)
    joint = arm.joints[ELBOW]
    names = [*joint.result.fit.chain.names[:-1], "motor.stribeck"]
    fit = SimpleNamespace(chain=SimpleNamespace(names=names))
    other = replace(joint, result=SimpleNamespace(fit=fit))
    with pytest.raises(BadInput, match=r"motor\.stribeck"):
        arm_rollout._friction(other, np.zeros((1, len(names))))
