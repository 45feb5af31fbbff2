"""An arm of which only targets and positions are known, simulated by MuJoCo."""

from dataclasses import replace

import mujoco
import numpy as np
import pandas as pd
import pytest

from bayesfric.arm.arm import Arm
from bayesfric.arm.arm_rollout import rollout

from . import bench

KP, KD, DELAY, INSTANTS, PERIOD, STEP = 300.0, 20.0, 5e-3, 4e-4, 5e-3, 5e-5
TRUTH = {
    bench.SHOULDER: {"motor.inertia": 0.6, "motor.viscous": 4.0, "motor.coulomb": 3.0},
    bench.ELBOW: {"motor.inertia": 0.3, "motor.viscous": 2.0, "motor.coulomb": 2.0},
}
OPTIONS = {
    "recording": {
        "time": {"column": "time", "unit": "s"},
        "position": {"column": "position[{joint}]", "unit": "rad"},
        "target": {
            "column": "target[{joint}]", "unit": "rad", "kp": f"{KP} N m/rad",
            "kd": f"{KD} N m s/rad", "loop": 0.0, "velocity_filter": 0.0, "held": True,
        },
    },
    "friction": {"load_loss": "none"},
    "payload": {"mass_sd": "0 kg", "centre_sd": "0 m"},
    "urdf": {"factor": 0.02, "centre": "2 mm"},
    "fit": {"self_check": {"recordings": 0}},
}  # fmt: skip


def simulated(seconds: float, seed: int) -> pd.DataFrame:
    """Follow held targets with a delay; readings are rounded, and at instants that scatter."""
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(round(seconds / PERIOD))
    phases = rng.uniform(0.0, 6.0, (2, 3))
    waves = np.sin(np.array([2.0, 6.0, 13.0])[:, None] * time + phases[:, :, None])
    target = 0.02 * np.round(np.array([0.5, 0.25, 0.1]) @ waves / 0.02)
    model = mujoco.MjModel.from_xml_string(bench.urdf())
    model.opt.timestep, model.opt.gravity[:] = STEP, bench.GRAVITY
    numbers = np.array([[*x.values()] for x in TRUTH.values()]).T
    model.dof_armature[:], model.dof_damping[:], model.dof_frictionloss[:] = numbers
    model.dof_solref[:], model.dof_solimp[:, :3] = (2e-4, 1.0), (0.99, 0.9999, 1e-3)
    data, per, late = mujoco.MjData(model), round(PERIOD / STEP), round(DELAY / STEP)
    motion, push = np.empty((time.size * per, 2)), np.zeros(2)
    data.qpos[:] = target[:, 0]
    keeps = np.exp(-PERIOD / 0.03)
    for i in range(len(motion)):
        if i % per == 0:
            push = keeps * push + 0.2 * np.sqrt(1.0 - keeps**2) * rng.normal(size=2)
        motion[i] = data.qpos
        goal = target[:, max((i - late) // per, 0)]
        data.qfrc_applied[:] = KP * (goal - data.qpos) - KD * data.qvel + push
        mujoco.mj_step(model, data)
    instants = per * np.arange(time.size) + INSTANTS / STEP * rng.normal(size=time.size)
    read = motion[np.clip(np.round(instants).astype(int), 0, len(motion) - 1)]
    columns = {"time": time}
    for k, name in enumerate(TRUTH):
        columns[f"position[{name}]"] = 3e-5 * np.round(read[:, k] / 3e-5)
        columns[f"target[{name}]"] = target[k]
    return pd.DataFrame(columns)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    folder = tmp_path_factory.mktemp("leg")
    (folder / "arm.urdf").write_text(bench.urdf())
    for name, seed in (("log", 5), ("other", 6)):
        simulated(4.0, seed).to_csv(folder / f"{name}.csv", index=False)
    arm = Arm(folder / "arm.urdf", OPTIONS)
    return arm.fit(folder / "log.csv", predict=folder / "other.csv", seed=1)


def test_numbers_and_timing_of_a_leg_are_the_true_ones(arm):
    """Within 3.5 sds of draws that assume the model; the two joints share delay and clock."""
    for name, numbers in TRUTH.items():
        posterior = arm.joints[name].fitted.fit.posterior
        for parameter, truth in numbers.items():
            draws = posterior[parameter]
            assert abs(draws.mean() - truth) < 3.5 * draws.std() < 0.7 * truth
    delay, sd = arm.timing.delay
    assert abs(delay - DELAY) < 3.5 * sd < 2e-3
    assert arm.timing.instants[0] == pytest.approx(INSTANTS, rel=0.15)


@pytest.mark.parametrize("agree", [True, False], ids=["as fitted", "contradictory"])
def test_another_motion_is_followed_from_its_targets(arm, agree):
    """All joints at once, without a restart: the error is small beside that of the control."""
    joints = {name: replace(joint, agrees=agree) for name, joint in arm.joints.items()}
    played = rollout(replace(arm, joints=joints), seconds=np.inf, draws=4, seed=1)
    log = arm.logs[-1]
    for name, rms in played.rms.items():
        law = log.measured(arm.bodies.joints[name]).law
        control = np.std(law.command / KP - log.motion[0, [*TRUTH].index(name)])
        assert rms < 0.1 * control
        assert played.coverage[name] > 0.5
