"""The exported model in real MuJoCo, against our forward model, on SIMULATED recordings."""

import mujoco
import numpy as np
import pytest

import bayesfric as bf
from bayesfric.mechanism.forward import simulate

from .made import found, swung

SECONDS = 2.0


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


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


def ours(done, torque, period):
    exported = bf.export(done, "mujoco")
    vector = np.median(done.values(done.draws), axis=0)
    return exported, simulate(done.joint, vector, torque, period, hold="zero").q


@pytest.mark.parametrize("name", ["plain", "motor-axis"])
def test_what_mujoco_can_carry_moves_as_the_fitted_joint(name):
    done = found(name)
    torque, period = swung(0.6, SECONDS)
    exported, motion = ours(done, torque, period)
    assert np.ptp(motion) > 0.5
    assert rms(moved(exported.main, torque, period) - motion) < 1e-3
    assert not exported.record["lost"]
    assert exported.record["error"]["motor"]["largest"] < 1e-12
