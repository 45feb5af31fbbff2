"""Reading configurations and summaries, and what is wrong with them in words for a person."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from bayesfric.errors import BadInput, LeftOpen, Unfit, nearest

_LONGEST = 60

# What to give instead, by the beginning of pydantic's error type.
_KINDS = {
    "int_": "a whole number",
    "float_": "a number",
    "bool_": "true or false",
    "string_type": "text in quotes",
    "string_too_short": "text that is not empty",
    "list_": "a list in [brackets]",
    "tuple_": "a list in [brackets]",
    "dict_": "a table of keys",
    "model_": "a table of keys",
    "finite_number": "a finite number",
}
_BOUNDS = {
    "greater_than": ("more than", "gt"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("less than", "lt"),
    "less_than_equal": ("at most", "le"),
}


def read_text(path: Path, largest: int, kind: str, mend: str, mend_text: str) -> str:
    """Read a UTF-8 file of at most ``largest`` bytes; errors of the disk are the caller's.

    Promised to hostile input: a pipe and what never ends are refused; ``kind`` is what the file
    was taken for.
    """
    if path.is_fifo():
        # opening it would wait for ever if nobody writes
        raise BadInput(str(path), "is a named pipe, no file", mend)
    with path.open("rb") as file:
        raw = file.read(largest + 1)
    if len(raw) > largest:
        raise BadInput(str(path), f"is too large for a {kind}", mend)
    try:
        return raw.decode("utf-8-sig")  # Windows editors put a mark in front
    except UnicodeDecodeError as error:
        raise BadInput(str(path), f"is not UTF-8 (byte {error.start})", mend_text) from None


def configuration_error(
    prefix: str, whole: str, error: ValidationError, document: Any, model: Any
) -> BadInput:
    """Word the first thing wrong with a configuration or another document, or a part of one.

    ``prefix`` goes before the key complained about, ``whole`` names the part itself; ``model`` is
    what it was checked against, for the keys it could have held.
    """
    found = [(_place(e["loc"], document), e) for e in error.errors(include_url=False)]
    # A misspelt key often causes further complaints: name it first.
    place, first = min(found, key=lambda pair: pair[1]["type"] != "extra_forbidden")
    # Of the ways a value could have been meant, the one that got furthest tells most.
    deeper = [pair for pair in found if pair[0][: len(place)] == place]
    if first["type"] not in ("extra_forbidden", "missing"):
        place, first = max(deeper, key=lambda pair: len(pair[0]))
    words = [str(part + 1) if isinstance(part, int) else part for part in place]
    if first["type"] == "missing" and isinstance(key := first["loc"][-1], str):
        where = prefix + ".".join([*words, key])
        return BadInput(where, "is missing", f"add {key!r} ('bayesfric init' shows how)")
    where = prefix + (".".join(words) or whole)
    if first["type"] == "extra_forbidden":
        return BadInput(where, "unknown key", nearest(words[-1], _known_keys(place, model)))
    what, mend = _worded([e for p, e in deeper if p == place])
    if first["type"].startswith("model_") and (keys := _known_keys([*place, ""], model)):
        mend += f": {', '.join(keys)}"
    if _left_open(first) and (more := [p for p, e in found if _left_open(e) and p != place]):
        others = (".".join(str(x + 1) if isinstance(x, int) else x for x in p) for p in more)
        what += f", as {', '.join(dict.fromkeys(others))} are"
    return BadInput(where, what, mend)


def _left_open(error: Any) -> bool:
    return isinstance(error.get("ctx", {}).get("error"), LeftOpen)


def _place(location: Sequence[int | str], document: Any) -> list[int | str]:
    """Keys of the document; pydantic puts the types it tried between and behind them."""
    place: list[int | str] = []
    for part in location:
        try:
            document = document[part]
        except (KeyError, IndexError, TypeError):
            continue
        place.append(part)
    return place


def _worded(errors: Sequence[Any]) -> tuple[str, str]:
    """Say what is wrong with one value, and what to give instead."""
    first = errors[0]
    value = first["input"]
    kind = first["type"]
    if kind == "value_error":
        error = first["ctx"]["error"]
        fits = isinstance(error, Unfit)
        return (error.what, f"give {error.wanted}") if fits else (str(error), "correct it")
    if kind == "literal_error":
        expected = first["ctx"]["expected"]
        choices = re.findall(r"'([^']*)'", expected)
        # only words, which can be misspelt
        words = "True" not in expected and all(choice[:1].isalpha() for choice in choices)
        if isinstance(value, str) and choices and words:
            return f"got {_shown(value)}", nearest(value, choices)
        # TOML writes them small
        expected = expected.replace("True", "true").replace("False", "false")
        return f"got {_shown(value)}", f"give {expected}"
    if kind in ("tuple_type", "list_type") and isinstance(value, Mapping):
        return "got a single table", "write its name in [[two brackets]]"
    if kind in ("missing", "too_long") and isinstance(value, list):
        wanted = first["ctx"]["max_length"] if kind == "too_long" else len(value) + 1
        return f"got {_shown(value)}", f"give {wanted} values"
    if kind in _BOUNDS:
        word, key = _BOUNDS[kind]
        return f"got {_shown(value)}", f"give {word} {first['ctx'][key]:.10g}"
    known = [_wanted(e) for e in errors]
    if not all(known):
        return f"got {_shown(value)}: {first['msg']}", "correct it"
    mend = " or ".join(dict.fromkeys(known))
    numbers, texts = (
        any(e["type"].startswith(kinds) for e in errors)
        for kinds in (("int_", "float_", "finite_number"), ("string_",))
    )
    texts = texts or "'" in mend  # one of some words
    if isinstance(value, str) and not texts:
        mend += ", without quotes" + (" or unit" if numbers else "")
    return f"got {_shown(value)}", f"give {mend}"


def _wanted(error: Any) -> str:
    """Name what one way of taking a value would have accepted; empty if that has no words."""
    if error["type"] == "literal_error":
        return str(error["ctx"]["expected"]).replace("True", "true").replace("False", "false")
    return next((word for kind, word in _KINDS.items() if error["type"].startswith(kind)), "")


def _shown(value: Any) -> str:
    """Write a value as a configuration would."""
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    if isinstance(value, Mapping):
        text = "a table"
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"


def _known_keys(place: Sequence[int | str], model: Any) -> list[str]:
    """Keys that could have stood where an unknown one was found."""
    for part in place[:-1]:
        if part not in getattr(model, "model_fields", {}):
            continue  # a number, or a name of the user's own, such as an element's
        model = _model_in(model.model_fields[part].annotation)
    return list(getattr(model, "model_fields", {}))


def _model_in(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    inner = map(_model_in, getattr(annotation, "__args__", ()))
    return next((found for found in inner if found is not None), None)
