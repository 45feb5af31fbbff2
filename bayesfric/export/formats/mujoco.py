"""MuJoCo: a whole model of the joint, or a joint of a model changed in place."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any
from xml.parsers import expat

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.safe_read import read_text
from bayesfric.export.format import Files, Format, filled

# Time step of the model, s. With a friction constraint as stiff as two steps allow, its motion is
# that of the fitted joint to a tenth of a milliradian.
_STEP = 5e-4
_NAMES = {
    "joint armature": "armature",
    "joint damping": "damping",
    "joint damping, second number": "quadratic",
    "joint frictionloss": "friction",
    "joint stiffness": "stiffness",
    "joint stiffness, third number": "stiffness_cubic",
    "body inertia about the joint": "link_inertia",
    "body mass times distance": "link_moment",
    "body angle of its centre": "link_gravity_angle",
    "actuator gear": "gain",
    "actuator bias, negative": "torque_offset",
}


def _attributes(numbers: Mapping[str, float]) -> dict[str, str]:
    """Format the attributes of the joint."""
    damping, quadratic = numbers["damping"], numbers["quadratic"]
    stiffness, cubic = numbers["stiffness"], numbers["stiffness_cubic"]
    attributes = {
        "armature": repr(numbers["armature"]),
        "damping": f"{damping!r} {quadratic!r} 0" if quadratic else repr(damping),
        "frictionloss": repr(numbers["friction"]),
    }
    if stiffness or cubic:
        attributes["stiffness"] = f"{stiffness!r} 0 {cubic!r}" if cubic else repr(stiffness)
    return attributes


def _write(content: Mapping[str, Any]) -> Files:
    options, numbers, stem = content["options"], content["numbers"], content["stem"]
    files: Files = {}
    if "law" in content:
        files = {f"{stem}_friction.py": filled("mujoco_friction.py.j2", **content)}
    if (path := options.into) is not None:
        text = read_text(path, "name an MJCF file with --into")
        return {path.name: patched(text, options.joint, _attributes(numbers), str(path)), **files}
    joint = _attributes({**numbers, "armature": content["body"].armature})
    return {f"{stem}.xml": filled("mujoco.xml.j2", joint=joint, step=_STEP, **content), **files}


def patched(text: str, name: str, attributes: Mapping[str, str], where: str) -> str:
    """Set attributes of a named joint in an MJCF text; every other byte stays."""
    data, parser = text.encode(), expat.ParserCreate("utf-8")
    open_tags: list[str] = [""]
    joints: list[tuple[str, int]] = []  # name, and position of the tag

    def begin(tag: str, tag_attributes: dict[str, str]) -> None:
        if (open_tags[-1], tag) == ("body", "joint") and "name" in tag_attributes:
            joints.append((tag_attributes["name"], parser.CurrentByteIndex))
        open_tags.append(tag)

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda _: open_tags.pop()
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise BadInput(f"--into {where}", f"is no XML ({error})", "name an MJCF file") from None
    positions = [position for joint, position in joints if joint == name]
    if len(positions) != 1:
        problem = f"has {'several joints' if positions else 'no joint'} {name!r}"
        raise BadInput(f"--into {where}", problem, nearest(name, sorted(dict(joints))))
    before, after = data[: positions[0]].decode(), data[positions[0] :].decode()
    tag = re.match(r"(?:[^>\"']|\"[^\"]*\"|'[^']*')*>", after)
    assert tag is not None
    changed = tag[0]
    for key, value in attributes.items():
        attribute = rf"(\s{key}\s*=\s*)(?:\"[^\"]*\"|'[^']*')"
        changed, count = re.subn(attribute, rf'\g<1>"{value}"', changed, count=1)
        if not count:
            inside = changed.rstrip("/>").rstrip()
            changed = f'{inside} {key}="{value}"{changed[len(inside) :]}'
    return before + changed + after[tag.end() :]


FORMATS = (
    Format(
        name="mujoco",
        meaning="MuJoCo",
        names=_NAMES,
        write=_write,
        language="python",
        options=frozenset({"into"}),
        notes=frozenset({"mujoco"}),
    ),
)
