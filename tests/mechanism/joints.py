"""Joints and torques that several tests move."""

import numpy as np

from bayesfric.mechanism import kernels
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.experiment import current_loop, multisine, square
from bayesfric.mechanism.joint import PRESETS, Joint

KNEE = PRESETS["rabbit-knee"]


# every term there is, two of them load-dependent
EVERYTHING = Joint(
    (
        Element("motor", inertia=True, coulomb="by-direction", viscous=True, quadratic=True),
        Element("belt", ratio=2.5, coulomb="symmetric", load_loss="one"),
        Element(
            "gearbox", ratio=30.0, inertia=True, coulomb="symmetric", viscous=True, stribeck=True,
            load_loss="two",
        ),
        Element("joint", coulomb="by-direction", viscous=True, quadratic=True, stribeck=True),
    ),
    Load(inertia=True, first_moment=True, gravity_angle=True),
    offset=True,
    gain=True,
)  # fmt: skip
EVERYTHING_VALUES = {
    "motor.inertia": 0.0002, "motor.viscous": 0.001, "motor.coulomb_positive": 0.03,
    "motor.coulomb_negative": 0.04, "motor.quadratic": 1e-06, "belt.coulomb": 0.01,
    "belt.load": 0.05, "gearbox.inertia": 0.0003, "gearbox.viscous": 0.002,
    "gearbox.coulomb": 0.05, "gearbox.stribeck_ratio": 0.4, "gearbox.stribeck_velocity": 3.0,
    "gearbox.load_drive": 0.25, "gearbox.load_back": 0.35, "joint.viscous": 1.0,
    "joint.coulomb_positive": 1.5, "joint.coulomb_negative": 1.2, "joint.quadratic": 0.3,
    "joint.stribeck_ratio": 0.5, "joint.stribeck_velocity": 0.2, "load.inertia": 0.5,
    "load.first_moment": 1.0, "load.gravity_angle": 0.3, "offset": 0.02, "drive.gain": 1.1,
}  # fmt: skip


def thetas(chain, v):
    """Theta1 and Theta2 exactly as listed under eq. (13), with g in theta5 and theta10."""
    n, g = chain.ratio, chain.load.gravity
    by_alpha = np.array([1.0 + v["gearbox.load_drive"], 1.0 - v["gearbox.load_back"]])
    lambda_1, lambda_2 = by_alpha.mean(), (by_alpha[0] - by_alpha[1]) / 2
    plus = (v["joint.coulomb_positive"] + v["joint.coulomb_negative"]) / (2 * n)
    minus = (v["joint.coulomb_positive"] - v["joint.coulomb_negative"]) / (2 * n)
    first, second = v["load.inertia"] / n**2, v["joint.viscous"] / n**2
    leg = np.array([first, second, plus, minus, g * v["load.first_moment"] / n])
    positive, negative = v["motor.coulomb_positive"], v["motor.coulomb_negative"]
    constant = (positive + negative) / 2, (positive - negative) / 2
    motor = np.array([v["motor.inertia"], v["motor.viscous"], *constant, 0.0])
    return motor + lambda_1 * leg, lambda_2 * leg


def carried_to_motor(elements, torque, sign, speed, acceleration) -> float:
    """Carry a load's torque through every element, one element equation after the other."""
    to_input = 1.0
    for element in elements[::-1]:
        to_input *= element[kernels.RATIO]
        moving = sign, to_input * speed, to_input * acceleration
        risen = kernels.rises(element, to_input * speed)
        torque = kernels.element_torque(element, torque / element[kernels.RATIO], *moving, risen)
    return torque


def axis(**terms) -> Joint:
    return Joint(elements=(Element("motor", inertia=True, **terms),), load=Load())


def signal(period, duration=1.2, amplitude=0.8, seed=0):
    time = np.arange(round(duration / period) + 1) * period
    torque = square(time, amplitude, 2.0) + multisine(
        time, 0.2 * amplitude, [3.0, 7.0, 11.0], seed=seed
    )
    return current_loop(torque, period, 5e-3)


# a motor with a light load behind a gearbox without losses
GEARED = Joint(
    (Element("motor", inertia=True, viscous=True), Element("gearbox", ratio=5.0)),
    Load(inertia=True, first_moment=True),
)
LIGHT = {
    "motor.inertia": 1e-3, "motor.viscous": 2e-3, "load.inertia": 0.02, "load.first_moment": 0.1,
}  # fmt: skip
