"""Python objects as the text of a configuration, which is what a model is made from."""

from __future__ import annotations

import glob
import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from bayesfric.base.errors import BadInput
from bayesfric.mechanism.configuration import ElementOptions, LoadOptions
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.presets import PRESETS
from bayesfric.problem.config import Config, parse_config
from bayesfric.recordings.recording import Recording
from bayesfric.recordings.source import Source

# What complaints about a model made in Python begin with.
_MODEL = Path("Model")
_BARE = re.compile(r"[A-Za-z0-9_-]+")


def config_of(document: Mapping[str, Any]) -> Config:
    """Write tables as a configuration, and check it as if it had been read.

    Raises
    ------
    BadInput
        With the key and the mend, for anything that cannot be used.
    """
    return parse_config(document_text(document), _MODEL)


def document_text(document: Mapping[str, Any], path: Path = _MODEL) -> str:
    """Write tables as the text of a configuration; ``path`` names them in messages."""
    return "\n".join(_lines(document, path))


def with_terms(config: Config, names: Sequence[str]) -> Config:
    """Give a configuration whose mechanism names terms of one's own."""
    return with_settings(config, [f"mechanism.terms = {toml_value(list(names))}"], extend=False)


def with_settings(config: Config, settings: Sequence[str], *, extend: bool = True) -> Config:
    """Give a configuration with settings, lines of dotted keys, put in; comments are lost.

    Of a list, such as cycles a turn, what is there stays where it is to be ``extend``-ed.
    """
    document = tomllib.loads(config.text)
    for line in settings:
        _put(document, tomllib.loads(line), extend)
    found = parse_config(document_text(document), config.path)
    return found.model_copy(update={"origin": config.origin})


def _put(table: dict[str, Any], more: Mapping[str, Any], extend: bool) -> None:
    for key, value in more.items():
        there = table.get(key)
        if isinstance(value, Mapping):
            _put(table.setdefault(key, {}), value, extend)
        elif extend and isinstance(value, list) and isinstance(there, list):
            table[key] = [*there, *(x for x in value if x not in there)]
        else:
            table[key] = value


def mechanism_table(joint: Joint) -> dict[str, Any]:
    """Write a joint as the ``[mechanism]`` table that makes it."""
    offset = "per-recording" if joint.own_offsets else joint.offset
    terms = [term.name for term in joint.terms] or None  # what is none is left out
    table = {"offset": offset, "gain": joint.gain, "terms": terms, "delay": joint.delay}
    if joint.made_from in PRESETS:
        base = PRESETS[joint.made_from].chain()
        if (base.elements, base.load) == (joint.elements, joint.load):
            return {"preset": joint.made_from, **table}
    # an empty table would be left out, and the element with it
    elements = {
        one.name: _chosen(one, ElementOptions) or {"ratio": one.ratio} for one in joint.elements
    }
    return {**table, "load": _chosen(joint.load, LoadOptions), "elements": elements}


def recording_table(recording: Recording, number: int) -> dict[str, Any]:
    """Write a recording as the ``[[recordings]]`` table that reads it, once a run has saved it."""
    source = recording.source
    if not isinstance(source, Source):
        source = recording.filed(saved_name(number))
        return {"name": f"recording-{number}", **source.model_dump(mode="json", exclude_unset=True)}
    folder = str(recording.folder.absolute())
    files = [
        str(Path(glob.escape(folder) if glob.has_magic(f) else folder, f)) for f in source.files
    ]
    return {**source.model_dump(mode="json", exclude_unset=True), "file": files}


def saved_name(number: int) -> str:
    """Name the file in a run directory of a recording that was given as a table in memory."""
    return f"recordings/recording-{number}.csv"


def _chosen(item: Any, options: type[BaseModel]) -> dict[str, Any]:
    given = {**vars(item), **item.choices}
    return {
        key: v
        for key, v in given.items()
        if key in options.model_fields and v != options.model_fields[key].default
    }


def prior_value(prior: Any) -> Any:
    """Write a prior as a configuration does; a frozen distribution of SciPy by its name."""
    family = getattr(prior, "dist", None)
    if family is None:
        return prior
    names = [*(family.shapes or "").replace(",", " ").split(), "loc", "scale"]
    values = {**dict(zip(names, prior.args, strict=False)), **prior.kwds}
    return {"distribution": family.name, **{key: float(x) for key, x in values.items()}}


def _lines(document: Mapping[str, Any], path: Path) -> Iterator[str]:
    for key, table in document.items():
        several = isinstance(table, list)
        for number, part in enumerate(table if several else [table], start=1):
            where = f"{path}: {key}" + (f".{number}" if several else "")
            yield f"[[{_key(key)}]]" if several else f"[{_key(key)}]"
            yield from _entries(part, where)
            yield ""


def _entries(table: Any, where: str) -> Iterator[str]:
    """Write the keys of a table; what is ``None`` or an empty table is left out."""
    if isinstance(table, BaseModel):
        table = table.model_dump(mode="json", exclude_unset=True)
    if not isinstance(table, Mapping):
        raise BadInput(where, f"got {table!r}", "give a table: a dict of keys")
    for key, value in table.items():
        if value is not None and not (isinstance(value, Mapping) and not value):
            yield f"{_key(str(key))} = {toml_value(value, f'{where}.{key}')}"


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else toml_value(key)


def toml_value(value: Any, where: str = "") -> str:
    """Write one value; reading it gives the same number.

    Raises
    ------
    BadInput
        Naming ``where``, if a configuration cannot hold it.
    """
    value = value.tolist() if hasattr(value, "tolist") else value  # NumPy's
    if isinstance(value, bool | int | float):
        return repr(value).lower()
    if isinstance(value, str | Path):
        return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return f"[{', '.join(toml_value(one, where) for one in value)}]"
    if isinstance(value, Mapping | BaseModel):
        return f"{{ {', '.join(_entries(value, where))} }}"
    raise BadInput(where, f"got {type(value).__name__}", "give a number, text, a list or a table")
