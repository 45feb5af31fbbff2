"""MuJoCo: a whole model of the joint, or a joint of a model changed in place."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from xml.parsers import expat

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.safe_read import read_text
from bayesfric.export.format import Content, Files, Format
from bayesfric.export.written_law import law, unwritten

# Step of the model that is written, s. With a friction constraint as stiff as two steps allow,
# motion is that of the fitted joint to a tenth of a milliradian.
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


def _joint(numbers: Mapping[str, float]) -> dict[str, str]:
    """Attributes of the joint, as text."""
    damping, quadratic = numbers["damping"], numbers["quadratic"]
    stiffness, cubic = numbers["stiffness"], numbers["stiffness_cubic"]
    found = {
        "armature": repr(numbers["armature"]),
        "damping": f"{damping!r} {quadratic!r} 0" if quadratic else repr(damping),
        "frictionloss": repr(numbers["friction"]),
    }
    if stiffness or cubic:
        found["stiffness"] = f"{stiffness!r} 0 {cubic!r}" if cubic else repr(stiffness)
    return found


def _write(content: Content) -> Files:
    chain, options, numbers = content.found.joint, content.options, dict(content.numbers)
    files: Files = {}
    if unwritten(chain) is None:
        made = law(chain, content.vectors.middle, "python")
        text = content.filled("mujoco_friction.py.j2", law=made)
        files = {f"{content.stem}_friction.py": text}
    if (path := options.into) is not None:
        attributes = _joint(numbers)
        return {path.name: patched(_read(path), options.joint, attributes, str(path)), **files}
    body = content.body
    joint = _joint(numbers | {"armature": body.armature})
    text = content.filled("mujoco.xml.j2", joint=joint, body=body, step=_STEP)
    return {f"{content.stem}.xml": text, **files}


def _read(path: Path) -> str:
    return read_text(path, "name an MJCF file with --into")


def patched(text: str, name: str, attributes: Mapping[str, str], where: str) -> str:
    """Set attributes of a named joint of an MJCF text; every other byte stays.

    Raises
    ------
    BadInput
        If the text is no XML, or has no such joint or several.
    """
    data, parser = text.encode(), expat.ParserCreate("utf-8")
    around: list[str] = [""]
    places: list[tuple[str, int]] = []

    def begin(tag: str, given: dict[str, str]) -> None:
        if (around[-1], tag) == ("body", "joint") and "name" in given:
            places.append((given["name"], parser.CurrentByteIndex))
        around.append(tag)

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda _: around.pop()
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise BadInput(f"--into {where}", f"is no XML ({error})", "name an MJCF file") from None
    named = [place for known, place in places if known == name]
    if len(named) != 1:
        what = f"has {'several joints' if named else 'no joint'} {name!r}"
        raise BadInput(f"--into {where}", what, nearest(name, sorted(dict(places))))
    before, rest = data[: named[0]].decode(), data[named[0] :].decode()
    tag = re.match(r"(?:[^>\"']|\"[^\"]*\"|'[^']*')*>", rest)
    assert tag is not None
    changed = tag[0]
    for key, value in attributes.items():
        there = rf"(\s{key}\s*=\s*)(?:\"[^\"]*\"|'[^']*')"
        changed, count = re.subn(there, rf'\g<1>"{value}"', changed, count=1)
        if not count:
            inside = changed.rstrip("/>").rstrip()
            changed = f'{inside} {key}="{value}"{changed[len(inside) :]}'
    return before + changed + rest[tag.end() :]


FORMATS = (
    Format(
        name="mujoco",
        meaning="MuJoCo",
        names=_NAMES,
        write=_write,
        options=frozenset({"into"}),
        notes=frozenset({"mujoco"}),
    ),
)
