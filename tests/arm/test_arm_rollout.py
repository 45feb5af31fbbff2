"""Roll-outs of an arm: closed forms, MuJoCo's forward dynamics, and a fitted arm."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from bayesfric.arm import arm_rollout
from bayesfric.arm.arm import Arm
from bayesfric.arm.arm_log import ArmLog, layout_of
from bayesfric.arm.arm_options import NUMBERS, Payload, Uncertainty
from bayesfric.arm.arm_rollout import rollout, simulate_arm
from bayesfric.arm.inertial_prior import Bodies
from bayesfric.base.errors import BadInput

from . import bench
from .bench import ELBOW, SHOULDER
from .test_arm import QUICK, TRUTH

pytestmark = pytest.mark.usefixtures("unexplained")
PERIOD = 0.005


def friction(**more):
    """Numbers of joints, forwards and backwards alike; nothing of what is not named."""
    count = len(next(iter(more.values())))
    return {key: np.tile(more.get(key, [0.0] * count), (2, 1)) for key in NUMBERS}


def played(dynamics, numbers, motion, effort):
    count = motion.shape[2]
    time, on = PERIOD * np.arange(count), np.arange(len(effort))
    return simulate_arm(dynamics, numbers, time, motion, effort, on, time == 0.0)


def test_coulomb_friction_stops_a_joint_and_holds_it():
    """After ``v J / c`` and half as far as at its first speed; then less effort moves nothing."""
    inertia, coulomb, speed = 2.0, 3.0, 0.5
    motion = np.zeros((3, 1, 200))
    motion[1] = speed
    effort = np.zeros((1, 200))
    effort[0, 120:] = 0.99 * coulomb
    numbers = friction(armature=[0.5 * inertia], coulomb=[coulomb])
    (q,) = played(lambda *_: (np.array([[0.5 * inertia]]), np.zeros(1)), numbers, motion, effort)
    time, stops = PERIOD * np.arange(200), speed * inertia / coulomb
    assert stops < 120 * PERIOD
    t = np.minimum(time, stops)
    exact = speed * t - 0.5 * coulomb / inertia * t**2
    np.testing.assert_allclose(q, exact, atol=arm_rollout._STEP * speed)
    assert np.ptp(q[time > stops + PERIOD]) == 0.0


def test_friction_that_depends_on_direction_and_load():
    """Of uniform motion either way the effort is what the paper's element loses, and no other."""
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
        (q,) = played(dynamics, numbers, motion, np.full((1, 100), effort + load + 0.2))
        np.testing.assert_allclose(q, speed * PERIOD * np.arange(100), atol=1e-9)


def test_several_joints_stick_and_slide_as_their_impulses_allow():
    """The speeds minimise what they are to, better than any near them (subgradients)."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        root = rng.normal(size=(4, 4))
        mass, free, lost = (
            root @ root.T + 0.1 * np.eye(4),
            rng.normal(size=4),
            rng.uniform(size=(2, 4)),
        )
        v = arm_rollout._with_friction(mass, free, lost, np.zeros(4))
        push = mass @ (free - v)
        assert np.all(push <= lost[0] + 1e-7)
        assert np.all(push >= -lost[1] - 1e-7)
        np.testing.assert_allclose(push[v > 1e-8], lost[0][v > 1e-8], atol=1e-7)
        np.testing.assert_allclose(push[v < -1e-8], -lost[1][v < -1e-8], atol=1e-7)


def test_without_coulomb_friction_it_moves_as_in_mujoco(tmp_path):
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
    q = played(dynamics, numbers, motion, np.repeat(effort[:, None], count, axis=1))
    assert np.ptp(exact, axis=0).min() > 0.3
    np.testing.assert_allclose(q.T, exact, atol=1e-3)


@pytest.fixture(scope="module")
def predicting(arm):
    """The same arm, and a log of another motion that it was not fitted to."""
    folder = arm.urdf.parent
    text = bench.urdf(bench.FACTORS)
    other = bench.log(text, TRUTH, seconds=10.0, seed=2, faster=1.37)
    other.to_csv(folder / "other.csv", index=False)
    made = Arm(folder / "arm.urdf", QUICK)
    layout = layout_of(folder / "other.csv", made.bodies.joints, None)
    log = ArmLog(folder / "other.csv", "other", made.options, layout, made.bodies.joints, 10_000)
    return replace(arm, logs=(*arm.logs, log))


def test_bands_hold_another_motion(predicting):
    """20 times anew: of 24 draws' ends 83 % are held, less than 50 once in a thousand times."""
    found = rollout(predicting, seconds=0.5, draws=24, seed=1)
    assert found.log == "other"
    told = found.as_json()
    assert set(told["held"]) == set(told["rms"]) == {SHOULDER, ELBOW}
    for name, held in told["held"].items():
        assert held > 0.5, name
        assert f"{name} {told['rms'][name]:.2g} rad off" in found.text()
    # and tell where it goes: a tenth of how far it moves
    assert np.all((found.high - found.low).mean(axis=1) < 0.1 * np.std(found.measured, axis=1))
    some, again = (rollout(predicting, seconds=0.5, draws=2, seed=1) for _ in range(2))
    assert some.as_csv() == again.as_csv()


def test_a_fitted_arm_moves_as_measured(arm):
    found = rollout(arm, seconds=0.5, draws=12, seed=1)
    assert found.joints == (SHOULDER, ELBOW)
    assert np.count_nonzero(found.restarts) == 40
    for name, rms in found.rms.items():
        j = found.joints.index(name)
        still = found.measured[j] - found.measured[j][found.restarts][np.cumsum(found.restarts) - 1]
        assert rms < 0.1 * np.std(still)
        # 40 times anew: of 12 draws' ends 77 % are held, and by chance half as many never
        assert found.coverage[name] > 0.5
    assert (found.low <= found.middle).all()
    assert (found.middle <= found.high).all()
    assert f"{ELBOW}" in found.text()


def test_a_median_that_is_off_all_along_is_off_by_that():
    """Root mean square, and not what is left beside a mean."""
    on, off = np.zeros((1, 4)), np.full((1, 4), 0.3)
    begins = np.array([True, False, False, False])
    told = "log", 0.5, ("one",), ("rad",), np.arange(4.0), begins
    found = arm_rollout.ArmRollOut(*told, on, off - 0.1, off, off + 0.1)
    assert found.rms == {"one": pytest.approx(0.3)}
    assert found.coverage == {"one": 0.0}


def test_what_cannot_be_played_is_refused(arm):
    with pytest.raises(BadInput, match="seconds"):
        rollout(arm, seconds=1e-4)
    one = arm.joints[ELBOW]
    names = [*one.result.fit.chain.names[:-1], "motor.stribeck"]
    fit = SimpleNamespace(chain=SimpleNamespace(names=names))
    other = replace(one, result=SimpleNamespace(fit=fit))
    with pytest.raises(BadInput, match=r"motor\.stribeck"):
        arm_rollout._friction(other, np.zeros((1, len(names))))
