"""``bayesfric init``: a commented configuration to start from."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import Any

from bayesfric.errors import BadInput, nearest
from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.presets import PRESETS


def configuration(preset: str, recordings: Sequence[str] | None = None) -> str:
    """Text of a commented configuration for a preset.

    ``recordings`` are the lines of its table, examples if left out.
    """
    if preset not in PRESETS:
        raise BadInput(preset, "there is no such preset", nearest(preset, PRESETS))
    chosen = PRESETS[preset]
    chain = chosen.chain()
    # of a recorded joint most of the inertia is what the gearbox moves
    moved = () if recordings is None else chain.unseen_inertia
    chain = _with_load_behind(chain, moved)
    first = chain.parameters[0]
    return "\n".join(
        [
            f"# bayesfric: {chosen.meaning}.",
            "# What begins with '#' is an example; every key: bayesfric init --all-keys",
            "[mechanism]",
            *_mechanism(preset, chain, moved),
            "",
            *(_recordings(chain) if recordings is None else recordings),
            "",
            "[priors]  # a number fixes, a range is uniform; what is left out is wide",
            f'# "{first.name}" = [1e-4, 1e-3]  # {first.unit}',
            "",
        ]
    )


def _mechanism(preset: str, chain: Chain, moved: Collection[str]) -> Iterator[str]:
    others = " or ".join(json.dumps(name) for name in other_presets(preset))
    yield f'preset = "{preset}"  # or {others}'
    yield 'terms = "auto"  # puts in what else explains the torque; or "as written"'
    yield "# delay = true  # the position comes late or early against the torque"
    if may_slide(chain):
        yield '# motion = "linear"  # it slides: m and N in place of rad and N m'
    for element in chain.elements:
        lines = []
        if element.ratio != 1.0:
            lines.append(
                f"# ratio = {element.ratio:g}  # speed of the motor over that of the joint"
            )
        if f"{element.name}.inertia" in moved:
            lines.append("inertia = false")
        if lines:
            yield from (f"[mechanism.elements.{element.name}]", *lines)
    if moved:
        yield "[mechanism.load]"
        yield "inertia = true  # the load loss sees it here; the motor's own is seldom told apart"


def may_slide(chain: Chain) -> bool:
    """Whether it may be an axis that slides as well: it has no gear, and gravity does not act."""
    return chain.ratio == 1.0 and "first_moment" not in chain.load.choices


def _with_load_behind(chain: Chain, moved: Collection[str]) -> Chain:
    """Put inertia into the load, so that a load loss sees what accelerates it, too."""
    if not moved:
        return chain
    without: dict[str, Any] = {"inertia": False}
    elements = [
        replace(e, **without) if f"{e.name}.inertia" in moved else e for e in chain.elements
    ]
    return replace(
        chain, elements=elements, load=replace(chain.load, **{**without, "inertia": True})
    )


def other_presets(preset: str) -> list[str]:
    """Name the presets that could be meant instead, those without a gearbox first."""
    others = (name for name in PRESETS if name != preset)
    return sorted(others, key=lambda name: PRESETS[name].chain().ratio)


def _recordings(chain: Chain) -> Iterator[str]:
    linear = chain.motor_motion == "linear"
    side = ', side = "motor"' if chain.ratio != 1 else ""
    yield "[[recordings]]"
    yield 'file = "recording.csv"  # one table a file; a list or wildcards for several alike'
    yield 'time = { column = "time", unit = "s" }'
    yield f'position = {{ column = "position", unit = "{"m" if linear else "rad"}"{side} }}'
    yield f'torque = {{ column = "torque", unit = "{"N" if linear else "N m"}" }}  # or:'
    yield '# current = { column = "current", unit = "A", torque_constant = "0.32 N m/A" }'
    yield (
        '# voltage = { column = "u", unit = "V", torque_constant = "0.3 N m/A", '
        'resistance = "1 ohm" }'
    )
    yield '# added_mass = "2 kg"  # known, bolted to the load'
    yield '# radius = "0.35 m"'
    yield "# exclude = [[7.4, 9.0]]  # s in which a hand pushed"


def target_line(linear: bool) -> str:
    """Write a position target whose gains are to be filled in."""
    unit, gain = ("m", "8 N/m") if linear else ("rad", "8 N m/rad")
    return f'target = {{ column = "goal", unit = "{unit}", kp = "{gain}" }}'
