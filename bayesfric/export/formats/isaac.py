"""Isaac Lab and Isaac Sim: an actuator's configuration, and attributes of the USD joint.

Names and units: ``isaaclab/actuators/actuator_base_cfg.py`` of isaac-sim/IsaacLab (efforts in N m,
viscous friction in N m s/rad), and the Physx Joint Schema of NVIDIA's Omni Physics documentation,
``PhysxJointAxisAPI:angular``, whose viscousFrictionCoefficient is per degree of what turns (its
parser multiplies by 57.2958), as of Isaac Sim 5.0.
"""

from __future__ import annotations

import math

from bayesfric.export.format import Content, Files, Format

_NAMES = {
    "armature": "armature",
    "friction": "static_friction",
    "dynamic_friction": "friction",
    "viscous_friction": "damping",
}


def _write(content: Content) -> Files:
    per_degree = math.pi / 180.0 if content.rotary else 1.0
    given = {
        "stem": content.stem,
        "viscous": per_degree * content.numbers["damping"],
    }
    files = {
        f"{content.stem}_isaac_lab.py": "isaac_lab.py.j2",
        f"{content.stem}_isaac_lab.yaml": "isaac_lab.yaml.j2",
        f"{content.stem}.usda": "joint.usda.j2",
    }
    return {name: content.filled(template, **given) for name, template in files.items()}


FORMATS = (
    Format(
        name="isaac",
        meaning="Isaac Lab and Isaac Sim",
        names=_NAMES,
        write=_write,
        notes=frozenset({"joint torque", "isaac"}),
    ),
)
