"""Torque and friction of the joint for a wanted motion, as C99 and as Python."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesfric.export.at_joint import NUMBERS, Array, Moved, torque_along
from bayesfric.export.carried import left_out
from bayesfric.export.format import Attribute, Content, Files, Format, Options, filled
from bayesfric.export.formats.urdf import plain_name
from bayesfric.export.law import Language, law
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import Motion

_TOLD = ("armature", "damping", "quadratic", "friction", "link_inertia", "link_moment", "gain")


def _notes(_: Options, chain: Joint) -> Sequence[str]:
    return ["law rest", *["law room"] * any(left_out(p.row) for p in chain.parameters)]


def _attributes(_: Options, rotary: bool) -> Sequence[Attribute]:
    motion: Motion = "rotary" if rotary else "linear"
    return [Attribute(f"about: {x}", x, NUMBERS[x].unit(motion)) for x in _TOLD]


def _torque(chain: Joint, vector: Array, motions: Sequence[Moved]) -> Array:
    """Motor torque along the motions of what is written out."""
    kept = [not left_out(p.row) for p in chain.parameters]
    return np.asarray(torque_along(chain, np.where(kept, vector, 0.0)[None], motions)[0])


def _write_c(content: Content) -> Files:
    chain, vector = content.found.joint, content.vectors.middle
    languages: tuple[Language, ...] = ("double", "float")
    name = plain_name(content.options.joint)
    given = {
        "remarks": content.remarks,
        "name": name,
        "laws": {language: law(chain, vector, language) for language in languages},
        "unit": "N m" if chain.motor_motion == "rotary" else "N",
        "position": "rad" if content.rotary else "m",
    }
    return {
        f"{name}_feedforward.c": filled("feedforward.c.j2", **given),
        f"{name}_feedforward.h": filled("feedforward.h.j2", **given),
    }


def _write_python(content: Content) -> Files:
    made = law(content.found.joint, content.vectors.middle, "python")
    name = plain_name(content.options.joint)
    text = filled("feedforward.py.j2", remarks=content.remarks, name=name, law=made)
    return {f"{name}_feedforward.py": text}


FORMATS = tuple(
    Format(
        name=name,
        meaning=meaning,
        carries=lambda _: frozenset(NUMBERS),
        supplied=frozenset(),
        attributes=_attributes,
        write=write,
        notes=_notes,
        whole=True,
        torque=_torque,
    )
    for name, meaning, write in (
        ("c", "feed-forward in C99", _write_c),
        ("python", "feed-forward in Python", _write_python),
    )
)
