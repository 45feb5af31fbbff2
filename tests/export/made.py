"""Finished posteriors made of SIMULATED recordings: known parameters, a few draws."""

from functools import cache

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.export.joint_model import Trajectory
from bayesfric.export.point_estimate import parameter_vectors
from bayesfric.fit.model import Result
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import PRESETS, Joint
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


def exported_vector(run):
    """Parameters that an export is of."""
    return parameter_vectors(run, [Trajectory.of(o) for o in run.model.observations], 10).point


def check_reported_torque(run, exported, torque_of):
    """Compare torques along recorded motion, ``torque_of(q, qd, qdd)`` one after the other."""
    o = run.model.observations[0]
    motion = [x[o.filter.centres] for x in (o.q, o.qd, o.qdd)]
    expected = inverse_torque(run.joint, exported_vector(run), *motion, inputs=o.inputs)
    torque = np.array([torque_of(*row) for row in zip(*motion, strict=True)])
    reported = exported.record["error"]["motor"]["rms"]
    assert rms(torque - expected) == pytest.approx(reported, rel=0.2)


def preset(name):
    return PRESETS[name].chain(), dict(PRESETS[name].values)


def swung(size, seconds=4.0):
    """A torque of several sines, ``(N,)``, and its period."""
    t = np.arange(int(seconds * RATE)) / RATE
    waves = ((0.7, 0.7), (1.7, 0.4), (3.1, 0.2))
    return size * sum(a * np.sin(2 * np.pi * f * t + k) for k, (f, a) in enumerate(waves)), 1 / RATE


def posterior_of(joint, values, size, *, spread=0.02, draws=60, open_scale=False):
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
def finished_posterior(name):
    """Finished posteriors that several tests look at."""
    if name == "plain":
        return posterior_of(*plain_knee(), 0.6)
    sizes = {"rabbit-knee": 0.6, "servo-pendulum": 0.4, "motor-axis": 0.6}
    return posterior_of(*preset(name), sizes[name], open_scale=name == "rabbit-knee")
