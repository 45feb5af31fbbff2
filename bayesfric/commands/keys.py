"""``bayesfric init --all-keys``: every key of a configuration, out of its schema."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from bayesfric.base.errors import BadInput
from bayesfric.commands.init import FLEET
from bayesfric.estimates.estimation import Reference
from bayesfric.fleet.plan import FleetTables
from bayesfric.mechanism.presets import PRESETS
from bayesfric.problem.config import Tables
from bayesfric.recordings.units import UNIT_KEYWORD

Models = Mapping[str, Mapping[str, Any]]  # of a schema, by name

_WORDS = {
    "number": "number",
    "integer": "whole number",
    "string": "text",
    "boolean": "true or false",
    "object": "table",
}
_BOUNDS = {
    "exclusiveMinimum": "more than",
    "minimum": "at least",
    "exclusiveMaximum": "less than",
    "maximum": "at most",
}
_TITLES: dict[Kind, str] = {
    "configuration": "a configuration",
    "fleet": "FLEET.toml, the plan of a fleet",
}


@dataclass(frozen=True)
class Key:
    """One key: what may be written, and what it means."""

    name: str
    type: str
    default: str  # as TOML; "required", or empty where what is left out is found or not there
    unit: str
    meaning: str


@dataclass(frozen=True)
class KeyTable:
    """The keys of a table; several places where they are the same."""

    places: tuple[str, ...]  # as their headings in the file
    keys: tuple[Key, ...]


def key_tables(kind: Kind) -> list[KeyTable]:
    """List every key that a kind of file may hold, table by table.

    Parameters
    ----------
    kind
        ``configuration``, or ``fleet`` for ``FLEET.toml``.

    Returns
    -------
    list of KeyTable
        The whole file first; a table that may stand at several places is there once.
    """
    schema = schema_of(kind)
    models = schema["$defs"]
    places: dict[str, list[str]] = {}
    waiting = [("", schema)]
    while waiting:
        place, found = waiting.pop(0)
        for name, field in found["properties"].items():
            for model, ending, several in _tables_in(field, models):
                path = f"{place}.{name}{ending}".lstrip(".")
                if model not in places:
                    waiting.append((path, models[model]))
                heading = f"[[{path}]]" if several else f"[{path}]"
                places.setdefault(model, []).append(heading)
    top = KeyTable(("the file",), tuple(_keys(schema, models)))
    rest = (KeyTable(tuple(at), tuple(_keys(models[n], models))) for n, at in places.items())
    return [top, *rest]


def keys_text(kind: Kind) -> str:
    """Write every key of a kind of file as Markdown."""
    command = "init fleet --all-keys" if kind == "fleet" else "init --all-keys"
    lines = [
        f"# Every key of {_TITLES[kind]}",
        "",
        f"Out of the models that check it, by `bayesfric {command}`. Where no default stands, what "
        "is left out is chosen, or is not there. Numbers are in the unit of their row; where text "
        "may stand for a number, it brings its own, as in `'1 kHz'`.",
    ]
    for table in key_tables(kind):
        heading = ", ".join(f"`{place}`" if place[0] == "[" else place for place in table.places)
        lines += ["", f"## {heading}", "", "| key | type | default | unit | meaning |"]
        lines += ["|---|---|---|---|---|"]
        for key in table.keys:
            default = key.default if key.default in ("", "required") else f"`{key.default}`"
            cells = (f"`{key.name}`", key.type, default, key.unit, key.meaning)
            lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join([*lines, ""])


def reference_text(asked: str | None, *, schema: bool, option: str) -> str:
    """Write what ``init`` was asked for: keys, or the schema, of a configuration or a fleet.

    Raises
    ------
    BadInput
        Where a preset was named: keys are the same for all.
    """
    if asked not in (None, FLEET):
        mend = f"leave it out, or say {FLEET} for the keys of {_TITLES['fleet']}"
        raise BadInput(str(asked), f"{option} is the same for every preset", mend)
    kind: Kind = "fleet" if asked == FLEET else "configuration"
    if not schema:
        return keys_text(kind)
    return json.dumps(schema_of(kind), indent=1, ensure_ascii=False) + "\n"


def _tables_in(field: Mapping[str, Any], models: Models) -> Iterator[tuple[str, str, bool]]:
    """Name the tables a key may hold: model, what follows the key in its path, whether several."""
    if "$ref" in field:
        name = _name(field)
        if "properties" in models[name]:
            yield name, "", False
        else:
            yield from _tables_in(models[name], models)
    for one in field.get("anyOf", ()):
        yield from _tables_in(one, models)
    if field.get("type") == "array":
        yield from ((model, end, True) for model, end, _ in _tables_in(field["items"], models))
    if isinstance(more := field.get("additionalProperties"), dict):
        yield from ((model, f".NAME{end}", s) for model, end, s in _tables_in(more, models))


def _name(field: Mapping[str, Any]) -> str:
    return str(field["$ref"]).rpartition("/")[2]


def _keys(model: Mapping[str, Any], models: Models) -> Iterator[Key]:
    required = model.get("required", ())
    for name, field in model["properties"].items():
        default = "required" if name in required else ""
        if "default" in field:
            default = json.dumps(field["default"], ensure_ascii=False)
        meaning = field.get("description", "").removesuffix(":")
        yield Key(name, _type(field, models), default, _unit(field), meaning)


def _unit(field: Mapping[str, Any]) -> str:
    """Look up the unit of a key's numbers, in a list too."""
    if UNIT_KEYWORD in field:
        return str(field[UNIT_KEYWORD])
    return _unit(field["items"]) if "items" in field else ""


def _type(field: Mapping[str, Any], models: Models) -> str:
    """Say in words what may be written."""
    if "$ref" in field:
        found = models[_name(field)]
        return "table" if "properties" in found else _type(found, models)
    if "anyOf" in field:
        return " or ".join(dict.fromkeys(_type(one, models) for one in field["anyOf"]))
    if "enum" in field or "const" in field:
        choices = field.get("enum") or [field["const"]]
        return " or ".join(f"`{json.dumps(one)}`" for one in choices)
    if field["type"] == "array":
        least, most = field.get("minItems"), field.get("maxItems")
        number = f"{least}: " if least else f"at most {most}: " if most else ""
        return f"list of {number}{_type(field['items'], models)}"
    word = _WORDS[field["type"]]
    if isinstance(more := field.get("additionalProperties"), dict):
        return f"{word} of {_type(more, models)}"
    bounds = [f"{text} {field[key]:.10g}" for key, text in _BOUNDS.items() if key in field]
    return " ".join([word, " and ".join(bounds)]).strip()


Kind = Literal["configuration", "fleet"]
_KINDS: dict[Kind, tuple[type[BaseModel], str]] = {
    "configuration": (Tables, "A configuration of bayesfric."),
    "fleet": (FleetTables, "A fleet of bayesfric: one template, and the units it is filled for."),
}


class _Toml(GenerateJsonSchema):
    """What TOML can hold: no null, and keys that are left out; draft 7, which editors know."""

    schema_dialect = "http://json-schema.org/draft-07/schema#"

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        made = super().default_schema(schema)
        if made.get("default") is None or isinstance(made["default"], dict):
            made.pop("default", None)  # a table that is left out has the defaults of its keys
        return made

    def tuple_schema(self, schema: core_schema.TupleSchema) -> JsonSchemaValue:
        made = super().tuple_schema(schema)
        if first := made.pop("prefixItems", None):  # draft 7 has none; here all items are alike
            made["items"] = first[0]
        return made

    def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ARG002  (pydantic's)
        return False


def schema_of(kind: Kind) -> dict[str, Any]:
    """Make the JSON schema (draft 7) of a kind of file.

    It holds for what the file says; what only the mechanism or the recordings can tell, such as the
    names of parameters, ``bayesfric check`` does.

    Parameters
    ----------
    kind
        ``configuration``, or ``fleet`` for ``FLEET.toml``.

    Returns
    -------
    dict
        With ``x-unit`` beside the meaning of numbers that have a unit.
    """
    model, meaning = _KINDS[kind]
    made = model.model_json_schema(schema_generator=_Toml)
    if kind == "configuration":
        _describe_names(made)
    return {"$schema": _Toml.schema_dialect, **made, "title": meaning}


def _describe_names(made: dict[str, Any]) -> None:
    """Say what stands behind the names of parameters, and which names editors can complete."""
    number = {"type": "number"}
    pair = {"type": "array", "items": number, "minItems": 2, "maxItems": 2}
    named = {"type": "string", "description": "Name in scipy.stats; its arguments are keys, too."}
    of_reference = Reference.model_json_schema(schema_generator=_Toml)["properties"]
    for key, plain, inside in (
        ("priors", [number, pair], {"distribution": named}),
        ("references", [number], of_reference),
    ):
        one, table = {"$ref": f"#/$defs/{key}"}, {"$ref": f"#/$defs/{key}_table"}
        # a dotted name is a table in a table, so that either may hold itself
        inner = {"type": "object", "properties": inside, "additionalProperties": one}
        made["$defs"] |= {key: {"anyOf": [*plain, table]}, f"{key}_table": inner}
        known = {name: {**one, "description": text} for name, text in _parameters().items()}
        made["properties"][key] |= {"properties": known, "additionalProperties": one}


def _parameters() -> dict[str, str]:
    """Meanings of the parameters that presets have, by name."""
    chains = [preset.chain() for preset in PRESETS.values()]
    return {
        p.name: f"{p.meaning}, {p.unit}" if p.unit else p.meaning
        for chain in chains
        for p in chain.parameters
    }
