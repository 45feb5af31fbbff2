"""``bayesfric init``: a commented configuration to start from, the table of keys, the schema."""

from __future__ import annotations

import json
import os
import textwrap
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin

import numpy as np
from jinja2 import Template
from pydantic import BaseModel, ValidationError
from pydantic_core import to_jsonable_python

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.options import configuration_error
from bayesfric.base.templates import environment
from bayesfric.fleet.plan import FleetTables
from bayesfric.mechanism.joint import PRESETS
from bayesfric.problem.config import Tables, toml_value
from bayesfric.recordings.readers import TableOptions, read_table
from bayesfric.recordings.recognition import Log, Named, named, recognise
from bayesfric.recordings.tables import Table
from bayesfric.recordings.units import OPEN
from bayesfric.report.terminal import aligned

# Name in place of a preset.
FLEET = "fleet"
# Hints for open values.
_UNITS = {
    "time": "s, ms or us",
    "position": "rad, deg, turn, or of counts such as turn/4096",
    "velocity": "rad/s, deg/s, rpm",
    "torque": 'N m; of a signal in V "V", constant = "... N m/V"; of thousandths of a rated '
    'torque of 1.27 N m "0.00127 N m"',
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
    layout: Mapping[str, Any] | None = None,
    joint: str | None = None,
    urdf: Path | None = None,
) -> dict[str, Any]:
    """Write what ``init`` is asked for: ``text``, and for a log its columns and what is left open.

    ``reference`` is ``--all-keys``, ``--schema`` or none of them; ``layout`` has keys of the table.
    """
    layout = layout or {}
    try:
        options = TableOptions.model_validate(layout)
    except ValidationError as error:
        raise configuration_error("--", "--from", error, layout, TableOptions) from None
    if (preset == "arm") != (urdf is not None) or (urdf and not log):
        raise BadInput("init arm", "wants a log and a URDF", "add --from LOG --urdf ROBOT.urdf")
    if log is not None and urdf is not None:
        return _arm_configuration(log, urdf, layout)
    if log is not None:
        return _log_configuration(log, preset, output, options, joint)
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
    path: Path, preset: str | None, output: Path | None, options: TableOptions, joint: str | None
) -> dict[str, Any]:
    """Write a configuration for a log: ``text``, ``columns``, ``open`` keys, what is ``unknown``.

    ``presets`` are alternatives if none was named. File names are relative to ``output``.
    """
    table = read_table(path, options)
    log = recognise(table, joint)
    columns = list(_columns(table.only(log.where), log))
    if len(columns) == 1:
        hint = "write time, position and torque into one table, a column each"
        raise BadInput(str(path), "has one column, which is no log of a joint", hint)
    layout = options.model_dump(exclude_defaults=True)
    layout |= {"decimal": table.decimal} if table.decimal != "." else {}
    chosen = preset or "motor-axis"
    file = path if output is None else Path(os.path.relpath(path, output.parent))
    geared = chosen in PRESETS and PRESETS[chosen].chain().ratio != 1
    channels = _channels(log, geared)
    text = configuration(chosen, log, file=str(file), layout=layout, channels=channels)
    open_keys = {
        f"{channel}.{key}": value
        for channel, keys in channels.items()
        for key, value in keys.items()
        if OPEN in str(value)
    }
    if "time" not in channels:
        open_keys["rate"] = f"{OPEN} kHz"
    taken = [column for key, (column, _) in log.chosen.items() if key != "time" and column != OPEN]
    unknown = [*log.problems, *table.doubts(taken)]
    if "position" not in channels:
        unknown.append("the position: no column is named so, and the velocity will be integrated")
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
        "columns": columns,
        "notes": list(table.notes),
    }


def _columns(table: Table, log: Log) -> Iterator[dict[str, Any]]:
    """Describe every column: unit, range, holes, what it is taken as, or else why it is not."""
    channels = {str(column): (channel, unit) for channel, (column, unit) in log.chosen.items()}
    stamped = {clock: name for name, clock in table.clocks.items()}
    for number, name in enumerate(table.names, start=1):
        written = table.units[number - 1] if table.units else ""
        try:
            cells = table.cells(name or number)
        except BadInput as error:
            yield {"column": name or number, "unit": written, "why": error.problem}
            continue
        parts: list[str | int] = [name or number]
        if cells.ndim == 2:
            parts = [f"{name}[{k}]" for k in range(cells.shape[1])]
            if any(other.startswith((f"{name}[", f"{name}.")) for other in table.names):
                continue  # its parts are columns themselves
        for key in parts:
            meaning = named(str(key), written)
            channel, unit = channels.get(str(key), ("", meaning.unit or written))
            row = {"column": key, "unit": unit, **_content(table, key)}
            if channel:
                yield row | {"taken": channel}
            elif "why" in row:
                yield row
            elif key in stamped:
                yield row | {"why": f"time stamps of {stamped[str(key)]}"}
            else:
                yield row | {"why": _why_not(row, meaning, log)}


def _content(table: Table, key: str | int) -> dict[str, Any]:
    """Describe the numbers of a column, or why they are none."""
    try:
        values, holes = table.values(key), table.holes(key)
    except BadInput as error:
        return {"why": error.problem}
    numbers = values[np.isfinite(values)]
    content: dict[str, Any] = {"rows": values.size, "holes": int(holes.sum())}
    if not numbers.size:
        return content | {"why": "is empty" if holes.all() else "holds no numbers"}
    moves = bool(np.ptp(numbers) > 0.0)
    content |= {"low": float(numbers.min()), "high": float(numbers.max()), "moves": moves}
    content["increases"] = bool(np.all(np.diff(numbers) > 0.0))
    other = values.size - numbers.size - content["holes"]
    return content | ({"why": f"{other} cells hold something else than numbers"} if other else {})


def _why_not(row: Mapping[str, Any], meaning: Named, log: Log) -> str:
    """Say why a column of numbers is not taken."""
    if not meaning.channel:
        if isinstance(row["column"], str):
            return "its name is not known"
        return "has no name" + ", increases as time does" * bool(row["increases"])
    if meaning.wanted:
        return "a command, not a measurement"
    if not row["moves"]:
        return "constant"
    if meaning.joint != log.joint and meaning.joint in log.joints:
        return f"of joint {meaning.joint}"
    drives = ("torque", *_CONSTANTS)
    rivals = drives if meaning.channel in drives else (meaning.channel,)
    columns = [log.chosen[key][0] for key in rivals if key in log.chosen]
    reason = "one of several" if OPEN in columns else "".join(f"{x} is taken" for x in columns[:1])
    return reason or ("does not increase" if meaning.channel == "time" else "not of this joint")


def columns_text(draft: dict[str, Any], limit: int = 40) -> list[str]:
    """List the columns of a log as a table, those that are taken first if there are many."""
    columns = draft.get("columns", [])
    if len(columns) > limit:
        columns = sorted(
            columns, key=lambda row: ("taken" not in row, "known" in row.get("why", ""))
        )
    rows = [("column", "from", "to", "unit", "holes", "taken as, or why not")]
    for row in columns[:limit]:
        name = str(row["column"])
        low, high = (f"{row[key]:.4g}" if key in row else "" for key in ("low", "high"))
        holes = f"{row['holes']} of {row['rows']}" if row.get("holes") else ""
        meaning = row.get("taken") or f"- {row['why']}"
        rows.append(
            (name if len(name) <= 48 else f"…{name[-47:]}", low, high, row["unit"], holes, meaning)
        )
    remainder = [f"… {len(columns) - limit} more: --json"] if len(columns) > limit else []
    return [*(aligned(rows) if columns else ()), *remainder, *draft.get("notes", ())]


def _arm_configuration(log: Path, urdf: Path, layout: Mapping[str, Any]) -> dict[str, Any]:
    """Write an ``arm.toml``: ``text`` and ``open`` keys."""
    from bayesfric.arm.arm import Arm
    from bayesfric.arm.arm_columns import recognised_layout

    joints = Arm(urdf).bodies.joints
    columns, notes = recognised_layout(log, joints, layout, in_order=True)
    blank = {key: {"column": OPEN, "unit": OPEN} for key in ("time", "position", "torque")}
    present = [name for name in joints if name in columns] or [*joints]
    documents = [columns.get(name, blank) for name in present]
    recording: dict[str, Any] = {**layout}
    for key, channel in documents[0].items():
        if all(key in document for document in documents):
            entries = {k: [document[key][k] for document in documents] for k in channel}
            recording[key] = {k: v[0] if v.count(v[0]) == len(v) else v for k, v in entries.items()}
    if recording.keys().isdisjoint(("torque", "current", "voltage", "target")):
        recording["torque"] = blank["torque"]
    open_keys = {f"recording.{key}": OPEN for key, x in recording.items() if OPEN in str(x)}
    held = [name for name in joints if name not in present]
    open_keys |= {f"joints.{name}.held": OPEN for name in held}
    variables = {"recording": recording, "held": held, "joints": list(joints)}
    text = _template("arm.toml.j2").render(urdf=urdf, log=log, **variables)
    return {"text": text, "open": open_keys, "notes": notes}


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


def _channels(log: Log, geared: bool) -> dict[str, dict[str, str | int]]:
    """Return the keys of every channel; torque always, and position if there is no velocity."""
    drive = next((key for key in ("current", "voltage") if key in log.chosen), "torque")
    channels = dict[str, dict[str, str | int]]()
    for channel in ("time", "position", "velocity", drive):
        column, unit = log.chosen.get(channel, (OPEN, ""))
        required = channel == drive or (channel == "position" and "velocity" not in log.chosen)
        if column != OPEN or required or (channel == "time" and channel in log.chosen):
            channels[channel] = {"column": column, "unit": unit or OPEN}
            if geared and channel in ("position", "velocity"):
                channels[channel]["side"] = "motor"
            channels[channel] |= dict([log.decoding[channel]]) if channel in log.decoding else {}
            channels[channel] |= _CONSTANTS.get(channel, {})
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
