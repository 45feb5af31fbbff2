"""A body that has a link's inertia and first moment, for formats that hold whole models."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

# Share of the rotor's inertia that a link without any is given: simulators want a positive one.
_SHARE = 0.5
# Mass of a body that nothing tells, kg.
_ANY = 1.0


@dataclass(frozen=True)
class Pendulum:
    """A rigid body at the joint, turning about y with gravity along -z; or sliding along x.

    Torque tells inertia and first moment about the joint, not mass and distance apart: these are
    chosen so that half of the inertia is that of the mass at its distance.
    """

    mass: float  # kg
    com: tuple[float, float, float]  # of the centre of mass where the joint is at zero, m
    about_axis: float  # inertia about the joint's axis through the centre of mass, kg m²
    across: float  # about the other two, kg m²
    armature: float  # what is left for the joint, kg m² or kg
    inertia: float  # of the body about the joint, kg m² or kg
    moved: bool  # whether inertia of the rotor was given to a link that has none of its own


def pendulum(numbers: Mapping[str, float], rotary: bool) -> Pendulum:
    """Choose a body for a joint's numbers."""
    inertia, armature = numbers["link_inertia"], numbers["armature"]
    moment, angle = numbers["link_moment"], numbers["link_gravity_angle"]
    moved = inertia <= 0.0
    if moved:
        inertia, armature = _SHARE * armature, (1.0 - _SHARE) * armature
    if not rotary:
        cube = inertia / 600.0  # of 0.1 m, which says nothing
        return Pendulum(inertia, (0.0, 0.0, 0.0), cube, cube, armature, inertia, moved)
    if moment == 0.0:
        return Pendulum(_ANY, (0.0, 0.0, 0.0), inertia, inertia, armature, inertia, moved)
    distance = 0.5 * inertia / moment
    com = (-distance * math.sin(angle), 0.0, -distance * math.cos(angle))
    about = 0.5 * inertia
    return Pendulum(moment / distance, com, about, about, armature, inertia, moved)
