"""``bayesfric init --from``: a configuration for a log; what it does not tell is left open."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bayesfric.commands.init import configuration, may_slide, other_presets, target_line
from bayesfric.mechanism.presets import PRESETS
from bayesfric.problem.config_text import toml_value
from bayesfric.recordings.recognition import Chosen, Log, recognise
from bayesfric.recordings.tables import read_table
from bayesfric.recordings.tables.reader import TableOptions
from bayesfric.recordings.units import OPEN

_DEFAULT = "motor-axis"
# Columns that are listed.
_MOST = 40
# What may stand for an open value.
_UNITS = {
    "time": "s, ms or us",
    "position": "rad, deg, turn, or of counts such as turn/4096",
    "velocity": "rad/s, deg/s, rpm",
    "torque": 'N m; of a signal in V "V", constant = "... N m/V"',
    "current": "A or mA",
    "voltage": 'V; of a duty cycle "1/885", times = "supply", times_unit = "V"',
}
_SLIDING = {"position": "m or mm", "velocity": "m/s", "torque": "N, or N/V"}
_RATE = f"{OPEN} kHz"
# What no log tells, as a configuration wants it.
_CONSTANTS = {
    "current": {"torque_constant": f"{OPEN} N m/A"},
    "voltage": {"torque_constant": f"{OPEN} N m/A", "resistance": f"{OPEN} ohm"},
}


def configuration_from(
    path: Path,
    preset: str | None,
    output: Path | None = None,
    *,
    table: str | None = None,
    joint: str | None = None,
) -> dict[str, Any]:
    """Write a configuration for a log: ``text``, the keys left ``open``, and what is ``unknown``.

    ``presets`` are those that could be meant where none was named. File names are relative to where
    ``output`` will be.

    Raises
    ------
    BadInput
        If the log cannot be read, or there is no such joint.
    """
    log = recognise(read_table(path, TableOptions.model_validate({"table": table})), joint)
    given = preset or _DEFAULT
    file = path if output is None else Path(os.path.relpath(path, output.parent))
    chain = PRESETS[given].chain() if given in PRESETS else None
    geared = chain is not None and chain.ratio != 1
    channels = _channels(log, geared)
    left_open = {
        f"{channel}.{key}": value
        for channel, keys in channels.items()
        for key, value in keys.items()
        if OPEN in value
    }
    if "time" not in channels:
        left_open["rate"] = _RATE
    unknown = []
    if preset is None:
        unknown.append(f"the mechanism: {given} is taken, as no PRESET was named")
    if geared:
        unknown.append("whether position and velocity are those of the motor or of the joint")
    slides = chain is not None and may_slide(chain)
    others = other_presets(given) if preset is None else []
    return {
        "text": configuration(given, list(_recording(file, table, log, channels, slides))),
        "preset": given,
        "presets": [{"preset": name, "when": PRESETS[name].when} for name in others],
        "open": left_open,
        "unknown": unknown,
        "joint": log.joint,
        "joints": list(log.joints),
    }


def open_text(found: dict[str, Any]) -> Iterator[str]:
    """List for a person what to write before anything else is done."""
    if len(found["joints"]) > 1:
        others = ", ".join(one for one in found["joints"] if one != found["joint"])
        yield f"Joint {found['joint']}; with --joint one of: {others}"
    if found["open"]:
        yield f"The log does not tell; write it where '{OPEN}' stands:"
    for key, value in found["open"].items():
        yield f"  {key} = {toml_value(value)}"
    for text in found["unknown"]:
        yield f"  not known: {text}"
    for one in found["presets"]:
        yield f"  preset = {toml_value(one['preset'])} is for {one['when']}"


def _channels(log: Log, geared: bool) -> dict[str, dict[str, str]]:
    """Give the keys of every channel; of position and torque also where no column has the name."""
    drive = next((key for key in ("current", "voltage") if key in log.chosen), "torque")
    found = {}
    for channel in ("time", "position", "velocity", drive, "temperature"):
        one = log.chosen.get(channel) or Chosen(channel, OPEN, "")
        if one.column != OPEN or channel in ("position", drive):
            side = {"side": "motor"} if geared and channel in ("position", "velocity") else {}
            keys = {"column": one.column, "unit": one.unit or OPEN}
            found[channel] = keys | side | _CONSTANTS.get(channel, {})
    return found


def _recording(
    file: Path, table: str | None, log: Log, channels: dict[str, dict[str, str]], slides: bool
) -> Iterator[str]:
    yield f"# What the log does not tell is '{OPEN}': write what is right."
    yield "[[recordings]]"
    yield f"file = {toml_value(file)}"
    if table is not None:
        yield f"table = {toml_value(table)}"
    for name, value in log.where.items():
        yield f"where = {{ {toml_value(name)} = {value:.10g} }}  # the first; others begin anew"
    if len(log.joints) > 1:
        others = ", ".join(one for one in log.joints if one != log.joint)
        yield f"# joint {log.joint}; others: {others}"
    if any(keys["column"] == OPEN for keys in channels.values()):
        more = " ..." if len(log.columns) > _MOST else ""
        yield f"# columns: {', '.join(map(toml_value, log.columns[:_MOST]))}{more}"
    if "time" not in channels:
        yield f"rate = {toml_value(_RATE)}  # no column is named as time"
    for channel, keys in channels.items():
        if channel in log.chosen and (instead := log.chosen[channel].others[:_MOST]):
            yield f"# or column = {' or '.join(map(toml_value, instead))}"
        if keys["unit"] == OPEN:
            linear = slides and channel in _SLIDING
            more = f'; with motion = "linear" {_SLIDING[channel]}' if linear else ""
            yield f"# unit: {_UNITS[channel]}{more}"
        inside = ", ".join(f"{key} = {toml_value(value)}" for key, value in keys.items())
        yield f"{channel} = {{ {inside} }}"
    if "torque" in channels and "torque" not in log.chosen:
        yield '# or current = { ..., torque_constant = "... N m/A" }, or voltage with resistance;'
        yield "# or the position that the drive went for and its controller's gains:"
        yield f"# {target_line(linear=False)}"
    if log.valid:
        yield f"# valid = {toml_value(log.valid)}  # is it 0 where the motor is off?"
