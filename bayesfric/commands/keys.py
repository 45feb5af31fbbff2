"""``bayesfric init --all-keys`` and ``--schema``: every key, out of the models that check it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
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

Field = Mapping[str, Any]  # of a schema
Models = Mapping[str, Field]  # of a schema, by name

_WORDS = {
    "number": "number",
    "integer": "integer",
    "string": "text",
    "boolean": "true/false",
    "object": "table",
}
_BOUNDS = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}


def reference_text(asked: str | None, *, schema: bool, option: str) -> str:
    """Write what ``init`` was asked for: keys, or the schema, of a configuration or a fleet.

    Raises
    ------
    BadInput
        Where a preset was named: keys are the same for all.
    """
    if asked not in (None, FLEET):
        mend = f"leave it out, or say {FLEET} for the keys of FLEET.toml"
        raise BadInput(str(asked), f"{option} is the same for every preset", mend)
    kind: Kind = "fleet" if asked == FLEET else "configuration"
    if not schema:
        return keys_text(kind)
    return json.dumps(schema_of(kind), indent=1, ensure_ascii=False) + "\n"


def keys_text(kind: Kind) -> str:
    """Write every key of a kind of file as Markdown, once where several tables have the same."""
    schema = schema_of(kind)
    models = schema["$defs"]
    rows: dict[tuple[str, ...], list[str]] = {}
    for places, model in _tables(schema, models):
        for name, field in model["properties"].items():
            told = (_type(field, models), _unit(field), _default(name, field, model))
            meaning = field.get("description", "").removesuffix(":")
            row = (f"`{name}`", ", ".join(filter(None, told)), meaning)
            rows[row] = rows.get(row, []) + places
    lines = [f"## {_KINDS[kind][2]}"]
    for at in dict.fromkeys(map(tuple, rows.values())):
        heading = ", ".join(f"`{place}`" if place[0] == "[" else place for place in at)
        keys = [row for row, places in rows.items() if tuple(places) == at]
        lines += ["", f"### {heading}", "", *table_text(("key", "type", "meaning"), keys)]
    return "\n".join([*lines, ""])


def table_text(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Write a table as Markdown, line by line."""
    cells = [[" ".join(cell.split()).replace("|", "\\|") for cell in row] for row in rows]
    lines = [f"|{'|'.join(row)}|" for row in [list(head), *cells]]
    return [lines[0], "|" + "---|" * len(head), *lines[1:]]


def _tables(schema: Field, models: Models) -> list[tuple[list[str], Field]]:
    """Find the tables of a file, the whole first, with the headings of all places of each."""
    places: dict[str, list[str]] = {}
    waiting = [("", schema)]
    while waiting:
        place, found = waiting.pop(0)
        for name, field in found["properties"].items():
            for model, ending, several in _tables_in(field, models):
                path = f"{place}.{name}{ending}".lstrip(".")
                if model not in places:
                    waiting.append((path, models[model]))
                places.setdefault(model, []).append(f"[[{path}]]" if several else f"[{path}]")
    return [(["the file"], schema), *((at, models[name]) for name, at in places.items())]


def _tables_in(field: Field, models: Models) -> Iterator[tuple[str, str, bool]]:
    """Name the tables a key may hold: model, what follows the key in its path, whether several."""
    if "$ref" in field:
        name, found = _referred(field, models)
        if "properties" in found:
            yield name, "", False
        else:
            yield from _tables_in(found, models)
    for one in field.get("anyOf", ()):
        yield from _tables_in(one, models)
    if field.get("type") == "array":
        yield from ((model, end, True) for model, end, _ in _tables_in(field["items"], models))
    if isinstance(more := field.get("additionalProperties"), dict):
        yield from ((model, f".NAME{end}", s) for model, end, s in _tables_in(more, models))


def _referred(field: Field, models: Models) -> tuple[str, Field]:
    name = field["$ref"].rpartition("/")[2]
    return name, models[name]


def _default(name: str, field: Field, model: Field) -> str:
    if name in model.get("required", ()):
        return "required"
    return f"= `{json.dumps(field['default'], ensure_ascii=False)}`" if "default" in field else ""


def _unit(field: Field) -> str:
    """Look up the unit of a key's numbers, in a list too."""
    if UNIT_KEYWORD in field:
        return str(field[UNIT_KEYWORD])
    return _unit(field["items"]) if "items" in field else ""


def _type(field: Field, models: Models) -> str:
    """Say in words what may be written."""
    if "$ref" in field:
        _, found = _referred(field, models)
        return "table" if "properties" in found else _type(found, models)
    if "anyOf" in field:
        return " or ".join(dict.fromkeys(_type(one, models) for one in field["anyOf"]))
    if "enum" in field or "const" in field:
        choices = field.get("enum") or [field["const"]]
        return "/".join(f"`{json.dumps(one)}`" for one in choices)
    if field["type"] == "array":
        least, most = field.get("minItems"), field.get("maxItems")
        number = f"{least}: " if least else f"≤{most}: " if most else ""
        return f"list of {number}{_type(field['items'], models)}"
    word = _WORDS[field["type"]]
    if isinstance(more := field.get("additionalProperties"), dict):
        return f"{word} of {_type(more, models)}"
    bounds = [f"{sign}{field[key]:.10g}" for key, sign in _BOUNDS.items() if key in field]
    return " ".join([word, ", ".join(bounds)]).strip()


Kind = Literal["configuration", "fleet"]
# Model, what its schema is called, and what the file is.
_KINDS: dict[Kind, tuple[type[BaseModel], str, str]] = {
    "configuration": (Tables, "A configuration of bayesfric.", "A configuration"),
    "fleet": (
        FleetTables,
        "A fleet of bayesfric: one template, and the units it is filled for.",
        "FLEET.toml",
    ),
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
    names of parameters, ``bayesfric check`` does. ``x-unit`` stands beside the meaning of numbers
    that have a unit.
    """
    model, meaning, _ = _KINDS[kind]
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
