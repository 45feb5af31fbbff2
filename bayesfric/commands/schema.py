"""The JSON schema of a configuration, for editors: what may be written, and what it means."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from bayesfric.estimates.estimation import Reference
from bayesfric.fleet.plan import FleetTables
from bayesfric.mechanism.presets import PRESETS
from bayesfric.problem.config import Tables

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
