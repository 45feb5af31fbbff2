"""Isaac Lab and Isaac Sim: an actuator's configuration, and attributes of the USD joint.

Names and units: ``isaaclab/actuators/actuator_base_cfg.py`` of isaac-sim/IsaacLab (efforts in N m,
viscous friction in N m s/rad), and the Physx Joint Schema of NVIDIA's Omni Physics documentation,
``PhysxJointAxisAPI:angular``, whose viscousFrictionCoefficient is per degree of what turns (its
parser multiplies by 57.2958). Up to Isaac Sim 4.5, ``PxArticulationJointReducedCoordinate`` had a
friction coefficient without unit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from bayesfric.errors import BadInput
from bayesfric.export.format import Content, Files, Format, Options

_OLD = "4.5"
_NAMES = {
    "armature": "armature",
    "friction": "static_friction",
    "dynamic_friction": "friction",
    "viscous_friction": "damping",
}


def _names(options: Options) -> Mapping[str, str]:
    return {"armature": "armature"} if options.isaac_sim == _OLD else _NAMES


def _write(content: Content) -> Files:
    per_degree = math.pi / 180.0 if content.rotary else 1.0
    given = {
        "old": content.options.isaac_sim == _OLD,
        "stem": content.stem,
        "viscous": per_degree * content.numbers["damping"],
    }
    files = {
        f"{content.stem}_isaac_lab.py": "isaac_lab.py.j2",
        f"{content.stem}_isaac_lab.yaml": "isaac_lab.yaml.j2",
        f"{content.stem}.usda": "joint.usda.j2",
    }
    return {name: content.filled(template, **given) for name, template in files.items()}


def _check(options: Options) -> None:
    if options.isaac_sim not in (None, "5.0", _OLD):
        mend = "give 5.0 (and later) or 4.5 (and earlier)"
        raise BadInput("--isaac-sim", f"is {options.isaac_sim}", mend)


FORMATS = (
    Format(
        name="isaac",
        meaning="Isaac Lab and Isaac Sim",
        names=_names,
        write=_write,
        options=frozenset({"isaac_sim"}),
        notes=frozenset({"joint torque", "isaac"}),
        check=_check,
    ),
)
