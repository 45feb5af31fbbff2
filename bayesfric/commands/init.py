"""``bayesfric init``: a commented configuration to start from, the table of keys, the schema."""

from __future__ import annotations

import json
import os
import textwrap
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin

from jinja2 import Template
from pydantic import BaseModel
from pydantic_core import to_jsonable_python

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.templates import environment
from bayesfric.fleet.plan import FleetTables
from bayesfric.mechanism.joint import PRESETS
from bayesfric.problem.config import Tables, toml_value
from bayesfric.recordings.readers import TableOptions, read_table
from bayesfric.recordings.recognition import Log, recognise
from bayesfric.recordings.units import OPEN

# Name in place of a preset.
FLEET = "fleet"
# Hints for open values.
_UNITS = {
    "time": "s, ms or us",
    "position": "rad, deg, turn, or of counts such as turn/4096",
    "velocity": "rad/s, deg/s, rpm",
    "torque": 'N m; of a signal in V "V", constant = "... N m/V"',
    "current": "A or mA",
    "voltage": 'V; of a duty cycle "1/885", times = "supply", times_unit = "V"',
}
_SLIDING = {"position": "m or mm", "velocity": "m/s", "torque": "N, or N/V"}
# Values that no log contains.
_CONSTANTS = {
    "current": {"torque_constant": f"{OPEN} N m/A"},
    "voltage": {"torque_constant": f"{OPEN} N m/A", "resistance": f"{OPEN} ohm"},
}
_WORDS = {float: "number", int: "integer", str: "text", bool: "true or false", Any: "anything"}


def draft_configuration(
    preset: str | None,
    log: Path | None,
    output: Path | None,
    *,
    reference: str | None = None,
    table: str | None = None,
    joint: str | None = None,
    urdf: Path | None = None,
) -> dict[str, Any]:
    """Write what ``init`` is asked for: ``text``, and for a log what is left open.

    ``reference`` is ``--all-keys``, ``--schema`` or none of them.
    """
    if (preset == "arm") != (urdf is not None) or (urdf and not log):
        raise BadInput("init arm", "wants a log and a URDF", "add --from LOG --urdf ROBOT.urdf")
    if log is not None and urdf is not None:
        return _arm_configuration(log, urdf, table)
    if log is not None:
        return _log_configuration(log, preset, output, table, joint)
    if reference is None:
        if preset is None:
            raise BadInput("PRESET", "is missing", "name one, or a log with --from LOG")
        return {"text": configuration(preset)}
    if preset not in (None, FLEET):
        hint = f"leave it out, or say {FLEET} for the keys of FLEET.toml"
        raise BadInput(str(preset), f"{reference} is the same for every preset", hint)
    model: type[BaseModel] = FleetTables if preset == FLEET else Tables
    if reference == "--all-keys":
        return {"text": keys_text(model)}
    return {"text": json.dumps(model.model_json_schema(), indent=1, ensure_ascii=False) + "\n"}


def configuration(preset: str, log: Log | None = None, **variables: Any) -> str:
    """Write a commented configuration for a preset, with examples or a log's columns."""
    if preset == FLEET and log is None:
        return files("bayesfric.commands").joinpath("templates", "fleet.toml").read_text("utf-8")
    if preset not in PRESETS:
        raise BadInput(preset, "there is no such preset", nearest(preset, PRESETS))
    chain = PRESETS[preset].chain()
    # most of a recorded joint's inertia is behind the gearbox
    moved = () if log is None else {name.partition(".")[0] for name in chain.unseen_inertia}
    return _template("init.toml.j2").render(
        meaning=PRESETS[preset].meaning,
        preset=preset,
        others=_others(preset),
        chain=chain,
        moved=moved,
        # a plain axis may slide as well
        slides=chain.ratio == 1.0 and "first_moment" not in chain.load.choices,
        first=next(p for p in chain.parameters if p.name not in chain.unseen_inertia or not moved),
        log=log,
        units=_UNITS,
        sliding=_SLIDING,
        **variables,
    )


def _template(name: str) -> Template:
    templates = environment("bayesfric.commands")
    templates.filters["toml"] = toml_value
    return templates.get_template(name)


def _log_configuration(
    path: Path, preset: str | None, output: Path | None, table: str | None, joint: str | None
) -> dict[str, Any]:
    """Write a configuration for a log: ``text``, ``open`` keys, and what is ``unknown``.

    ``presets`` are alternatives if none was named. File names are relative to ``output``.
    """
    log = recognise(read_table(path, TableOptions.model_validate({"table": table})), joint)
    chosen = preset or "motor-axis"
    file = path if output is None else Path(os.path.relpath(path, output.parent))
    geared = chosen in PRESETS and PRESETS[chosen].chain().ratio != 1
    channels = _channels(log, geared)
    text = configuration(chosen, log, file=str(file), table=table, channels=channels)
    open_keys = {
        f"{channel}.{key}": value
        for channel, keys in channels.items()
        for key, value in keys.items()
        if OPEN in value
    }
    if "time" not in channels:
        open_keys["rate"] = f"{OPEN} kHz"
    unknown = list(log.problems)
    if preset is None:
        unknown.append(f"the mechanism: {chosen} is used, as no PRESET was named")
    if geared:
        unknown.append("whether position and velocity are those of the motor or of the joint")
    others = _others(chosen) if preset is None else []
    return {
        "text": text,
        "preset": chosen,
        "presets": [{"preset": name, "when": PRESETS[name].when} for name in others],
        "open": open_keys,
        "unknown": unknown,
        "joint": log.joint,
        "joints": list(log.joints),
    }


def _arm_configuration(log: Path, urdf: Path, table: str | None) -> dict[str, Any]:
    """Write an ``arm.toml``: ``text`` and ``open`` keys."""
    from bayesfric.arm.arm import Arm
    from bayesfric.arm.arm_log import layout_of

    joints = Arm(urdf).bodies.joints
    recording, labels = layout_of(log, joints, table, in_order=True)
    variables = {"recording": recording, "labels": labels, "joints": list(joints)}
    text = _template("arm.toml.j2").render(urdf=urdf, log=log, **variables)
    units = {f"{k}.unit": OPEN for k, v in recording.items() if OPEN in str(v)}
    held = {f"joints.{name}.held": OPEN for name in joints if name not in labels}
    return {"text": text, "open": units | held}


def open_text(draft: dict[str, Any]) -> Iterator[str]:
    """List the open keys."""
    if len(draft.get("joints", ())) > 1:
        others = ", ".join(joint for joint in draft["joints"] if joint != draft["joint"])
        yield f"Joint {draft['joint']}; with --joint one of: {others}"
    if draft.get("open"):
        yield f"Not in the log; replace '{OPEN}':"
        for key, value in draft["open"].items():
            yield f"  {key} = {toml_value(value)}"
    for text in draft.get("unknown", ()):
        yield f"  not known: {text}"
    for preset in draft.get("presets", ()):
        yield f"  preset = {toml_value(preset['preset'])} is for {preset['when']}"


def _others(preset: str) -> list[str]:
    """List the other presets, those without a gearbox first."""
    return sorted({*PRESETS} - {preset}, key=lambda name: (PRESETS[name].chain().ratio, name))


def _channels(log: Log, geared: bool) -> dict[str, dict[str, str]]:
    """Return the keys of every channel; position and torque always."""
    drive = next((key for key in ("current", "voltage") if key in log.chosen), "torque")
    channels = {}
    for channel in ("time", "position", "velocity", drive):
        column, unit = log.chosen.get(channel, (OPEN, ""))
        if column != OPEN or channel in ("position", drive):
            side = {"side": "motor"} if geared and channel in ("position", "velocity") else {}
            keys = {"column": column, "unit": unit or OPEN}
            channels[channel] = keys | side | _CONSTANTS.get(channel, {})
    return channels


def keys_text(model: type[BaseModel]) -> str:
    """Write every key of a file with its type, default and meaning, table by table."""
    places = {model: [""]}
    for table in (tables := [model]):
        path = "" if table is model else f"{places[table][0]}."
        for name, field in table.model_fields.items():
            for inner, place in _tables_in(field.annotation, path + name):
                if inner not in places:
                    tables.append(inner)
                places.setdefault(inner, []).append(place)
    lines = []
    for table in tables:
        lines += [f"[{place}]" for place in places[table] if place]
        for name, field in table.model_fields.items():
            default = "required" if field.is_required() else _default(field.default)
            lines.append(f"{name}: {_type(field.annotation)}{default and ', ' + default}")
            lines += textwrap.wrap(
                field.description or "", initial_indent="    ", subsequent_indent="    ", width=100
            )
        lines.append("")
    return "\n".join(lines)


def _default(value: Any) -> str:
    plain = isinstance(value, bool | int | float | str | tuple)
    return f"default {json.dumps(to_jsonable_python(value))}" if plain else ""


def _tables_in(annotation: Any, place: str) -> Iterator[tuple[type[BaseModel], str]]:
    """Find the tables that a key may hold, and the dotted path of each."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation, place
    inner = f"{place}.NAME" if get_origin(annotation) is dict else place
    for argument in get_args(annotation):
        yield from _tables_in(argument, inner)


def _type(annotation: Any) -> str:
    """Word what a key may hold."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return " or ".join(map(json.dumps, inner))
    if origin is Annotated:
        return _type(inner[0])
    if origin in (list, tuple):
        return f"list of {_type(inner[0])}"
    if origin is dict:
        return f"table of {_type(inner[1])}"
    if inner:
        return " or ".join(_type(choice) for choice in inner if choice is not NoneType)
    return _WORDS.get(annotation, "table")
