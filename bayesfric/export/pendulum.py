"""A body that has a link's inertia and first moment, for formats that hold whole models."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

# Share of a link's inertia that is that of its mass at its distance.
_AT_DISTANCE = 0.5
# Shares, of the inertia and of what is at a distance, of a link that weighs something and whose
# inertia is not told apart from the rotor's. The fit has no room for a lighter pendulum: of a
# first moment ml and all of an inertia I it is (ml)²/I, and any share less makes it heavier.
_WEIGHING = 0.9
# What a link without inertia or weight is given, as simulators want both: a share of the rotor's
# inertia, and kg.
_LITTLE, _PLACEHOLDER = 1e-3, 0.1
# Mass of a link of which torque tells the inertia alone, kg.
_ANY = 1.0


@dataclass(frozen=True)
class Pendulum:
    """A rigid body at the joint, turning about y with gravity along -z; or sliding along x.

    Torque tells inertia and first moment about the joint, not mass and distance apart: these are
    chosen so that half of the inertia is that of the mass at its distance. Where it tells inertia
    only together with the rotor's, a link that weighs something is given nearly all of it, and one
    that does not is a placeholder.
    """

    mass: float  # kg
    com: tuple[float, float, float]  # of the centre of mass where the joint is at zero, m
    about_axis: float  # inertia about the joint's axis through the centre of mass, kg m²
    across: float  # about the other two, kg m²
    armature: float  # what is left for the joint, kg m² or kg
    inertia: float  # of the body about the joint, kg m² or kg


def pendulum(numbers: Mapping[str, float], rotary: bool) -> Pendulum:
    """Choose a body for a joint's numbers."""
    inertia, armature = numbers["link_inertia"], numbers["armature"]
    moment, angle = numbers["link_moment"], numbers["link_gravity_angle"]
    weighs, own = rotary and moment != 0.0, inertia > 0.0
    held = _AT_DISTANCE if own else _WEIGHING
    if not own:
        share = _WEIGHING if weighs else _LITTLE
        inertia, armature = share * armature, (1.0 - share) * armature
    centre = (0.0, 0.0, 0.0)
    if not rotary:
        cube = inertia / 600.0  # of 0.1 m, which says nothing
        return Pendulum(inertia, centre, cube, cube, armature, inertia)
    if not weighs:
        mass = _ANY if own else _PLACEHOLDER
        return Pendulum(mass, centre, inertia, inertia, armature, inertia)
    distance = held * inertia / moment
    com = (-distance * math.sin(angle), 0.0, -distance * math.cos(angle))
    about = (1.0 - held) * inertia
    return Pendulum(moment / distance, com, about, about, armature, inertia)
