"""The configuration file: TOML in, checked options out."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bayesfric.errors import BadInput, nearest
from bayesfric.inference.noise import NoiseScale
from bayesfric.inference.priors import PriorText
from bayesfric.inference.sampling import Sampling
from bayesfric.mechanism.experiment import Simulation
from bayesfric.mechanism.options import MechanismOptions
from bayesfric.recordings.options import Processing, Source

# A configuration is a page of text; anything larger is some other file.
_LARGEST = 1_000_000


class NoiseOptions(BaseModel):
    """The ``[noise]`` table."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scale: NoiseScale = Field(
        "per-recording", description="one noise scale for each recording, or one shared by all"
    )


class Tables(BaseModel):
    """Everything a configuration may hold."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    mechanism: MechanismOptions = Field(description="what the joint is")
    recordings: tuple[Source, ...] = Field((), description="what was measured")
    processing: Processing = Field(default_factory=Processing, description="how it is filtered")
    priors: dict[str, Any] = Field(default_factory=dict, description="what is known beforehand")
    noise: NoiseOptions = Field(default_factory=NoiseOptions, description="what residuals are")
    sampling: Sampling = Field(default_factory=Sampling, description="how the posterior is sampled")
    simulation: Simulation | None = Field(None, description="for bayesfric simulate")


class Config(BaseModel):
    """A configuration with where it came from.

    Attributes
    ----------
    path
        The file.
    text
        Its contents, kept with every result.
    tables
        The checked options.
    """

    model_config = ConfigDict(frozen=True)

    path: Path
    text: str
    tables: Tables

    @property
    def folder(self) -> Path:
        """Folder that file names in the configuration are relative to."""
        return self.path.parent

    @property
    def priors(self) -> dict[str, PriorText]:
        """Priors by parameter name, nested tables flattened."""
        return dict(_flatten(self.tables.priors))


def read_config(path: Path) -> Config:
    """Read and check a configuration.

    Parameters
    ----------
    path
        A TOML file.

    Raises
    ------
    BadInput
        With the key and the mend, for anything that cannot be used.
    """
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise BadInput(str(path), "there is no such file", "check the name") from None
    except IsADirectoryError:
        raise BadInput(str(path), "is a folder", "name the .toml file in it") from None
    except OSError as error:
        raise BadInput(str(path), f"cannot be read ({error.strerror})", "check its rights") from None
    if len(raw) > _LARGEST:
        raise BadInput(str(path), "is too large for a configuration", "name the .toml file")
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise BadInput(
            str(path), f"is not UTF-8 (byte {error.start})", "save it as UTF-8"
        ) from None
    return parse_config(text, path)


def parse_config(text: str, path: Path) -> Config:
    """Check a configuration's text; see :func:`read_config`."""
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise BadInput(str(path), f"is no TOML: {error}", "mend that line") from None
    try:
        tables = Tables.model_validate(document)
    except ValidationError as error:
        raise _complaint(path, error) from None
    return Config(path=path, text=text, tables=tables)


def _complaint(path: Path, error: ValidationError) -> BadInput:
    # A misspelt key often causes further complaints: name it first.
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    place = [str(part) if not isinstance(part, int) else str(part + 1) for part in first["loc"]]
    where = f"{path}: {'.'.join(place) or 'configuration'}"
    if first["type"] == "extra_forbidden":
        return BadInput(where, "unknown key", nearest(place[-1], _known_keys(first["loc"])))
    if first["type"] == "missing":
        return BadInput(where, "is missing", f"add {place[-1]!r}")
    message = first["msg"].removeprefix("Value error, ")
    shown = repr(first["input"])
    got = f"{shown[:60]}: " if not isinstance(first["input"], dict | list) else ""
    return BadInput(where, f"{got}{message}", "mend that key")


def _known_keys(place: tuple[int | str, ...]) -> list[str]:
    """Keys that could have stood where an unknown one was found."""
    model: Any = Tables
    for part in place[:-1]:
        if isinstance(part, int) or not hasattr(model, "model_fields"):
            continue
        if part not in model.model_fields:
            continue  # a name of the user's own, such as an element's
        model = _model_in(model.model_fields[part].annotation)
    return list(getattr(model, "model_fields", {}))


def _model_in(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for part in getattr(annotation, "__args__", ()):
        found = _model_in(part)
        if found is not None:
            return found
    return None


def _flatten(tables: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, PriorText]]:
    for key, value in tables.items():
        name = f"{prefix}{key}"
        # {distribution = ...} is a prior, any other table holds an element's parameters
        if isinstance(value, Mapping) and "distribution" not in value:
            yield from _flatten(value, f"{name}.")
        else:
            yield name, value
