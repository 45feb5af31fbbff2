"""``bayesfric init``: a commented configuration to start from."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, get_args

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from bayesfric.config import Tables
from bayesfric.errors import BadInput, nearest
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.presets import PRESETS
from bayesfric.mechanism.quantities import CHOICES, CYCLES, OPTION_MEANINGS


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
    values = {"load.inertia" if n in moved else n: x for n, x in chosen.values.items()}
    name = "load.first_moment" if "load.first_moment" in chain.names else chain.names[0]
    tables = list(Tables.model_fields)
    first = tables.index("references") + 1
    return "\n".join(
        [
            f"# bayesfric configuration: {chosen.meaning}.",
            "# Lines that begin with '#' are defaults or examples; remove the '#' to change them.",
            "# Every key, with its meaning: bayesfric init --all-keys. So that editors with Taplo",
            "# complete them: bayesfric init --schema -o keys.json, and as first line of this file",
            "# '#:schema ./keys.json'.",
            "",
            *_mechanism(preset, chain, moved),
            "",
            *(_recordings(chain) if recordings is None else recordings),
            *_choices(),
            *options("processing"),
            "",
            *_priors(chain),
            "",
            "# Values to compare results with, from a data sheet or CAD; they enter no fit.",
            "[references]",
            f'# "{name}" = {{ value = 0.41, source = "CAD" }}',
            *(line for key in tables[first:] for line in options(key)),
            f"# Parameters are those of {chosen.source}, unless given here:",
            "[simulation.parameters]",
            *(f'# "{name}" = {value:.6g}' for name, value in values.items()),
            "",
        ]
    )


def _mechanism(preset: str, chain: Joint, moved: Collection[str]) -> Iterator[str]:
    yield "[mechanism]"
    yield f'preset = "{preset}"  # for {PRESETS[preset].when}'
    yield 'terms = "auto"  # puts in what else explains the torque; or "as written"'
    for other in other_presets(preset):
        yield f'# preset = "{other}"  # for {PRESETS[other].when}'
    yield (
        f"# offset = {str(chain.offset).lower()}  # unknown constant in the motor torque; "
        'or "per-recording"'
    )
    yield f"# gain = {str(chain.gain).lower()}  # unknown factor of the torque constant"
    yield (
        f"# delay = {str(chain.delay).lower()}  # unknown time by which the recorded position "
        "comes after the torque"
    )
    if may_slide(chain):
        yield '# motion = "linear"  # if it slides: position in m or mm, force in N'
    for element in chain.elements:
        active = f"{element.name}.inertia" in moved
        # not behind a '#': a key below that loses its own would be another table's
        yield f"[mechanism.elements.{element.name}]"
        yield f"# ratio = {element.ratio:g}  # input speed over output speed"
        for option, choices in CHOICES.items():
            plain = False if True in choices else "none"
            known = ", ".join(_toml(choice) for choice in (plain, *choices))
            chosen = _toml(element.choices.get(option, plain))
            mark = "" if active and option == "inertia" else "# "
            yield f"{mark}{option} = {chosen}  # {OPTION_MEANINGS[option]}: {known}"
        for option in CYCLES:
            yield f"# {option} = []  # {OPTION_MEANINGS[option]}, such as [1, 7, 42]"
    if moved:
        yield "[mechanism.load]"
        yield "inertia = true  # the load loss sees it here; the motor's own is seldom told apart"


def may_slide(chain: Joint) -> bool:
    """Whether it may be an axis that slides as well: it has no gear, and gravity does not act."""
    return chain.ratio == 1.0 and "first_moment" not in chain.load.choices


def _with_load_behind(chain: Joint, moved: Collection[str]) -> Joint:
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


def _recordings(chain: Joint) -> Iterator[str]:
    linear = chain.motor_motion == "linear"
    yield "# One table for each file; 'file' may be a list or hold wildcards."
    yield "[[recordings]]"
    yield 'file = "recording.csv"'
    yield 'time = { column = "time", unit = "s" }'
    side = ', side = "motor"' if chain.ratio != 1 else ""
    yield f'position = {{ column = "position", unit = "{"m" if linear else "rad"}"{side} }}'
    yield f'torque = {{ column = "torque", unit = "{"N" if linear else "N m"}" }}'
    signal = "35 N/V" if linear else "0.5 N m/V"
    yield "# or a signal in proportion to it, such as the command of a drive:"
    yield f'# torque = {{ column = "command", unit = "V", constant = "{signal}" }}'
    yield "# or the current times a known constant:"
    yield '# current = { column = "current", unit = "A", torque_constant = "0.32 N m/A" }'
    yield "# or the voltage, with the back-EMF taken off:"
    yield (
        '# voltage = { column = "voltage", unit = "V", torque_constant = "0.32 N m/A", '
        'resistance = "1.2 ohm" }'
    )
    if not linear:
        yield "# or a duty cycle times the supply, as of a servo that counts its PWM to 885:"
        yield (
            '# voltage = { column = "pwm", unit = "1/885", times = "supply", times_unit = "V", '
            'torque_constant = "0.36 N m/A", resistance = "3.8 ohm" }'
        )
    yield "# or, where only the position that the drive went for was recorded, its gains:"
    yield f"# {target_line(linear)}"
    yield "# from outside on the load, as a dynamometer measures it:"
    yield f'# load_torque = {{ column = "load", unit = "{"N" if linear else "N m"}" }}'
    yield "# for losses that depend on it:"
    yield '# temperature = { column = "temperature", unit = "degC" }'
    yield '# added_mass = "2 kg"  # known mass bolted to the load'
    yield '# radius = "0.35 m"'


def target_line(linear: bool) -> str:
    """Write a position target whose gains are to be filled in."""
    unit, gain = ("m", "8 N/m") if linear else ("rad", "8 N m/rad")
    return f'target = {{ column = "goal", unit = "{unit}", kp = "{gain}" }}'


def _choices() -> Iterator[str]:
    """Write which samples of a file are used, the same for every recording."""
    yield "# of these only some samples, times in s from the first stamp:"
    yield '# start = "2 s"  # leave out what lies before'
    yield "# stop = 30.0  # ... and after"
    yield "# exclude = [[7.4, 9.0]]  # not compared with the model, as where a hand pushed"
    yield '# valid = "enabled"  # a column that is 0 where the motor did not give this torque'
    yield "# where = { episode_index = 3 }  # only rows in which columns equal values"
    yield '# name = "first run"  # what results call it; the file\'s stem if left out'


def _priors(chain: Joint) -> Iterator[str]:
    yield "# A number fixes, a range is uniform, a distribution is SciPy's by name."
    yield "# What is left out gets a wide default, which 'bayesfric check' prints."
    yield "[priors]"
    yield '# "motor.inertia" = 3.3e-4'
    yield '# "motor.inertia" = [1e-4, 1e-3]'
    yield '# "motor.inertia" = { distribution = "norm", loc = 3.3e-4, scale = 2e-5 }'
    for p in chain.parameters:
        yield f"# {p.name:<26} {p.unit or '-':<8} {p.meaning}"


def options(
    table: str, of: type[BaseModel] = Tables, given: Mapping[str, Any] | None = None
) -> Iterator[str]:
    """Write a table of options, with their meanings, and defaults or examples but for the given."""
    field = of.model_fields[table]
    given = given or {}
    yield ""
    if field.description:
        yield f"# {field.description}"
    yield f"[{table}]"
    kinds = (field.annotation, *get_args(field.annotation))  # [simulation] may be left out
    model = next(k for k in kinds if isinstance(k, type) and issubclass(k, BaseModel))
    for key, option in model.model_fields.items():
        if key == "parameters":
            continue
        text = f"{key}: {option.description}"
        yield from textwrap.wrap(text, 92, initial_indent="# ", subsequent_indent="#   ")
        example = option.examples[0] if option.examples else option.default
        yield f"{key} = {_toml(given[key])}" if key in given else f"# {key} = {_toml(example)}"


def _toml(value: Any) -> str:
    if value is None or value is PydanticUndefined:
        return '"..."  # found by itself when left out'
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(k)} = {_toml(v)}" for k, v in value.items()) + " }"
    return f"{value:g}" if isinstance(value, float) else json.dumps(value)
