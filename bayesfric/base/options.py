"""Tables of a configuration, and messages about errors in them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from bayesfric.base.errors import BadInput, Unfit, nearest


class Options(BaseModel):
    """Options that refuse keys they do not know."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def settings(self) -> dict[str, Any]:
        """Keys that the configuration sets; a preset's values count for the others."""
        return self.model_dump(exclude_unset=True)


def configuration_error(
    prefix: str, name: str, error: ValidationError, document: Any, model: Any
) -> BadInput:
    """Word the first error in a configuration or another document, or a part of one.

    ``prefix`` goes before the key at fault, ``name`` is that of the document; ``model`` is what it
    was checked against, for the keys it could have held.
    """
    errors = [(_place(e["loc"], document), e) for e in error.errors(include_url=False)]
    # a misspelt key often causes further complaints: name it first.
    place, first = min(errors, key=lambda pair: pair[1]["type"] != "extra_forbidden")
    # of a union of types, the one that got furthest says most
    deeper = [pair for pair in errors if pair[0][: len(place)] == place]
    if first["type"] not in ("extra_forbidden", "missing"):
        place, first = max(deeper, key=lambda pair: len(pair[0]))
    words = [str(part + 1) if isinstance(part, int) else part for part in place]
    if first["type"] == "missing" and isinstance(key := first["loc"][-1], str):
        where = prefix + ".".join([*words, key])
        return BadInput(where, "is missing", f"add {key!r} ('bayesfric init' shows how)")
    where = prefix + (".".join(words) or name)
    if first["type"] == "extra_forbidden":
        return BadInput(where, "unknown key", nearest(words[-1], _known_keys(place, model)))
    problem, hint = _worded(first, [e["msg"] for p, e in deeper if p == place])
    return BadInput(where, problem, hint)


def _place(location: Sequence[int | str], document: Any) -> list[int | str]:
    """Keys of the document; pydantic adds the types it tried."""
    place: list[int | str] = []
    for part in location:
        try:
            document = document[part]
        except (KeyError, IndexError, TypeError):
            continue
        place.append(part)
    return place


def _worded(first: Any, messages: Sequence[str]) -> tuple[str, str]:
    """Say what is wrong with a value, and what to give instead, by pydantic's messages."""
    got = f"got {_shown(first['input'])}"
    if first["type"] == "value_error":
        error = first["ctx"]["error"]
        fits = isinstance(error, Unfit)
        return (error.problem, f"give {error.wanted}") if fits else (str(error), "correct it")
    if first["type"] == "literal_error" and isinstance(first["input"], str):
        choices = re.findall(r"'(\w[^']*)'", first["ctx"]["expected"])
        if choices and "True" not in first["ctx"]["expected"]:
            return got, nearest(first["input"], choices)
    wanted = [message.removeprefix("Input should be ") for message in messages]
    hint = f"it should be {' or '.join(dict.fromkeys(wanted))}"
    for pydantic, toml in (("True", "true"), ("False", "false"), ("an object", "a table")):
        hint = hint.replace(pydantic, toml)
    return got, "give more values" if first["type"] == "missing" else hint


def _shown(value: Any) -> str:
    """Write a value as a configuration would."""
    if isinstance(value, Mapping):
        return "a table"
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else f"{text[:60]}…"


def _known_keys(place: Sequence[int | str], model: Any) -> list[str]:
    """Keys allowed in the place of an unknown one."""
    for part in place[:-1]:
        if part not in getattr(model, "model_fields", {}):
            continue  # a number, or a name that the user chose, such as an element's
        model = _model_in(model.model_fields[part].annotation)
    return list(getattr(model, "model_fields", {}))


def _model_in(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    inner = map(_model_in, getattr(annotation, "__args__", ()))
    return next((model for model in inner if model is not None), None)
