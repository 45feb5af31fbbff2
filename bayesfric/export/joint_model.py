"""A joint as simulators describe one: inertia, damping and friction at its output.

With ``v`` the joint's speed and ``s`` its sign, a simulator's joint obeys

``gain * measured - torque_offset = (armature + link_inertia) a + damping v + quadratic v|v|
+ friction s + weight of link_moment at q + link_gravity_angle + stiffness q + stiffness_cubic q³``

``gain`` is the joint's torque per measured motor torque. A chain without load losses is that
exactly, each element's numbers times powers of its speed over the joint's. A load loss passes
``(1 + mu_1) T`` while the motor drives and ``(1 - mu_2) T`` while the load does; the line
``a T + b s``, with ``a`` the mean of both factors and ``b`` the mean of ``mu_1`` and ``mu_2``
times a reference load, meets both at that load. Here everything is divided by ``a``, so that
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
from bayesfric.mechanism.parameter import Parameter
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.inputs import Inputs
from bayesfric.recordings.observation import Observation


@dataclass(frozen=True)
class Number:
    """One number of a simulator's joint."""

    name: str
    units: tuple[str, str]  # where the joint turns, where it slides
    meaning: str

    def unit(self, joint: Joint) -> str:
        """Look up its unit for a joint, whose motor may turn where the joint slides."""
        if self.name == "gain" and joint.load.motion != joint.motor_motion:
            return "N per N m"
        return self.units[0 if joint.load.motion == "rotary" else 1]


NUMBERS: dict[str, Number] = {
    one.name: one
    for one in (
        Number("armature", ("kg m²", "kg"), "inertia of rotor and gears, at the joint"),
        Number("damping", ("N m s/rad", "N s/m"), "loss in proportion to speed"),
        Number("quadratic", ("N m s²/rad²", "N s²/m²"), "loss with the square of speed"),
        Number("friction", ("N m", "N"), "constant loss while it moves"),
        Number("static_friction", ("N m", "N"), "constant loss at standstill"),
        Number("link_inertia", ("kg m²", "kg"), "inertia of the link about the joint"),
        Number("link_moment", ("kg m", "kg m"), "mass of the link times distance to its centre"),
        Number("link_gravity_angle", ("rad", "rad"), "angle added to q in gravity"),
        Number("stiffness", ("N m/rad", "N/m"), "torque in proportion to position"),
        Number("stiffness_cubic", ("N m/rad³", "N/m³"), "torque with the cube of position"),
        Number("gain", ("N m per N m", "N per N"), "joint torque per measured motor torque"),
        Number("torque_offset", ("N m", "N"), "constant in the measured torque, at the joint"),
    )
}

# Rows of the table of quantities that are one of these numbers, and their share in it.
_PLACES: Mapping[str, tuple[str, float]] = {
    "inertia": ("armature", 1.0),
    "viscous": ("damping", 1.0),
    "viscous_positive": ("damping", 0.5),
    "viscous_negative": ("damping", 0.5),
    "quadratic": ("quadratic", 1.0),
    "coulomb": ("friction", 1.0),
    "coulomb_positive": ("friction", 0.5),
    "coulomb_negative": ("friction", 0.5),
}
_LOAD_PLACES: Mapping[str, str] = {
    "inertia": "link_inertia",
    "first_moment": "link_moment",
    "gravity_angle": "link_gravity_angle",
    "spring": "stiffness",
    "spring_cubic": "stiffness_cubic",
}
# Rows that say how the drive's torque is measured, and rows that shape others.
_DRIVE = ("gain", "offset", "delay")
_LOSSES = ("load", "load_drive", "load_back")
_RISES = ("stribeck_ratio", "stribeck_change", "stribeck_constant")
_LOAD_RISES = ("stribeck_ratio", "stribeck_change", "stribeck_load")
RISES = frozenset({*_RISES, *_LOAD_RISES})


@dataclass(frozen=True, eq=False)
class Moved:
    """Motion of one recording at its outputs, ``(M,)`` each, in SI at the joint."""

    q: Array
    qd: Array
    qdd: Array
    time: Array
    inputs: Inputs  # without a recording's name: an offset of its own is not the joint's

    @classmethod
    def of(cls, observation: Observation) -> Moved:
        """Take what a posterior was compared with."""
        o, at = observation, observation.filter.centres
        inputs = replace(o.inputs, recording="")
        return cls(o.q[at], o.qd[at], o.acceleration, o.stamps[at], inputs)


def torque_along(chain: Joint, values: Array, motions: Sequence[Moved]) -> Array:
    """Measured motor torque of ``(n, d)`` vectors along all motions, ``(n, M)``."""
    parts = [
        inverse_torque(chain, values, m.q, m.qd, m.qdd, inputs=m.inputs, time=m.time)
        for m in motions
    ]
    return np.concatenate(parts, axis=1)


def moving(motions: Sequence[Moved]) -> Array:
    """Position, speed and acceleration along all motions, ``(3, M)``."""
    return np.concatenate([(m.q, m.qd, m.qdd) for m in motions], axis=1)


@dataclass(frozen=True, eq=False)
class AtJoint:
    """A joint in a simulator's numbers, ``(n,)`` each, one for each parameter vector."""

    values: dict[str, Array]
    made_from: dict[str, tuple[str, ...]]  # parameters of the chain, by number
    reference: dict[str, Array]  # transmitted torque at the joint where a load loss is met
    # constant and damping in place of a parameter's term: of one that has no number, which are in
    # values, and of a rise at low speed, which are not
    fitted: dict[str, tuple[Array, Array]]


def at_joint(
    chain: Joint, values: Array, motions: Sequence[Moved], at_load: float | None = None
) -> AtJoint:
    """Describe a joint at its output.

    Parameters
    ----------
    chain
        The mechanism.
    values
        ``(n, n_parameters)`` in the order of ``chain.names``.
    motions
        Of the recordings: load losses are met at the mean size of the torque that passes there,
        and what a simulator has no number for is fitted by a constant and a viscous loss.
    at_load
        Torque at the joint at which load losses are met, N m or N.
    """
    column = dict(zip(chain.names, values.T, strict=True))
    found = {name: np.zeros(len(values)) for name in NUMBERS}
    made: dict[str, list[str]] = {name: [] for name in NUMBERS}
    reference: dict[str, Array] = {}

    def add(number: str, amount: Array, *names: str) -> None:
        found[number] = found[number] + amount
        made[number] += [name for name in dict.fromkeys(names) if name not in made[number]]

    passed: Array = np.ones(len(values))  # mean factor of all load losses behind, and here
    for k in range(len(chain.elements) - 1, -1, -1):
        element = chain.elements[k]
        reach = chain.reaches[element.name]
        own = {p.quantity: p for p in chain.parameters if p.owner == element.name}
        slots = chain.tables(values).elements[:, k].T
        at = dict(zip(kernels.ELEMENT_SLOTS, slots, strict=True))
        losses, rising, load_rising, squares, speeds = (
            [own[q].name for q in quantities if q in own]
            for quantities in (_LOSSES, _RISES, _LOAD_RISES, ("load_square",), ("load_speed",))
        )
        load: Array = np.zeros(len(values))
        if losses:
            if at_load is None:
                through = _transmitted(chain, values, k, motions)
                load = np.abs(through).mean(axis=1)
            else:
                load = passed * at_load
            reference[element.name] = load
        passed = passed * (1.0 + 0.5 * (at["load_drive"] - at["load_back"]))
        constant = 0.5 * (at["load_drive"] + at["load_back"]) * load / passed
        grown = at["load_square"] * load**2 / reach / passed
        add("friction", constant + grown, *losses, *squares)
        add("static_friction", constant * at["stribeck_load_ratio"], *load_rising)
        add("damping", at["load_speed"] * reach * load / passed, *speeds)
        for quantity, p in own.items():
            if quantity in _PLACES:
                number, share = _PLACES[quantity]
                assert p.row.power is not None
                amount = share * column[p.name] * reach ** (p.row.power + 1) / passed
                add(number, amount, p.name)
                if number == "friction":
                    add("static_friction", amount * at["stribeck_ratio"], *rising)
    for p in chain.parameters:
        if p.owner == "load" and p.quantity in _LOAD_PLACES:
            add(_LOAD_PLACES[p.quantity], column[p.name], p.name)
    whole = column.get("drive.gain", np.ones(len(values)))
    add("gain", chain.ratio * whole / passed, *(["drive.gain"] if "drive.gain" in column else []))
    made["gain"] += [p.name for p in chain.parameters if p.quantity in ("load_drive", "load_back")]
    if "offset" in column:
        add("torque_offset", chain.ratio * column["offset"] / passed, "offset")
    fitted = _fitted(chain, values, motions, found["gain"])
    for p in chain.parameters:
        if not places(p):
            add("friction", fitted[p.name][0], p.name)
            add("damping", fitted[p.name][1], p.name)
    found |= as_losses(found, motions)
    add("static_friction", found["friction"], *made["friction"])
    found["static_friction"] = np.maximum(found["static_friction"], 0.0)
    return AtJoint(found, {k: tuple(v) for k, v in made.items()}, reference, fitted)


def as_losses(numbers: Mapping[str, Array], motions: Sequence[Moved]) -> dict[str, Array]:
    """Refit ``friction`` and ``damping`` by least squares with neither below zero, where one is.

    All losses are losses, whatever a fit over a one-sided motion says.
    """
    constant, damping = numbers["friction"], numbers["damping"]
    if min(constant.min(), damping.min()) >= 0.0:
        return {}
    size = np.abs(moving(motions)[1])
    steeper = constant * size.sum() / max(size @ size, 1e-300)
    return {
        "friction": np.maximum(constant + np.minimum(damping, 0.0) * size.mean(), 0.0),
        "damping": np.maximum(damping + np.minimum(steeper, 0.0), 0.0),
    }


def without_load_losses(chain: Joint, values: Array) -> Array:
    """Take load losses out of parameter vectors ``(n, d)``, for formats that have their own."""
    lossy = [p.quantity.startswith("load") for p in chain.parameters]
    return np.where(lossy, 0.0, values)


def _transmitted(chain: Joint, values: Array, k: int, motions: Sequence[Moved]) -> Array:
    """Torque at the output of element ``k`` along all motions, at the joint, ``(n, M)``."""
    behind = chain.elements[k + 1 :]
    owners = {e.name for e in behind} | {"load"}
    shaft = Element("output", motion=behind[0].motion if behind else chain.load.motion)
    terms = tuple(term for term in chain.terms if term.owner in owners)
    rest = Joint(elements=(shaft, *behind), load=chain.load, terms=terms)
    columns = [chain.names.index(name) for name in rest.names]
    return torque_along(rest, values[:, columns], motions) * rest.ratio


def places(p: Parameter) -> bool:
    """Whether a parameter's term has a number of its own, or says how torque is measured."""
    known = _LOAD_PLACES if p.owner == "load" else _PLACES
    return p.row.role != "own" or p.quantity in known or p.quantity in _DRIVE


def _fitted(
    chain: Joint, values: Array, motions: Sequence[Moved], gain: Array
) -> dict[str, tuple[Array, Array]]:
    """Fit what has no number, or none while it moves, by a constant and a viscous loss."""
    rest = [k for k, p in enumerate(chain.parameters) if not places(p) or p.quantity in RISES]
    if not rest:
        return {}
    _, speed, _ = moving(motions)
    basis = np.stack([np.sign(speed), speed], axis=1)
    whole = torque_along(chain, values, motions)
    found = {}
    for k in rest:
        without = values.copy()
        without[:, k] = 0.0
        term = gain[:, None] * (whole - torque_along(chain, without, motions))
        constant, damping = np.linalg.lstsq(basis, term.T, rcond=None)[0]
        found[chain.names[k]] = (constant, damping)
    return found


def simulated_torque(chain: Joint, numbers: Mapping[str, float], motions: Sequence[Moved]) -> Array:
    """Measured motor torque of a simulator's joint along all motions, ``(M,)``, N m or N.

    ``numbers`` are those of :data:`NUMBERS`; a rise of friction at standstill has no say. Known
    masses and torques on the load of ``chain`` are on that of the simulator, too.
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
    own = {"offset": "torque_offset", "gain": "gain"} | {k: x for k, (x, _) in _PLACES.items()}
    places_of = {"load": _LOAD_PLACES}
    vector = [numbers[places_of.get(p.owner, own)[p.quantity]] for p in plain.parameters]
    return np.asarray(torque_along(plain, np.array([vector]), motions)[0])
