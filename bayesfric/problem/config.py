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
from bayesfric.estimates.estimation import Estimation, Reference
from bayesfric.identifiability.advice_options import AdviceOptions
from bayesfric.inference.likelihood.likelihood import LikelihoodMethod
from bayesfric.inference.noise.scale import NoiseScale
from bayesfric.inference.prior.priors import PriorText
from bayesfric.inference.sampling.sampling import Sampling
from bayesfric.mechanism.configuration import MechanismOptions
from bayesfric.mechanism.experiment import Simulation
from bayesfric.recordings.held_out import Validation
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.processing import Processing
from bayesfric.recordings.source import Source

# What a configuration is called in a run directory.
RUN_CONFIG = "config.toml"

Checked = TypeVar("Checked", bound=BaseModel)


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
    """Everything a configuration may hold; ``init`` writes the tables of options by this list."""

    mechanism: MechanismOptions = Field(description="What the joint is: a preset, or elements.")
    recordings: tuple[Source, ...] = Field(
        (), description="Where recordings are and what their columns mean; a table for each layout."
    )
    processing: Processing = Field(
        Processing(), description="How recordings are filtered, differentiated and decimated"
    )
    priors: dict[str, Any] = Field(
        default_factory=dict,
        description="What is known of parameters, by name: a number fixes, [low, high] is uniform, "
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
    noise: NoiseOptions = Field(NoiseOptions(), description="What the noise is taken for")
    sampling: Sampling = Field(Sampling(), description="How the posterior is sampled")
    validation: Validation = Field(
        Validation(),
        description="What the fit does not see, so that 'bayesfric fit' can say how well it "
        "predicts",
    )
    self_check: CalibrationCheckOptions = Field(
        CalibrationCheckOptions(),
        description="How every fit is tried on simulated recordings like its own",
    )
    pooling: PoolingOptions = Field(
        PoolingOptions(),
        description="Only for 'bayesfric pool': parameters that differ between recordings",
    )
    advice: AdviceOptions = Field(
        AdviceOptions(), description="Only for 'bayesfric identify --advise'"
    )
    simulation: Simulation | None = Field(None, description="Only for 'bayesfric simulate'")


class Kept(BaseModel):
    """The file of a recording as it was when it was fitted."""

    model_config = ConfigDict(frozen=True)

    file: Path
    sha256: str


class Origin(BaseModel):
    """Where a run's configuration and recordings were; ``source`` in its ``summary.json``."""

    model_config = ConfigDict(frozen=True)

    folder: Path
    recordings: dict[str, Kept]


class Config(BaseModel):
    """A configuration with where it came from."""

    model_config = ConfigDict(frozen=True)

    path: Path
    text: str  # contents of the file, kept with every result
    tables: Tables  # the checked options
    origin: Origin | None = None  # where it lay before, if it is that of a run

    @property
    def folder(self) -> Path:
        """Folder that file names in the configuration are relative to.

        That of a run's configuration is where it lay before, or where it is if not all that was
        fitted is there any more.
        """
        origin = self.origin
        if origin and all(one.file.exists() for one in origin.recordings.values()):
            return origin.folder
        return self.path.parent

    @staticmethod
    def origin_of(recordings: Sequence[Measurement], folder: Path) -> Origin:
        """Tell where all that was fitted is, so that it can be fitted again from elsewhere.

        ``folder`` is what file names in the configuration are relative to.
        """
        return Origin(
            folder=folder.absolute(),
            recordings={
                r.name: Kept(file=r.path.absolute(), sha256=r.sha256) for r in recordings if r.path
            },
        )

    @property
    def priors(self) -> dict[str, PriorText]:
        """Priors by parameter name, nested tables flattened."""
        return dict(_flatten(self.tables.priors, "distribution"))

    @property
    def references(self) -> dict[str, Reference]:
        """References by name of what they are of, nested tables flattened."""
        found = {}
        for name, entry in _flatten(self.tables.references, "value"):
            given = entry if isinstance(entry, Mapping) else {"value": entry}
            where = f"{self.path}: references.{name}"
            try:
                found[name] = Reference.model_validate(given, strict=True)
            except ValidationError as error:
                raise configuration_error(f"{where}.", "value", error, given, Reference) from None
        return found

    @contextmanager
    def named(self, place: str = "") -> Iterator[None]:
        """Put the configuration's name, and a place such as ``recordings.2``, before keys."""
        try:
            yield
        except BadInput as error:
            where = ": ".join(part for part in (str(self.path), place, error.where) if part)
            raise BadInput(where, error.what, error.mend) from None


def read_config(path: Path) -> Config:
    """Read and check a configuration; what cannot be used is bad input, with key and mend."""
    text = read_toml(path)
    return parse_config(text, path).model_copy(update={"origin": _origin(path)})


def read_toml(path: Path) -> str:
    """Read the text of a TOML file; bad input where there is none."""
    return read_text(path, "name the .toml file")


def _origin(path: Path) -> Origin | None:
    """Read where a run's configuration lay; ``None`` where it is not in a run."""
    beside = path.with_name("summary.json")
    if path.name != RUN_CONFIG or not beside.is_file():
        return None
    try:
        return Origin.model_validate(read_json(beside)["source"])
    except (BadInput, ValueError, LookupError, TypeError):
        return None


def parse_config(text: str, path: Path) -> Config:
    """Check a configuration's text; see :func:`read_config`."""
    tables = checked_toml(text, path, Tables, "configuration")
    # a name may come twice, dotted and in a table
    for name, count in Counter(n for n, _ in _flatten(tables.priors, "distribution")).items():
        if count > 1:
            raise BadInput(f"{path}: priors.{name}", "is given twice", "leave one out")
    return Config(path=path, text=text, tables=tables)


def read_document(text: str, path: Path) -> dict[str, Any]:
    """Read TOML; ``path`` names it in messages."""
    try:
        return tomllib.loads(text)
    except ValueError as error:
        what = f"is no TOML ({str(error).partition(';')[0]})"
        mend = 'write key = value, each key once, with text in "quotes"'
        raise BadInput(str(path), what, mend) from None


def checked_toml(text: str, path: Path, model: type[Checked], kind: str) -> Checked:
    """Read TOML as what a model describes; bad input names the key, and ``kind`` the whole."""
    document = read_document(text, path)
    try:
        # As JSON, of which pydantic takes lists for tuples, and still does not take true for 1 or
        # "yes" for true.
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
