"""``bayesfric init --from``: a configuration for a log, with everything guessed marked."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from bayesfric.commands.init import configuration, may_slide, other_presets, target_line
from bayesfric.config_text import toml_value
from bayesfric.mechanism.presets import PRESETS
from bayesfric.recordings.recognition.log import Chosen, Log, recognise
from bayesfric.recordings.tables import read_table
from bayesfric.recordings.tables.reader import TableOptions
from bayesfric.recordings.units import GUESSED, alternatives, sliding

_DEFAULT = "motor-axis"
# Other columns that are named, on the terminal as in the file.
_MOST = 8
# What no log tells, as a configuration wants it.
_CONSTANTS = {
    "current": {"torque_constant": f"0.1 N m/A{GUESSED}"},
    "voltage": {"torque_constant": f"0.1 N m/A{GUESSED}", "resistance": f"1 ohm{GUESSED}"},
}
_CONSTANT_WHY = "the log does not hold it; a data sheet does"


def configuration_from(
    path: Path,
    preset: str | None,
    output: Path | None = None,
    *,
    table: str | None = None,
    joint: str | None = None,
) -> dict[str, Any]:
    """Write a configuration for a log: ``text``, ``guesses`` and what the log does not tell.

    A guess has what else it may be, ``or``; ``presets`` are those that could be meant where none
    was named. File names are relative to where ``output`` will be.

    Raises
    ------
    BadInput
        If the log cannot be read, or no column can be the position.
    """
    read = read_table(path, TableOptions.model_validate({"table": table}))
    log = recognise(read, joint)
    given = preset or _DEFAULT
    file = path if output is None else Path(os.path.relpath(path, output.parent))
    geared = given in PRESETS and PRESETS[given].chain().ratio != 1
    slides = given in PRESETS and may_slide(PRESETS[given].chain())
    unknown = list(log.unknown)
    if preset is None:
        unknown.insert(0, f"the mechanism: {given} is taken, as no PRESET was named")
    others = other_presets(given) if preset is None else []
    if geared:
        unknown.append("whether position and velocity are those of the motor or of the joint")
    return {
        "text": configuration(given, list(_recording(file, table, log, geared, slides))),
        "preset": given,
        "presets": [{"preset": name, "when": PRESETS[name].when} for name in others],
        "guesses": list(_guesses(log, slides)),
        "unknown": unknown,
        "joint": log.joint,
        "joints": list(log.joints),
    }


def guesses_text(found: dict[str, Any]) -> Iterator[str]:
    """List for a person what to look at before anything else is done."""
    if len(found["joints"]) > 1:
        others = ", ".join(one for one in found["joints"] if one != found["joint"])
        yield f"Joint {found['joint']}; with --joint one of: {others}"
    if found["guesses"]:
        yield f"Guessed; look at each, and remove every '{GUESSED}':"
    for one in found["guesses"]:
        instead = _others(one["or"])
        if "if_it_slides" in one:
            instead += f'; {_or(one["if_it_slides"])} if it slides (motion = "linear")'
        yield f"  {one['key']} = {toml_value(one['value'])}: {one['why']}{instead}"
    for text in found["unknown"]:
        yield f"  not known: {text}"
    for one in found["presets"]:
        yield f"  preset = {toml_value(one['preset'])} is for {one['when']}"


def _guesses(log: Log, slides: bool) -> Iterator[dict[str, Any]]:
    for one in log.chosen:
        if one.unit.endswith(GUESSED):
            plain = one.unit.removesuffix(GUESSED)
            told: dict[str, Any] = {"key": f"{one.channel}.unit", "value": one.unit}
            told |= {"why": one.why, "or": list(alternatives(plain))}
            if slides and (others := sliding(plain)):
                told["if_it_slides"] = list(others)
            yield told
        if one.others:
            columns = list(one.others[:_MOST])
            told = {"key": f"{one.channel}.column", "value": one.column, "why": one.why}
            yield told | {"or": columns}
        for key, value in _CONSTANTS.get(one.channel, {}).items():
            yield {"key": f"{one.channel}.{key}", "value": value, "why": _CONSTANT_WHY, "or": []}
    if log.rate:
        yield {"key": "rate", "value": log.rate, "why": "no column tells time", "or": []}


def _recording(
    file: Path, table: str | None, log: Log, geared: bool, slides: bool
) -> Iterator[str]:
    yield f"# What ends with '{GUESSED}' was guessed: look at it, and remove the '{GUESSED}'."
    yield "[[recordings]]"
    yield f"file = {toml_value(file)}"
    if table is not None:
        yield f"table = {toml_value(table)}"
    if log.where:
        name, value = next(iter(log.where.items()))
        yield f"where = {{ {toml_value(name)} = {value:.10g} }}  # the first; others begin anew"
    if len(log.joints) > 1:
        others = ", ".join(one for one in log.joints if one != log.joint)
        yield f"# joint {log.joint}; others: {others}"
    if log.rate:
        yield f"rate = {toml_value(log.rate)}  # no column tells time"
    for one in log.chosen:
        yield from _channel(one, geared, slides)
    if not any(log.of(key) for key in ("torque", "current", "voltage")):
        yield "# no column can be torque, current or voltage: name it"
        yield f'torque = {{ column = "{GUESSED}", unit = "N m{GUESSED}" }}'
        yield "# or, in its place, the position that the drive went for and its controller's gains:"
        yield f"# {target_line(linear=False)}"
    if log.valid:
        yield f"# valid = {toml_value(log.valid)}  # is it 0 where the motor is off?"


def _channel(one: Chosen, geared: bool, slides: bool) -> Iterator[str]:
    keys: dict[str, Any] = {"column": one.column, "unit": one.unit}
    if one.sign != 1:
        keys["sign"] = one.sign
    if one.twos_complement is not None:
        keys["twos_complement"] = one.twos_complement
    if geared and one.channel in ("position", "velocity"):
        keys["side"] = "motor"
    keys |= _CONSTANTS.get(one.channel, {})
    inside = ", ".join(f"{key} = {toml_value(value)}" for key, value in keys.items())
    yield f"# {one.channel}: {one.why}{_others(one.others)}"
    yield f"{one.channel} = {{ {inside} }}"
    plain = one.unit.removesuffix(GUESSED)
    if slides and one.unit != plain and (others := sliding(plain)):
        yield f'# if it slides, with motion = "linear" in [mechanism]: unit = {_or(others)}'
    if one.channel == "torque" and one.unit != plain:
        yield '# if it is a signal in V: unit = "V", constant = "... N m/V", or N/V if it slides;'
        yield (
            f"# a voltage, or a duty cycle times the supply (its back-EMF is taken off): voltage = "
            f'{{ column = {toml_value(one.column)}, unit = "V", torque_constant = "... N m/A", '
            'resistance = "... ohm" }, or unit = "1/885", times = "...", times_unit = "V"'
        )
        yield (
            f'# a current: current = {{ column = {toml_value(one.column)}, unit = "A", '
            'torque_constant = "... N m/A" }'
        )


def _or(units: Sequence[str]) -> str:
    return " or ".join(map(toml_value, units))


def _others(instead: Sequence[str | int]) -> str:
    shown = ", ".join(toml_value(one) for one in instead[:_MOST])
    return f"; or {shown}" if shown else ""
