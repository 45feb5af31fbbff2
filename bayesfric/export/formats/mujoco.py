"""MuJoCo: a whole model of the joint, or a joint of a model changed in place."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

from bayesfric.errors import BadInput, nearest
from bayesfric.export.at_joint import NUMBERS
from bayesfric.export.carried import DRIVE, LINK
from bayesfric.export.format import Attribute, Content, Files, Format, Options, filled
from bayesfric.export.law import law, unwritten
from bayesfric.export.pendulum import pendulum
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import Motion

# Step of the model that is written, s. With a friction constraint as stiff as two steps allow,
# motion is that of the fitted joint to a tenth of a milliradian.
_STEP = 5e-4


def _carries(options: Options) -> frozenset[str]:
    polynomial = {"quadratic", "stiffness_cubic"} if options.damping_terms == 1 else set()
    return frozenset(NUMBERS) - {"static_friction"} - polynomial


def _attributes(options: Options, rotary: bool) -> Sequence[Attribute]:
    named = {
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
    motion: Motion = "rotary" if rotary else "linear"
    return [
        Attribute(k, v, NUMBERS[v].unit(motion))
        for k, v in named.items()
        if options.into is None or v not in (*LINK, *DRIVE)
    ]


def _joint(numbers: Mapping[str, float], terms: int | None) -> dict[str, str]:
    """Attributes of the joint, as text."""
    polynomial = {
        "damping": (numbers["damping"], numbers["quadratic"]),
        "stiffness": (numbers["stiffness"], numbers["stiffness_cubic"]),
    }
    damping, quadratic = polynomial["damping"]
    stiffness, cubic = polynomial["stiffness"]
    whole = terms == 3
    return {
        "armature": repr(numbers["armature"]),
        "damping": f"{damping!r} {quadratic!r} 0" if quadratic or whole else repr(damping),
        "frictionloss": repr(numbers["friction"]),
        **({"stiffness": f"{stiffness!r} 0 {cubic!r}" if cubic else repr(stiffness)}
           if stiffness or cubic else {}),
    }  # fmt: skip


def _write(content: Content) -> Files:
    name, numbers = content.options.joint, dict(content.numbers)
    controller = {}
    if unwritten(content.found.joint) is None:
        controller[f"{_plain(name)}_friction.py"] = _controller(content)
    if content.options.into is not None:
        path = content.options.into
        attributes = _joint(numbers, content.options.damping_terms)
        return {path.name: patched(_read(path), name, attributes, str(path)), **controller}
    body = pendulum(numbers, content.rotary)
    numbers["armature"] = body.armature
    text = filled(
        "mujoco.xml.j2",
        remarks=content.remarks,
        name=name,
        joint=_joint(numbers, content.options.damping_terms),
        numbers=numbers,
        body=body,
        rotary=content.rotary,
        gravity=content.found.joint.load.gravity,
        step=_STEP,
    )
    return {f"{_plain(name)}.xml": text, **controller}


def _notes(options: Options, chain: Joint) -> Sequence[str]:
    whole = () if options.into is not None else ("ctrl", "body")
    controller = "mujoco controller" if unwritten(chain) is None else "mujoco no controller"
    return (*whole, "mujoco stick", "mujoco versions", controller)


def _plain(name: str) -> str:
    return re.sub(r"\W", "_", name)


def _controller(content: Content) -> str:
    """Write friction that depends on the load, for a model whose friction is set at each step."""
    made = law(content.found.joint, content.vectors.middle, "python")
    return filled(
        "mujoco_friction.py.j2",
        law=made,
        name=content.options.joint,
        remarks=content.remarks,
        numbers=content.numbers,
        gravity=content.found.joint.load.gravity,
    )


def _read(path: Path) -> str:
    try:
        return path.read_bytes().decode()
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"--into {path}", f"cannot be read ({error})", "name an MJCF file") from None


def patched(text: str, name: str, attributes: Mapping[str, str], where: str) -> str:
    """Set attributes of a named joint of an MJCF text; every other byte stays.

    Raises
    ------
    BadInput
        If the text is no XML, or has no such joint or several.
    """
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise BadInput(f"--into {where}", f"is no XML ({error})", "name an MJCF file") from None
    known = [str(one.get("name")) for one in root.iter("joint") if one.get("name")]
    body = [str(j.get("name")) for b in root.iter("body") for j in b.findall("joint")]
    if body.count(name) != 1:
        what = f"has {'several joints' if name in body else 'no joint'} {name!r}"
        raise BadInput(f"--into {where}", what, nearest(name, sorted(set(known) - {"None"})))
    # an equality of joints is called joint, too, but refers to others
    tag = next(
        m
        for m in _tags(text)
        if _attribute(m.group(), "name") == name and _attribute(m.group(), "joint1") is None
    )
    changed = tag.group()
    for key, value in attributes.items():
        changed = _set(changed, key, value)
    return text[: tag.start()] + changed + text[tag.end() :]


def _tags(text: str) -> list[re.Match[str]]:
    hidden = [m.span() for m in re.finditer(r"<!--.*?-->", text, re.DOTALL)]
    tags = re.finditer(r"<joint\b(?:[^>\"']|\"[^\"]*\"|'[^']*')*>", text)
    return [m for m in tags if not any(a <= m.start() < b for a, b in hidden)]


def _attribute(tag: str, key: str) -> str | None:
    found = re.search(rf"\s{key}\s*=\s*(\"([^\"]*)\"|'([^']*)')", tag)
    return None if found is None else found[2] if found[2] is not None else found[3]


def _set(tag: str, key: str, value: str) -> str:
    found = re.search(rf"(\s{key}\s*=\s*)(\"[^\"]*\"|'[^']*')", tag)
    if found is not None:
        return f'{tag[: found.start()]}{found[1]}"{value}"{tag[found.end() :]}'
    end = re.search(r"\s*/?>$", tag)
    assert end is not None
    return f'{tag[: end.start()]} {key}="{value}"{tag[end.start() :]}'


def _check(options: Options) -> None:
    if options.damping_terms not in (None, 1, 3):
        raise BadInput("--damping-terms", f"is {options.damping_terms}", "give 1 or 3")
    if options.into is not None:
        patched(_read(options.into), options.joint, {}, str(options.into))


FORMATS = (
    Format(
        name="mujoco",
        meaning="MuJoCo",
        carries=_carries,
        supplied=frozenset(),
        attributes=_attributes,
        write=_write,
        options=frozenset({"into", "damping_terms"}),
        notes=_notes,
        check=_check,
    ),
)
