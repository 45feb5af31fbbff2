"""``bayesfric init arm``: what is known of an arm, from a log and a URDF."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayesfric.arm.arm import Arm
from bayesfric.arm.arm_log import layout_of
from bayesfric.base.templates import environment
from bayesfric.problem.config_text import toml_value
from bayesfric.recordings.units import OPEN


def arm_configuration(log: Path, urdf: Path, table: str | None = None) -> dict[str, Any]:
    """Write an ``arm.toml``: ``text``, and the keys left ``open``.

    Raises
    ------
    BadInput
        If log and URDF do not go together.
    """
    joints = Arm(urdf).bodies.joints
    layout = layout_of(log, joints, table, in_order=True)
    made = environment("bayesfric.commands")
    made.filters["toml"] = toml_value
    told = {"recording": layout.recording, "labels": layout.labels, "joints": list(joints)}
    text = made.get_template("arm.toml.j2").render(urdf=urdf, log=log, **told)
    units = {f"{k}.unit": OPEN for k, v in layout.recording.items() if OPEN in str(v)}
    held = {f"joints.{name}.held": OPEN for name in joints if name not in layout.labels}
    return {"text": text, "open": units | held}
