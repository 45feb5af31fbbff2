"""Torque and friction of the joint for a wanted motion, as C99 and as Python."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesfric.export.joint_model import NUMBERS, Moved, torque_along
from bayesfric.export.extra_terms import left_out
from bayesfric.export.format import Content, Files, Format
from bayesfric.export.written_law import law
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array

_ABOUT = {f"about: {number}": number for number in NUMBERS}


def _torque(chain: Joint, vector: Array, motions: Sequence[Moved]) -> Array:
    """Motor torque along the motions of what is written out."""
    kept = [not left_out(p.row) for p in chain.parameters]
    return np.asarray(torque_along(chain, np.where(kept, vector, 0.0)[None], motions)[0])


def c_files(content: Content) -> Files:
    """Write the whole law in C99, source and header."""
    chain, vector = content.found.joint, content.vectors.middle
    given = {
        "name": content.stem,
        "law": law(chain, vector, "c"),
        "unit": "N m" if chain.motor_motion == "rotary" else "N",
        "position": "rad" if content.rotary else "m",
    }
    names = (f"feedforward.{suffix}" for suffix in ("c", "h"))
    return {f"{content.stem}_{name}": content.filled(f"{name}.j2", **given) for name in names}


def _python(content: Content) -> Files:
    made = law(content.found.joint, content.vectors.middle, "python")
    text = content.filled("feedforward.py.j2", law=made)
    return {f"{content.stem}_feedforward.py": text}


FORMATS = tuple(
    Format(
        name=name,
        meaning=meaning,
        names=_ABOUT,
        write=write,
        whole=True,
        torque=_torque,
    )
    for name, meaning, write in (
        ("c", "feed-forward in C99", c_files),
        ("python", "feed-forward in Python", _python),
    )
)
