"""ros2_control: parameters of a controller with friction compensation, and its feed-forward in C.

``gains.<joint>.ff_velocity_scale`` of the joint_trajectory_controller (control.ros.org, "Details
about parameters") is effort per wanted speed where it commands an effort: viscous friction. It has
no place for more; what a controller of one's own wants beside it stands under ``friction``.
"""

from __future__ import annotations

from bayesfric.export.format import Content, Files, Format
from bayesfric.export.formats.feedforward import c_files

_NAMES = {
    "ff_velocity_scale": "damping",
    "friction.coulomb": "friction",
    "friction.static": "static_friction",
    "friction.quadratic": "quadratic",
    "friction.armature": "armature",
}


def _write(content: Content) -> Files:
    text = content.filled("ros2_control.yaml.j2", stem=content.stem)
    return {f"{content.stem}_ros2_control.yaml": text, **c_files(content)}


FORMATS = (
    Format(
        name="ros2-control",
        meaning="ros2_control, and its feed-forward in C99",
        names=_NAMES,
        write=_write,
        notes=frozenset({"joint torque"}),
    ),
)
