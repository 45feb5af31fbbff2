"""A joint as simulators describe one: inertia, damping and friction at its output.

With ``v`` the joint's speed and ``s`` its sign, a simulator's joint obeys

``gain * measured - torque_offset = (armature + link_inertia) a + damping v + quadratic v|v|
+ friction s + weight of link_moment at q + link_gravity_angle + stiffness q + stiffness_cubic q³``

``gain`` is the joint's torque per measured motor torque. A chain without load-dependent friction is
exactly that, each element's numbers times powers of its speed over the joint's. Load-dependent
friction passes ``(1 + mu_1) T`` while the motor drives and ``(1 - mu_2) T`` while the load does;
the line ``a T + b s``, with ``a`` the mean of both factors and ``b`` the mean of ``mu_1`` and
``mu_2`` times a reference load, is exact at that load. Everything here is divided by ``a``, so that
the link keeps its own inertia and the motor's torque is ``a`` times smaller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayesfric.mechanism import kernels
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import Parameter
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Inputs
from bayesfric.recordings.observation import Observation


@dataclass(frozen=True)
class Number:
    """One number of a simulator's joint."""

    units: tuple[str, str]  # where the joint turns, where it slides
    meaning: str
    coupled_unit: str = ""  # where the motor turns and the joint slides

    def unit(self, joint: Joint) -> str:
        """Look up its unit for a joint."""
        if self.coupled_unit and joint.load.motion != joint.motor_motion:
            return self.coupled_unit
        return self.units[0 if joint.load.motion == "rotary" else 1]


NUMBERS: Mapping[str, Number] = {
    "armature": Number(("kg m²", "kg"), "inertia of rotor and gears, at the joint"),
    "damping": Number(("N m s/rad", "N s/m"), "loss in proportion to speed"),
    "quadratic": Number(("N m s²/rad²", "N s²/m²"), "loss with the square of speed"),
    "friction": Number(("N m", "N"), "constant loss while it moves"),
    "static_friction": Number(("N m", "N"), "constant loss at standstill"),
    "link_inertia": Number(("kg m²", "kg"), "inertia of the link about the joint"),
    "link_moment": Number(("kg m", "kg m"), "mass of the link times distance to its centre"),
    "link_gravity_angle": Number(("rad", "rad"), "angle added to q in gravity"),
    "stiffness": Number(("N m/rad", "N/m"), "torque in proportion to position"),
    "stiffness_cubic": Number(("N m/rad³", "N/m³"), "torque with the cube of position"),
    "gain": Number(
        ("N m per N m", "N per N"), "joint torque per measured motor torque", "N per N m"
    ),
    "torque_offset": Number(("N m", "N"), "constant in the measured torque, at the joint"),
}

# Quantities of elements that are one of these numbers, and their share in it.
_ELEMENT_NUMBERS: Mapping[str, tuple[str, float]] = {
    "inertia": ("armature", 1.0),
    "viscous": ("damping", 1.0),
    "viscous_positive": ("damping", 0.5),
    "viscous_negative": ("damping", 0.5),
    "quadratic": ("quadratic", 1.0),
    "coulomb": ("friction", 1.0),
    "coulomb_positive": ("friction", 0.5),
    "coulomb_negative": ("friction", 0.5),
}
_LOAD_NUMBERS: Mapping[str, str] = {
    "inertia": "link_inertia",
    "first_moment": "link_moment",
    "gravity_angle": "link_gravity_angle",
    "spring": "stiffness",
    "spring_cubic": "stiffness_cubic",
}
# Quantities of the measured torque, of load-dependent friction, and of the Stribeck effect.
_DRIVE = ("gain", "offset", "delay")
_LOAD_FRICTION = ("load", "load_drive", "load_back")
_STRIBECK = ("stribeck_ratio", "stribeck_change", "stribeck_constant")
_LOAD_STRIBECK = ("stribeck_ratio", "stribeck_change", "stribeck_load")
STRIBECK = frozenset({*_STRIBECK, *_LOAD_STRIBECK})


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Motion of one recording where a posterior compares it, ``(M,)`` each, SI at the joint."""

    q: Array
    qd: Array
    qdd: Array
    time: Array
    inputs: Inputs  # without a recording's name: its separate offset is not the joint's

    @classmethod
    def of(cls, observation: Observation) -> Trajectory:
        """Take the motion of a recording."""
        o, at = observation, observation.filter.centres
        inputs = replace(o.inputs, recording="")
        return cls(o.q[at], o.qd[at], o.acceleration, o.stamps[at], inputs)


def torque_along(chain: Joint, values: Array, motions: Sequence[Trajectory]) -> Array:
    """Compute the measured motor torque of ``(n, d)`` vectors along all motions, ``(n, M)``."""
    parts = [
        inverse_torque(chain, values, m.q, m.qd, m.qdd, inputs=m.inputs, time=m.time)
        for m in motions
    ]
    return np.concatenate(parts, axis=1)


def stacked(motions: Sequence[Trajectory]) -> Array:
    """Concatenate position, speed and acceleration of all motions, ``(3, M)``."""
    return np.concatenate([(m.q, m.qd, m.qdd) for m in motions], axis=1)


@dataclass(frozen=True, eq=False)
class JointModel:
    """A joint in a simulator's numbers, ``(n,)`` each, one for each parameter vector."""

    values: dict[str, Array]
    made_from: dict[str, tuple[str, ...]]  # parameters of the chain, by number
    reference: dict[str, Array]  # transmitted torque at the joint of load-dependent friction
    # constant and damping that replace a parameter's term: one that has no number, included in
    # values, or a Stribeck term, which is not
    fitted: dict[str, tuple[Array, Array]]


def joint_model(
    chain: Joint, values: Array, motions: Sequence[Trajectory], at_load: float | None = None
) -> JointModel:
    """Describe a joint at its output, for vectors ``(n, n_parameters)``.

    Load-dependent friction is exact at the transmitted torque ``at_load``, N m or N, by default its
    mean size along the motions; terms without a number are fitted by constant and viscous friction.
    """
    column = dict(zip(chain.names, values.T, strict=True))
    numbers = {name: np.zeros(len(values)) for name in NUMBERS}
    made_from: dict[str, list[str]] = {name: [] for name in NUMBERS}
    reference: dict[str, Array] = {}

    def add(number: str, amount: Array, *names: str) -> None:
        numbers[number] = numbers[number] + amount
        made_from[number] += [n for n in dict.fromkeys(names) if n not in made_from[number]]

    passed: Array = np.ones(len(values))  # mean load factor of this element and those behind it
    for k in range(len(chain.elements) - 1, -1, -1):
        element = chain.elements[k]
        reach = chain.reaches[element.name]
        quantities = {p.quantity: p for p in chain.parameters if p.owner == element.name}
        slots = chain.tables(values).elements[:, k].T
        at = dict(zip(kernels.ELEMENT_SLOTS, slots, strict=True))
        losses, stribeck, load_stribeck, squares, speeds = (
            [quantities[q].name for q in group if q in quantities]
            for group in (
                _LOAD_FRICTION, _STRIBECK, _LOAD_STRIBECK, ("load_square",), ("load_speed",)
            )
        )  # fmt: skip
        load: Array = np.zeros(len(values))
        if losses:
            if at_load is None:
                load = np.abs(_transmitted(chain, values, k, motions)).mean(axis=1)
            else:
                load = passed * at_load
            reference[element.name] = load
        passed = passed * (1.0 + 0.5 * (at["load_drive"] - at["load_back"]))
        constant = 0.5 * (at["load_drive"] + at["load_back"]) * load / passed
        square = at["load_square"] * load**2 / reach / passed
        add("friction", constant + square, *losses, *squares)
        add("static_friction", constant * at["stribeck_load_ratio"], *load_stribeck)
        add("damping", at["load_speed"] * reach * load / passed, *speeds)
        for quantity, p in quantities.items():
            if quantity in _ELEMENT_NUMBERS:
                number, share = _ELEMENT_NUMBERS[quantity]
                assert p.row.power is not None
                amount = share * column[p.name] * reach ** (p.row.power + 1) / passed
                add(number, amount, p.name)
                if number == "friction":
                    add("static_friction", amount * at["stribeck_ratio"], *stribeck)
    for p in chain.parameters:
        if p.owner == "load" and p.quantity in _LOAD_NUMBERS:
            add(_LOAD_NUMBERS[p.quantity], column[p.name], p.name)
    gain = column.get("drive.gain", np.ones(len(values)))
    add("gain", chain.ratio * gain / passed, *(["drive.gain"] if "drive.gain" in column else []))
    made_from["gain"] += [p.name for p in chain.parameters if p.quantity in _LOAD_FRICTION[1:]]
    if "offset" in column:
        add("torque_offset", chain.ratio * column["offset"] / passed, "offset")
    fitted = _fitted_losses(chain, values, motions, numbers["gain"])
    for p in chain.parameters:
        if not has_number(p):
            add("friction", fitted[p.name][0], p.name)
            add("damping", fitted[p.name][1], p.name)
    numbers |= nonnegative_losses(numbers, motions)
    add("static_friction", numbers["friction"], *made_from["friction"])
    numbers["static_friction"] = np.maximum(numbers["static_friction"], 0.0)
    return JointModel(numbers, {k: tuple(v) for k, v in made_from.items()}, reference, fitted)


def nonnegative_losses(
    numbers: Mapping[str, Array], motions: Sequence[Trajectory]
) -> dict[str, Array]:
    """Refit ``friction`` and ``damping`` by non-negative least squares, where one is negative.

    A fit over a one-sided motion may give that.
    """
    constant, damping = numbers["friction"], numbers["damping"]
    if min(constant.min(), damping.min()) >= 0.0:
        return {}
    size = np.abs(stacked(motions)[1])
    slope = constant * size.sum() / max(size @ size, 1e-300)
    return {
        "friction": np.maximum(constant + np.minimum(damping, 0.0) * size.mean(), 0.0),
        "damping": np.maximum(damping + np.minimum(slope, 0.0), 0.0),
    }


def without_load_friction(chain: Joint, values: Array) -> Array:
    """Set load-dependent friction of vectors ``(n, d)`` to zero, for formats that have it."""
    loaded = [p.quantity.startswith("load") for p in chain.parameters]
    return np.where(loaded, 0.0, values)


def _transmitted(chain: Joint, values: Array, k: int, motions: Sequence[Trajectory]) -> Array:
    """Compute the torque at the output of element ``k``, at the joint, ``(n, M)``."""
    behind = chain.elements[k + 1 :]
    owners = {e.name for e in behind} | {"load"}
    shaft = Element("output", motion=behind[0].motion if behind else chain.load.motion)
    terms = tuple(term for term in chain.terms if term.owner in owners)
    output = Joint(elements=(shaft, *behind), load=chain.load, terms=terms)
    columns = [chain.names.index(name) for name in output.names]
    return torque_along(output, values[:, columns], motions) * output.ratio


def has_number(p: Parameter) -> bool:
    """Whether a parameter's term has a number, or is of the torque's measurement."""
    numbers = _LOAD_NUMBERS if p.owner == "load" else _ELEMENT_NUMBERS
    return p.row.role != "own" or p.quantity in numbers or p.quantity in _DRIVE


def _fitted_losses(
    chain: Joint, values: Array, motions: Sequence[Trajectory], gain: Array
) -> dict[str, tuple[Array, Array]]:
    """Fit constant and viscous friction to terms without a number, and to Stribeck terms."""
    terms = {p.name for p in chain.parameters if not has_number(p) or p.quantity in STRIBECK}
    if not terms:
        return {}
    _, speed, _ = stacked(motions)
    basis = np.stack([np.sign(speed), speed], axis=1)
    torque = torque_along(chain, values, motions)
    fitted = {}
    for name in sorted(terms, key=chain.names.index):
        k = chain.names.index(name)
        without = values.copy()
        without[:, k] = 0.0
        term = gain[:, None] * (torque - torque_along(chain, without, motions))
        constant, damping = np.linalg.lstsq(basis, term.T, rcond=None)[0]
        fitted[name] = (constant, damping)
    return fitted


def simulated_torque(
    chain: Joint, numbers: Mapping[str, float], motions: Sequence[Trajectory]
) -> Array:
    """Compute the measured motor torque of a simulator's joint, ``(M,)``, N m or N.

    Static friction has no effect on it. Known masses and torques on the load of ``chain`` are on
    that of the simulator, too.
    """
    motion, turns = chain.load.motion, chain.load.motion == "rotary"
    losses: dict[str, Any] = {"coulomb": "symmetric", "viscous": True, "quadratic": True}
    weight: dict[str, Any] = {
        "first_moment": turns,
        "gravity_angle": turns,
        "gravity": chain.load.gravity,
    }
    plain = Joint(
        elements=(Element("joint", motion=motion, inertia=True, **losses),),
        load=Load(motion=motion, inertia=True, spring="stiffening", **weight),
        offset=True,
        gain=True,
    )
    of_element = {"offset": "torque_offset", "gain": "gain"}
    of_element |= {quantity: number for quantity, (number, _) in _ELEMENT_NUMBERS.items()}
    vector = [
        numbers[(_LOAD_NUMBERS if p.owner == "load" else of_element)[p.quantity]]
        for p in plain.parameters
    ]
    return np.asarray(torque_along(plain, np.array([vector]), motions)[0])
