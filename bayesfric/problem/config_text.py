"""Python objects as the text of a configuration, from which a model is made."""

from __future__ import annotations

import glob
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomlkit
from pydantic import BaseModel
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import InlineTable, Table

from bayesfric.base.errors import BadInput
from bayesfric.mechanism.configuration import ElementOptions, LoadOptions
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.problem.config import Config, parse_config
from bayesfric.recordings.source import Recording, Source

# Name of a model made in Python, in messages.
_MODEL = Path("Model")


def config_of(document: Mapping[str, Any]) -> Config:
    """Write tables as a configuration, and validate it."""
    return parse_config(document_text(document), _MODEL)


def document_text(document: Mapping[str, Any], path: Path = _MODEL) -> str:
    """Write tables as the text of a configuration; ``path`` is for messages."""
    return tomlkit.dumps(_plain(document, f"{path}: "))


def _plain(value: Any, where: str) -> Any:
    """Convert models, arrays and paths to TOML types; keys that are ``None`` are dropped."""
    value = value.tolist() if hasattr(value, "tolist") else value  # NumPy's
    if isinstance(value, BaseModel):
        value = value.model_dump(mode="json", exclude_unset=True)
    if isinstance(value, Mapping):
        inside = where if where.endswith(" ") else f"{where}."
        return {str(k): _plain(v, f"{inside}{k}") for k, v in value.items() if v is not None}
    if isinstance(value, list | tuple):
        return [_plain(element, where) for element in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, bool | int | float | str):
        return value
    raise BadInput(where, f"got {type(value).__name__}", "give a number, text, a list or a table")


def toml_value(value: Any) -> str:
    """Write one value in one line."""
    if not isinstance(value, Mapping):
        return str(tomlkit.item(value).as_string())
    table = tomlkit.inline_table()
    table.update(value)
    return f"{{ {table.as_string()[1:-1]} }}"


def with_settings(config: Config, settings: Sequence[str]) -> Config:
    """Return a configuration with settings, lines of dotted keys, added.

    Comments are preserved, and lists extended.
    """
    text = config.text
    for line in settings:
        setting = tomllib.loads(line)
        try:
            document = tomlkit.parse(text)
        except TOMLKitError:  # it mistakes a header below dotted keys for a second table
            document = tomlkit.parse(tomlkit.dumps(tomllib.loads(text)))
        has_table = _put(document, setting)
        text = tomlkit.dumps(document)
        if not has_table:
            text = f"{text.rstrip()}\n\n{tomlkit.dumps(setting)}"
    return parse_config(text, config.path).model_copy(update={"origin": config.origin})


def _put(table: Any, setting: Mapping[str, Any]) -> bool:
    """Set one key before the comments that end its table; False if that table is missing."""
    ((key, value),) = setting.items()
    current = table.get(key)
    if isinstance(current, Mapping):
        return _put(current, value)
    if isinstance(value, Mapping) and not isinstance(table, InlineTable):
        return False
    if isinstance(value, list) and isinstance(current, list):
        value = [*current, *(x for x in value if x not in current)]
    body = table.value.body if isinstance(table, Table) and current is None else []
    comments: list[Any] = []
    while body and body[-1][0] is None:
        comments.insert(0, body.pop())
    table[key] = value
    body += comments
    return True


def mechanism_table(joint: Joint) -> dict[str, Any]:
    """Write a joint as a ``[mechanism]`` table."""
    offset = "per-recording" if joint.own_offsets else joint.offset
    terms = [term.name for term in joint.terms] or None
    table = {"offset": offset, "gain": joint.gain, "terms": terms, "delay": joint.delay}
    if joint.made_from in PRESETS:
        base = PRESETS[joint.made_from].chain()
        if (base.elements, base.load) == (joint.elements, joint.load):
            return {"preset": joint.made_from, **table}
    elements = {element.name: _chosen(element, ElementOptions) for element in joint.elements}
    return {**table, "load": _chosen(joint.load, LoadOptions), "elements": elements}


def recording_table(recording: Recording, number: int) -> dict[str, Any]:
    """Write a recording as a ``[[recordings]]`` table, as a run saves it."""
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
    """Name the file of a table in memory in a run directory."""
    return f"recordings/recording-{number}.csv"


def _chosen(item: Any, options: type[BaseModel]) -> dict[str, Any]:
    values = {**vars(item), **item.choices}
    return {
        key: v
        for key, v in values.items()
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
