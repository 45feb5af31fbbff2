"""Isaac Lab and Isaac Sim: an actuator's configuration, and attributes of the USD joint.

Names and units: ``isaaclab/actuators/actuator_base_cfg.py`` of isaac-sim/IsaacLab (efforts in N m,
viscous friction in N m s/rad), and the Physx Joint Schema of NVIDIA's Omni Physics documentation,
``PhysxJointAxisAPI:angular``, whose viscousFrictionCoefficient is per degree of what turns (its
parser multiplies by 57.2958). Up to Isaac Sim 4.5, ``PxArticulationJointReducedCoordinate`` had a
friction coefficient without unit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from bayesfric.errors import BadInput
from bayesfric.export.at_joint import NUMBERS
from bayesfric.export.carried import DRIVE, LINK
from bayesfric.export.format import Attribute, Content, Files, Format, Options, filled
from bayesfric.export.formats.urdf import plain_name
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import Motion

_VERSIONS = ("5.0", "4.5")
_PER_DEGREE = math.pi / 180.0


def _old(options: Options) -> bool:
    return options.isaac_sim == "4.5"


def _carries(options: Options) -> frozenset[str]:
    losses = () if _old(options) else ("damping", "friction", "static_friction")
    return frozenset({"armature", *losses})


def _attributes(options: Options, rotary: bool) -> Sequence[Attribute]:
    motion: Motion = "rotary" if rotary else "linear"
    axis = "angular" if rotary else "linear"
    made = [Attribute("armature", "armature", NUMBERS["armature"].unit(motion))]
    if _old(options):
        return made
    names = {
        "friction": "static_friction",
        "dynamic_friction": "friction",
        "viscous_friction": "damping",
    }
    made += [Attribute(k, v, NUMBERS[v].unit(motion)) for k, v in names.items()]
    if rotary:
        usd = f"{axis}:viscousFrictionCoefficient"
        made.append(Attribute(usd, "damping", "N m s/deg", _PER_DEGREE))
    return made


def _write(content: Content) -> Files:
    name = content.options.joint
    given = {
        "remarks": content.remarks,
        "name": name,
        "numbers": content.numbers,
        "old": _old(content.options),
        "rotary": content.rotary,
        "per_degree": _PER_DEGREE if content.rotary else 1.0,
        "variable": plain_name(name).upper(),
        "prim": plain_name(name),
    }
    stem = plain_name(name)
    return {
        f"{stem}_isaac_lab.py": filled("isaac_lab.py.j2", **given),
        f"{stem}_isaac_lab.yaml": filled("isaac_lab.yaml.j2", **given),
        f"{stem}.usda": filled("joint.usda.j2", **given),
    }


def _check(options: Options) -> None:
    if options.isaac_sim not in (None, *_VERSIONS):
        mend = "give 5.0 (and later) or 4.5 (and earlier)"
        raise BadInput("--isaac-sim", f"is {options.isaac_sim}", mend)


def _notes(options: Options, _: Joint) -> Sequence[str]:
    version = "isaac four" if _old(options) else "isaac five"
    return ("joint torque", version, "isaac gains")


FORMATS = (
    Format(
        name="isaac",
        meaning="Isaac Lab and Isaac Sim",
        carries=_carries,
        supplied=frozenset((*LINK, *DRIVE)),
        attributes=_attributes,
        write=_write,
        options=frozenset({"isaac_sim"}),
        notes=_notes,
        check=_check,
    ),
)
