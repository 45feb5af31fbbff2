"""Finished posteriors made by hand of SIMULATED recordings: known parameters, a few draws."""

from functools import cache

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.export.joint_model import Trajectory
from bayesfric.export.point_estimate import parameter_vectors
from bayesfric.fit.result import Result
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.presets import PRESETS
from bayesfric.report.summary.record import Summary

RATE = 1000.0


def plain_knee():
    """A geared joint without load loss, all of which MuJoCo can carry."""
    joint = Joint(
        elements=(
            Element("motor", ratio=50.0, inertia=True, coulomb="symmetric", viscous=True),
            Element("joint", coulomb="symmetric", viscous=True, quadratic=True),
        ),
        load=Load(inertia=True, first_moment=True, gravity_angle=True, spring=True),
        offset=True,
    )
    values = {
        "motor.inertia": 3.56e-4,
        "motor.viscous": 4e-3,
        "motor.coulomb": 0.087,
        "joint.viscous": 3.12,
        "joint.coulomb": 5.0,
        "joint.quadratic": 0.5,
        "load.inertia": 0.206,
        "load.first_moment": 0.42,
        "load.gravity_angle": 0.1,
        "load.spring": 2.0,
        "offset": 0.01,
    }
    return joint, values


def numbers(exported):
    """Give what a format's numbers are, by its own names."""
    return {row["attribute"]: row["value"] for row in exported.record["numbers"]}


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


def middle(done):
    return parameter_vectors(done, [Trajectory.of(o) for o in done.model.observations], 10).point


def check_announced_torque(done, exported, taken):
    """Compare torques along recorded motion, ``taken(q, qd, qdd)`` one after the other."""
    o = done.model.observations[0]
    q, qd, qdd = (x[o.filter.centres] for x in (o.q, o.qd, o.qdd))
    ours = inverse_torque(done.joint, middle(done), q, qd, qdd, inputs=o.inputs)
    theirs = np.array([taken(*row) for row in zip(q, qd, qdd, strict=True)])
    assert rms(theirs - ours) == pytest.approx(exported.record["error"]["motor"]["rms"], rel=0.2)


def preset(name):
    return PRESETS[name].chain(), dict(PRESETS[name].values)


def swung(size, seconds=4.0):
    """A torque of several sines, ``(N,)``, and its period."""
    t = np.arange(int(seconds * RATE)) / RATE
    waves = ((0.7, 0.7), (1.7, 0.4), (3.1, 0.2))
    return size * sum(a * np.sin(2 * np.pi * f * t + k) for k, (f, a) in enumerate(waves)), 1 / RATE


def made(joint, values, size, *, spread=0.02, draws=60, open_scale=False):
    """Simulate a recording and make a posterior around its true parameters."""
    torque, period = swung(size)
    vector = joint.vector(values)
    motion = simulate(joint, vector, torque, period, hold="zero")
    recording = bf.Recording.from_arrays(
        time=motion.time, position=motion.q, torque=torque, side="joint", name="swung"
    )
    model = bf.Model(joint, recording)
    rng = np.random.default_rng(1)
    cloud = vector * (1.0 + spread * rng.standard_normal((draws, len(vector))))
    rows = {
        p.name: {
            "unit": p.unit,
            "mean": float(x),
            "sd": abs(float(spread * x)),
            "median": float(x),
            "interval": [float(x), float(x)],
            "level": 0.9,
            "verdict": "data",
        }
        for p, x in zip(joint.parameters, vector, strict=True)
    }
    null = [{"parameters": {"gearbox.alpha_drive": 1.0}, "meaning": "a factor"}]
    summary = Summary.read(
        {"parameters": rows, "identifiability": {"null_directions": null if open_scale else []}}
    )
    return Result(model, summary, "simulated", cloud)


@cache
def found(name):
    """Finished posteriors that several tests look at."""
    if name == "plain":
        return made(*plain_knee(), 0.6)
    sizes = {"rabbit-knee": 0.6, "servo-pendulum": 0.4, "motor-axis": 0.6}
    return made(*preset(name), sizes[name], open_scale=name == "rabbit-knee")
