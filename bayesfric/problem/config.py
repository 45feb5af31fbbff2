"""The configuration file: TOML in, checked options out."""

from __future__ import annotations

import json
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bayesfric.base.errors import BadInput
from bayesfric.base.options import Options, configuration_error
from bayesfric.base.safe_read import read_json, read_text
from bayesfric.diagnostics.calibration_check import CalibrationCheckOptions
from bayesfric.estimates.point_estimate import Estimation, Reference
from bayesfric.identifiability.advice_options import AdviceOptions
from bayesfric.inference.likelihood import LikelihoodMethod
from bayesfric.inference.noise import NoiseScale
from bayesfric.inference.priors import PriorText
from bayesfric.inference.sampling import Sampling
from bayesfric.mechanism.configuration import MechanismOptions
from bayesfric.mechanism.experiment import Simulation
from bayesfric.recordings.held_out import Validation
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.source import Processing, Source

# Name of the configuration in a run directory.
RUN_CONFIG = "config.toml"

OptionsModel = TypeVar("OptionsModel", bound=BaseModel)


class NoiseOptions(Options):
    """The ``[noise]`` table."""

    scale: NoiseScale = Field(
        "per-recording", description="one noise scale for each recording, or one shared by all"
    )
    model: Literal["auto", "white"] = Field(
        "auto",
        description="of torque residuals; auto is autoregressive with the order that the "
        "residuals of the estimate ask for, the first where they ask for none",
    )


class LikelihoodOptions(Options):
    """The ``[likelihood]`` table: which measured quantity the posterior explains."""

    method: LikelihoodMethod = Field(
        "input-error",
        description="input-error: the torque, by the inverse model along the differentiated "
        "motion; output-error: the position, by simulation, nothing differentiated",
    )


class PoolingOptions(Options):
    """The ``[pooling]`` table: parameters that may differ between recordings."""

    vary: dict[str, Literal["recording"]] = Field(
        default_factory=dict,
        examples=[{"motor.viscous": "recording", "offset": "recording"}],
        description='which, by name: { "motor.viscous" = "recording" }; all others are shared',
    )


class Tables(Options):
    """All tables of a configuration, in the order of ``init``."""

    mechanism: MechanismOptions = Field(description="What the joint is: a preset, or elements.")
    recordings: tuple[Source, ...] = Field(
        (), description="Where recordings are and what their columns mean; a table for each layout."
    )
    processing: Processing = Field(
        Processing(), description="How recordings are filtered, differentiated and decimated"
    )
    priors: dict[str, Any] = Field(
        default_factory=dict,
        description="Priors of parameters, by name: a number fixes, [low, high] is uniform, "
        '{ distribution = "norm", loc = ..., scale = ... } one of SciPy; in SI units.',
    )
    references: dict[str, Any] = Field(
        default_factory=dict,
        description="Values to compare results with, by name; they enter no fit. In SI units.",
    )
    estimation: Estimation = Field(Estimation(), description="How point estimates are made")
    likelihood: LikelihoodOptions = Field(
        LikelihoodOptions(), description="Which measured quantity the posterior explains"
    )
    noise: NoiseOptions = Field(NoiseOptions(), description="Noise model")
    sampling: Sampling = Field(Sampling(), description="How the posterior is sampled")
    validation: Validation = Field(
        Validation(),
        description="What the fit does not see, so that 'bayesfric fit' can say how well it "
        "predicts",
    )
    self_check: CalibrationCheckOptions = Field(
        CalibrationCheckOptions(),
        description="Calibration check of every fit on simulated replicates",
    )
    pooling: PoolingOptions = Field(
        PoolingOptions(),
        description="Only for 'bayesfric pool': parameters that differ between recordings",
    )
    advice: AdviceOptions = Field(
        AdviceOptions(), description="Only for 'bayesfric identify --advise'"
    )
    simulation: Simulation | None = Field(None, description="Only for 'bayesfric simulate'")


class FittedFile(BaseModel):
    """The file of a recording at the time of the fit."""

    model_config = ConfigDict(frozen=True)

    file: Path
    sha256: str


class Origin(BaseModel):
    """Original places of a run's configuration and recordings, ``source`` in ``summary.json``."""

    model_config = ConfigDict(frozen=True)

    folder: Path
    recordings: dict[str, FittedFile]


class Config(BaseModel):
    """A configuration and its file."""

    model_config = ConfigDict(frozen=True)

    path: Path
    text: str  # of the file
    tables: Tables  # validated options
    origin: Origin | None = None  # of a run's configuration

    @property
    def folder(self) -> Path:
        """Folder that file names are relative to: for a run's configuration its original one.

        If fitted files are missing there, it is the run's.
        """
        origin = self.origin
        if origin and all(recording.file.exists() for recording in origin.recordings.values()):
            return origin.folder
        return self.path.parent

    @staticmethod
    def origin_of(recordings: Sequence[Measurement], folder: Path) -> Origin:
        """Record where the fitted files are; their names are relative to ``folder``."""
        return Origin(
            folder=folder.absolute(),
            recordings={
                r.name: FittedFile(file=r.path.absolute(), sha256=r.sha256)
                for r in recordings
                if r.path
            },
        )

    @property
    def priors(self) -> dict[str, PriorText]:
        """Priors by parameter name, nested tables flattened."""
        return dict(_flatten(self.tables.priors, "distribution"))

    @property
    def references(self) -> dict[str, Reference]:
        """References by name, nested tables flattened."""
        checked = {}
        for name, entry in _flatten(self.tables.references, "value"):
            table = entry if isinstance(entry, Mapping) else {"value": entry}
            where = f"{self.path}: references.{name}"
            try:
                checked[name] = Reference.model_validate(table, strict=True)
            except ValidationError as error:
                raise configuration_error(f"{where}.", "value", error, table, Reference) from None
        return checked

    @contextmanager
    def named(self, place: str = "") -> Iterator[None]:
        """Prefix keys in messages by the configuration's name and a ``place``."""
        try:
            yield
        except BadInput as error:
            where = ": ".join(part for part in (str(self.path), place, error.where) if part)
            raise BadInput(where, error.what, error.hint) from None


def read_config(path: Path) -> Config:
    """Read and validate a configuration."""
    text = read_toml(path)
    return parse_config(text, path).model_copy(update={"origin": _origin(path)})


def read_toml(path: Path) -> str:
    """Read the text of a TOML file."""
    return read_text(path, "name the .toml file")


def _origin(path: Path) -> Origin | None:
    """Read the origin of a run's configuration; ``None`` outside a run."""
    summary = path.with_name("summary.json")
    if path.name != RUN_CONFIG or not summary.is_file():
        return None
    try:
        return Origin.model_validate(read_json(summary)["source"])
    except (BadInput, ValueError, LookupError, TypeError):
        return None


def parse_config(text: str, path: Path) -> Config:
    """Validate a configuration's text; see :func:`read_config`."""
    tables = checked_toml(text, path, Tables, "configuration")
    # a name may come twice, dotted and in a table
    for name, count in Counter(n for n, _ in _flatten(tables.priors, "distribution")).items():
        if count > 1:
            raise BadInput(f"{path}: priors.{name}", "is given twice", "leave one out")
    return Config(path=path, text=text, tables=tables)


def read_document(text: str, path: Path) -> dict[str, Any]:
    """Parse TOML; ``path`` is for messages."""
    try:
        return tomllib.loads(text)
    except ValueError as error:
        what = f"is not TOML ({str(error).partition(';')[0]})"
        mend = 'write key = value, each key once, with text in "quotes"'
        raise BadInput(str(path), what, mend) from None


def checked_toml(text: str, path: Path, model: type[OptionsModel], kind: str) -> OptionsModel:
    """Parse and validate TOML by a model; ``kind`` is for messages."""
    document = read_document(text, path)
    try:
        # JSON, as pydantic then converts lists to tuples, but not true to 1 or "yes" to true
        return model.model_validate_json(json.dumps(document, default=str), strict=True)
    except ValidationError as error:
        raise configuration_error(f"{path}: ", kind, error, document, model) from None


def _flatten(
    tables: Mapping[str, Any], leaf: str, prefix: str = ""
) -> Iterator[tuple[str, PriorText]]:
    for key, value in tables.items():
        name = f"{prefix}{key}"
        # {distribution = ...} is a prior, any other table holds an element's parameters
        if isinstance(value, Mapping) and leaf not in value:
            yield from _flatten(value, leaf, f"{name}.")
        else:
            yield name, value
