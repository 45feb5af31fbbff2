"""A joint as simulators describe one: inertia, damping and friction at its output.

With ``v`` the joint's speed and ``s`` its sign, a simulator's joint obeys

``gain * measured - torque_offset = (armature + link_inertia) a + damping v + quadratic v|v|
+ friction s + weight of link_moment at q + link_gravity_angle + stiffness q + stiffness_cubic q³``

Numbers that a joint has in this form are exact: each element's, times powers of its speed over the
joint's. Load-dependent friction passes ``(1 + mu_1) T`` while the motor drives and ``(1 - mu_2) T``
while the load does. Everything is divided by the mean of both factors, so that the link keeps its
own inertia and the motor's torque is that much smaller. Whatever else the law has is fitted by
least squares over the recorded motion with the loss numbers that a format has, none below zero.

BAM (Rhoban/bam, ``bam/model.py``) in addition has ``(load_friction + load_rise low) |external -
motor| s + rise low s`` with ``low = exp(-(|v|/rise_speed)^rise_exponent)`` and both torques at the
joint. The motor's holds its own friction, so that no coefficient is one of the law.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

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
    "load_friction": ("", "", "loss per difference of external and motor torque"),
    "rise": ("N m", "N", "constant loss at standstill in addition"),
    "load_rise": ("", "", "loss per torque at standstill in addition"),
    "rise_speed": ("rad/s", "m/s", "speed at which the rise has fallen to 1/e"),
    "rise_exponent": ("", "", "exponent of speed in the rise"),
}
# Numbers that only BAM has.
OF_BAM = ("load_friction", "rise", "load_rise", "rise_speed", "rise_exponent")
# Of link and drive, which a format of joints leaves to the surrounding model.
LINK_AND_DRIVE = ("link_inertia", "link_moment", "link_gravity_angle", "gain", "torque_offset")
# Numbers that are fitted to what else the law has.
LOSSES = ("friction", "damping", "quadratic", "load_friction", "rise", "load_rise")
# Number that a parameter is part of, exactly: by its name, or by its quantity of an element.
_NUMBER_OF: Mapping[str, str] = {
    "load.inertia": "link_inertia", "load.first_moment": "link_moment",
    "load.gravity_angle": "link_gravity_angle", "load.spring": "stiffness",
    "load.spring_cubic": "stiffness_cubic", "drive.gain": "gain", "offset": "torque_offset",
    "inertia": "armature", "viscous": "damping", "quadratic": "quadratic", "coulomb": "friction",
}  # fmt: skip
# Samples that a law with load-dependent friction is fitted to, and fixed-point iterations of its
# torque, which friction depends on.
_SAMPLES, _ITERATIONS = 2000, 60


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
    """Compute the motor torque of ``(n, d)`` vectors along motions, ``(n, M)``, without delay."""
    values = np.where([name == joint.delay_name for name in joint.names], 0.0, values)
    return np.concatenate([inverse_torque(joint, values, **vars(m)) for m in motions], axis=1)


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


def unit_of(number: tuple[str, str, str], joint: Joint) -> str:
    """Name the unit of a row of :data:`NUMBERS` for a joint."""
    return number[joint.load.motion != "rotary"].format(joint.torque_unit)


def number_of(p: Parameter) -> str:
    """Name the number that a parameter is part of, exactly; empty for none."""
    quantity = "" if p.owner in ("", "load", "drive") else p.quantity
    return _NUMBER_OF.get(p.name, _NUMBER_OF.get(quantity, ""))


def exact_numbers(joint: Joint, values: Array) -> Numbers:
    """Compute the numbers that vectors ``(n, d)`` of a joint have in a simulator's form."""
    numbers = {name: np.zeros(len(values)) for name in NUMBERS}
    elements = joint.tables(values).elements
    drive, back = (kernels.ELEMENT_SLOTS.index(f"load_{way}") for way in ("drive", "back"))
    # mean load factor of each element and those behind it
    factors = 1.0 + 0.5 * (elements[..., drive] - elements[..., back])
    passed = np.cumprod(factors[:, ::-1], axis=1)[:, ::-1]
    owners = [element.name for element in joint.elements]
    numbers["gain"] += joint.ratio / passed[:, 0]
    for p, amount in zip(joint.parameters, values.T, strict=True):
        number = number_of(p)
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
    """Compute the numbers of a format that has those ``carried``, for vectors ``(n, d)``."""
    numbers = exact_numbers(joint, values)
    slot = dict(zip(kernels.ELEMENT_SLOTS, joint.tables(values).elements.T, strict=True))
    rising = np.abs(slot["stribeck_ratio"]) + np.abs(slot["stribeck_load_ratio"])
    if "rise" in carried and rising.any():
        k = int(np.argmax(rising.max(axis=1)))
        numbers["rise_speed"] = slot["stribeck_velocity"][k] / joint.reaches[joint.elements[k].name]
        numbers["rise_exponent"] = slot["stribeck_exponent"][k]
    loaded = "load_friction" in carried and bool((slot["load_drive"] + slot["load_back"]).any())
    if "load_friction" in carried:
        motions = thinned(motions, _SAMPLES)
    q, qd, _ = stacked(motions)
    law = numbers["gain"][:, None] * torque_along(joint, values, motions)
    law -= numbers["torque_offset"][:, None]
    free, external = _without_losses(joint, numbers, motions)
    columns = _loss_columns(numbers, qd, external - law if loaded else None)
    losses = [name for name in columns if name in carried]
    numbers |= {name: np.zeros(len(values)) for name in LOSSES if name not in losses}
    if losses:
        basis = np.stack(np.broadcast_arrays(*(columns[name] for name in losses)), axis=-1)
        axes, triangles = np.linalg.qr(basis)
        projected = ((law - free)[:, None] @ axes)[:, 0]
        fitted = np.array([nnls(triangles[i % len(basis)], y)[0] for i, y in enumerate(projected)])
        # an exact law leaves rounding only
        size = 1e-12 * np.abs(law).max(axis=1, initial=0.0)
        for k, name in enumerate(losses):
            change = np.abs(fitted[:, k] - numbers[name]) * np.abs(basis[..., k]).max(axis=-1)
            numbers[name] = np.where(change <= size, numbers[name], fitted[:, k])
    if "static_friction" in carried:
        # simulators want no less than what slides
        static = numbers["gain"] * standstill_friction(joint, values, motions)
        numbers["static_friction"] = np.maximum(static, numbers["friction"])
    # armature goes into a link, and a spring that stiffens into the line nearest to it
    if "armature" not in carried:
        numbers["link_inertia"] += numbers["armature"]
    if "stiffness_cubic" not in carried:
        numbers["stiffness"] += float(q @ q**3) / (float(q @ q) or 1.0) * numbers["stiffness_cubic"]
    return {name: x if name in carried else 0.0 * x for name, x in numbers.items()}


def standstill_friction(joint: Joint, values: Array, motions: Sequence[Trajectory]) -> Array:
    """Half of what torque changes by as speed turns, the mean of recorded positions, ``(n,)``."""
    v = 1e-200
    creep = [replace(m, qd=s * v + 0.0 * m.qd, qdd=0.0 * m.qdd) for s in (-1, 1) for m in motions]
    backward, forward = np.split(torque_along(joint, values, creep), 2, axis=1)
    half = 0.5 * (forward - backward).mean(axis=1)
    return np.where(half > 1e-100, half, 0.0)  # viscous friction of that speed is none


def simulated_torque(joint: Joint, numbers: Numbers, motions: Sequence[Trajectory]) -> Array:
    """Compute the motor torque ``(n, M)`` of a simulator's joint, N m or N.

    Static friction has no effect on it; known masses and torques on the load of ``joint`` have.
    """
    free, external = _without_losses(joint, numbers, motions)
    speed, torque = stacked(motions)[1], free
    loaded = any(numbers[name].any() for name in ("load_friction", "load_rise"))
    for _ in range(_ITERATIONS if loaded else 1):
        columns = _loss_columns(numbers, speed, external - torque if loaded else None)
        torque = free + sum(numbers[name][:, None] * x for name, x in columns.items())
    return np.asarray((torque + numbers["torque_offset"][:, None]) / numbers["gain"][:, None])


def _without_losses(
    joint: Joint, numbers: Numbers, motions: Sequence[Trajectory]
) -> tuple[Array, Array]:
    """Torque at the joint that motions take without losses, and the load's own, ``(n, M)``."""
    motion, turns = joint.load.motion, joint.load.motion == "rotary"
    load = Load(
        motion=motion, inertia=True, first_moment=turns, gravity_angle=turns, spring="stiffening",
        gravity=joint.load.gravity,
    )  # fmt: skip
    plain = Joint(elements=(Element("joint", motion=motion, inertia=True),), load=load)
    values = np.stack([numbers[number_of(p)] for p in plain.parameters], axis=1)
    still = [replace(m, qd=0.0 * m.qd, qdd=0.0 * m.qdd) for m in motions]
    return torque_along(plain, values, motions), -torque_along(plain, values, still)


def _loss_columns(numbers: Numbers, speed: Array, load: Array | None) -> dict[str, Array]:
    """Torque of each loss for a number of one, ``(1 or n, M)``; none of the load without one."""
    v, sign, low = speed[None], np.sign(speed)[None], None
    columns = {"friction": sign, "damping": v, "quadratic": v * np.abs(v)}
    if numbers["rise_exponent"].any():
        width, exponent = (numbers[name][:, None] for name in ("rise_speed", "rise_exponent"))
        low = np.exp(-(np.abs(v / width) ** exponent))
        columns["rise"] = low * sign
    if load is not None:
        columns["load_friction"] = np.abs(load) * sign
        if low is not None:
            columns["load_rise"] = low * columns["load_friction"]
    return columns
