"""A joint as simulators describe one: inertia, damping and friction at its output.

With ``v`` the joint's speed and ``s`` its sign, a simulator's joint obeys

``gain * measured - torque_offset = (armature + link_inertia) a + damping v + quadratic v|v|
+ friction s + weight of link_moment at q + link_gravity_angle + stiffness q + stiffness_cubic q³``

``gain`` is the joint's torque per measured motor torque. Numbers that a joint has in this form are
exact: each element's, times powers of its speed over the joint's. Load-dependent friction passes
``(1 + mu_1) T`` while the motor drives and ``(1 - mu_2) T`` while the load does. Everything is
divided by the mean of both factors, so that the link keeps its own inertia and the motor's torque
is that much smaller. Whatever else the law has is fitted by least squares over the recorded motion
with the loss numbers that a format has.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import nnls

from bayesfric.identifiability.friction_curve import friction_torque
from bayesfric.mechanism import kernels
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import Parameter
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Inputs
from bayesfric.recordings.signals import Signals

Numbers = dict[str, Array]  # (n,) each, one for each parameter vector

# Of a simulator's joint: unit where it turns, where it slides, and meaning.
NUMBERS: Mapping[str, tuple[str, str, str]] = {
    "armature": ("kg m²", "kg", "inertia of rotor and gears, at the joint"),
    "damping": ("N m s/rad", "N s/m", "loss in proportion to speed"),
    "quadratic": ("N m s²/rad²", "N s²/m²", "loss with the square of speed"),
    "friction": ("N m", "N", "constant loss while it moves"),
    "static_friction": ("N m", "N", "constant loss at standstill"),
    "link_inertia": ("kg m²", "kg", "inertia of the link about the joint"),
    "link_moment": ("kg m", "kg m", "mass of the link times distance to its centre"),
    "link_gravity_angle": ("rad", "rad", "angle added to q in gravity"),
    "stiffness": ("N m/rad", "N/m", "torque in proportion to position"),
    "stiffness_cubic": ("N m/rad³", "N/m³", "torque with the cube of position"),
    "gain": ("N m per {}", "N per {}", "joint torque per measured motor torque"),
    "torque_offset": ("N m", "N", "constant in the measured torque, at the joint"),
}
# Of link and drive, which a format of joints leaves to the surrounding model.
LINK_AND_DRIVE = ("link_inertia", "link_moment", "link_gravity_angle", "gain", "torque_offset")
# Loss numbers, and the function of speed that each multiplies.
LOSSES: Mapping[str, Callable[[Array], Array]] = {
    "friction": np.sign,
    "damping": np.positive,
    "quadratic": lambda v: v * np.abs(v),
}
# Number that a parameter is part of, exactly: by its name, or by its quantity of an element.
_NUMBER_OF: Mapping[str, str] = {
    "load.inertia": "link_inertia",
    "load.first_moment": "link_moment",
    "load.gravity_angle": "link_gravity_angle",
    "load.spring": "stiffness",
    "load.spring_cubic": "stiffness_cubic",
    "drive.gain": "gain",
    "offset": "torque_offset",
    "inertia": "armature",
    "viscous": "damping",
    "quadratic": "quadratic",
    "coulomb": "friction",
}


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Motion of one recording where a posterior compares it, ``(M,)`` each, SI at the joint."""

    q: Array
    qd: Array
    qdd: Array
    time: Array
    inputs: Inputs  # without a recording's name: its separate offset is not the joint's

    @classmethod
    def of(cls, observation: Signals) -> Trajectory:
        """Take the motion of a recording."""
        o, at = observation, observation.filter.centres
        inputs = replace(o.inputs, recording="")
        return cls(o.q[at], o.qd[at], o.acceleration, o.stamps[at], inputs)


def torque_along(joint: Joint, values: Array, motions: Sequence[Trajectory]) -> Array:
    """Compute the measured motor torque of ``(n, d)`` vectors along all motions, ``(n, M)``."""
    parts = [
        inverse_torque(joint, values, m.q, m.qd, m.qdd, inputs=m.inputs, time=m.time)
        for m in motions
    ]
    return np.concatenate(parts, axis=1)


def stacked(motions: Sequence[Trajectory]) -> Array:
    """Concatenate position, speed and acceleration of all motions, ``(3, M)``."""
    return np.concatenate([(m.q, m.qd, m.qdd) for m in motions], axis=1)


def thinned(motions: Sequence[Trajectory], samples: int = 20_000) -> list[Trajectory]:
    """Keep about so many samples of all motions: all draws are evaluated along them."""
    step = -(-sum(m.q.size for m in motions) // samples)
    return [
        Trajectory(m.q[::step], m.qd[::step], m.qdd[::step], m.time[::step], m.inputs)
        for m in motions
    ]


def motor_unit(joint: Joint) -> str:
    """Name the unit of the motor's torque."""
    return "N m" if joint.motor_motion == "rotary" else "N"


def unit_of(number: tuple[str, str, str], joint: Joint) -> str:
    """Name the unit of a row of :data:`NUMBERS` for a joint."""
    return number[joint.load.motion != "rotary"].format(motor_unit(joint))


def of_recording(p: Parameter) -> bool:
    """Whether it is a property of recordings: a delay, or the separate offset of one."""
    return p.quantity == "delay" or (p.owner == "" and p.name != "offset")


def number_of(p: Parameter) -> str:
    """Name the number that a parameter is part of, exactly; empty for none."""
    quantity = "" if p.owner in ("", "load", "drive") else p.quantity
    return _NUMBER_OF.get(p.name, _NUMBER_OF.get(quantity, ""))


def exact_numbers(joint: Joint, values: Array) -> Numbers:
    """Compute the numbers that vectors ``(n, d)`` of a joint have in a simulator's form."""
    column = dict(zip(joint.names, values.T, strict=True))
    numbers = {name: np.zeros(len(values)) for name in NUMBERS}
    elements = joint.tables(values).elements
    drive, back = (kernels.ELEMENT_SLOTS.index(f"load_{way}") for way in ("drive", "back"))
    # mean load factor of each element and those behind it
    factors = 1.0 + 0.5 * (elements[..., drive] - elements[..., back])
    passed = np.cumprod(factors[:, ::-1], axis=1)[:, ::-1]
    owners = [element.name for element in joint.elements]
    numbers["gain"] += joint.ratio / passed[:, 0]
    for p in joint.parameters:
        number, amount = number_of(p), column[p.name]
        if number == "gain":
            numbers[number] *= amount
        elif number == "torque_offset":
            numbers[number] += joint.ratio * amount / passed[:, 0]
        elif number and p.owner in owners:
            assert p.row.power is not None
            scale = joint.reaches[p.owner] ** (p.row.power + 1)
            numbers[number] += scale * amount / passed[:, owners.index(p.owner)]
        elif number:
            numbers[number] += amount
    return numbers


def simulator_numbers(
    joint: Joint, values: Array, motions: Sequence[Trajectory], carried: Collection[str]
) -> Numbers:
    """Compute the numbers of a format that has those ``carried``, for vectors ``(n, d)``.

    Exact where the joint is what the format can express; what is left of the law along the
    recorded motion is fitted by the losses that the format has, none of which becomes negative.
    """
    numbers, values = exact_numbers(joint, values), undelayed(joint, values)
    q, qd, _ = stacked(motions)
    numbers |= {name: np.zeros(len(values)) for name in LOSSES if name not in carried}
    if losses := [name for name in LOSSES if name in carried]:
        law = torque_along(joint, values, motions)
        missing = numbers["gain"][:, None] * (law - simulated_torque(joint, numbers, motions))
        basis = np.stack([LOSSES[name](qd) for name in losses], axis=1)
        amounts = np.stack([numbers[name] for name in losses], axis=1)
        fitted = nonnegative_fit(basis, missing + amounts @ basis.T)
        # an exact law leaves rounding only
        change = np.abs(fitted - amounts) * np.abs(basis).max(axis=0)
        size = 1e-12 * numbers["gain"] * np.abs(law).max(axis=1, initial=0.0)
        fitted = np.where(change <= size[:, None], amounts, fitted)
        numbers |= dict(zip(losses, fitted.T, strict=True))
    # armature goes into a link, and a spring that stiffens into the line nearest to it
    slope = float(q @ q**3) / (float(q @ q) or 1.0)
    for name, instead, share in (
        ("armature", "link_inertia", 1.0),
        ("stiffness_cubic", "stiffness", slope),
    ):
        if name not in carried:
            numbers[instead] = numbers[instead] + share * numbers[name]
            numbers[name] = np.zeros(len(values))
    if "stiffness" not in carried:
        numbers["stiffness"] = np.zeros(len(values))
    return numbers


def nonnegative_fit(columns: Array, torques: Array) -> Array:
    """Fit coefficients of zero or more, ``(n, k)``, of columns ``(M, k)`` to torques ``(n, M)``."""
    q, r = np.linalg.qr(columns)
    return np.array([nnls(r, projected)[0] for projected in torques @ q])


def undelayed(joint: Joint, values: Array) -> Array:
    """Set the delay of vectors ``(n, d)`` to zero: it is a property of the recording."""
    return np.where([name == joint.delay_name for name in joint.names], 0.0, values)


def static_friction(joint: Joint, values: Array, load: float) -> Array:
    """Friction of vectors as speed vanishes, at the joint, ``(n,)``.

    The mean over both directions and both signs of the load, which is loss-free and at the motor.
    """
    speed = 1e-9 * np.array([1.0, 1.0, -1.0, -1.0])
    loads = load * np.array([1.0, -1.0, 1.0, -1.0])
    at_motor = friction_torque(joint, values, speed, loads, open_scale=True).mean(axis=1)
    gain = values[:, joint.names.index("drive.gain")] if joint.gain else 1.0
    return np.asarray(np.maximum(exact_numbers(joint, values)["gain"] / gain * at_motor, 0.0))


def simulated_torque(joint: Joint, numbers: Numbers, motions: Sequence[Trajectory]) -> Array:
    """Compute the measured motor torque of a simulator's joint, ``(n, M)``, N m or N.

    Static friction has no effect on it. Known masses and torques on the load of ``joint`` are on
    that of the simulator, too.
    """
    motion, turns = joint.load.motion, joint.load.motion == "rotary"
    losses: dict[str, Any] = {"coulomb": "symmetric", "viscous": True, "quadratic": True}
    weight: dict[str, Any] = {
        "first_moment": turns,
        "gravity_angle": turns,
        "gravity": joint.load.gravity,
    }
    plain = Joint(
        elements=(Element("joint", motion=motion, inertia=True, **losses),),
        load=Load(motion=motion, inertia=True, spring="stiffening", **weight),
        offset=True,
        gain=True,
    )
    columns = [numbers[number_of(p)] for p in plain.parameters]
    return torque_along(plain, np.stack(columns, axis=1), motions)
