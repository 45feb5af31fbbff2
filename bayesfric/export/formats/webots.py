"""A joint of Webots: JointParameters with dampingConstant, staticFriction and springConstant."""

from __future__ import annotations

from bayesfric.export.format import Content, Files, Format

_NAMES = {
    "dampingConstant": "damping",
    "staticFriction": "friction",
    "springConstant": "stiffness",
}


def _write(content: Content) -> Files:
    kind = "HingeJointParameters" if content.rotary else "JointParameters"
    fields = [f"  {name} {content.numbers[number]!r}" for name, number in _NAMES.items()]
    remarks = [f"# {remark}" for remark in content.remarks]
    text = "\n".join([*remarks, f"{kind} {{", *fields, "}"])
    return {f"{content.stem}_webots.wbt": f"{text}\n"}


FORMATS = (Format("webots", "Webots", _NAMES, _write, notes=frozenset({"joint torque"})),)
