"""The configuration file: TOML in, checked options out."""

from __future__ import annotations

import glob
import json
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import tomlkit
from pydantic import BaseModel, Field, ValidationError
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import InlineTable, Table

from bayesfric.base.errors import BadInput
from bayesfric.base.options import Options, configuration_error
from bayesfric.base.safe_read import read_json, read_text
from bayesfric.diagnostics.explanation import CalibrationCheckOptions
from bayesfric.estimates.point_estimate import Estimation, Reference
from bayesfric.identifiability.advice_options import AdviceOptions
from bayesfric.inference.likelihood import LikelihoodMethod
from bayesfric.inference.noise import NoiseScale
from bayesfric.inference.priors import PriorText
from bayesfric.inference.sampling import Sampling
from bayesfric.mechanism.configuration import ElementOptions, LoadOptions, MechanismOptions
from bayesfric.mechanism.experiment import Simulation
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.recordings.held_out import Validation
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.source import Processing, Recording, Source

# Name of a model made in Python, in messages.
_MODEL = Path("Model")
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
        "motion; output-error: the position, by simulation, nothing differentiated; closed-loop: "
        "the position, predicted from targets and earlier positions, where no torque is recorded "
        "(then it needs no mention)",
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


@dataclass(frozen=True)
class Config:
    """A configuration and its file."""

    path: Path
    text: str  # of the file
    tables: Tables  # validated options
    # of a run's configuration ``source`` in ``summary.json``: its original folder, and by name of a
    # recording the original file and its sha256
    origin: Mapping[str, Any] = field(default_factory=dict)

    @property
    def folder(self) -> Path:
        """Folder that file names are relative to: for a run's configuration its original one.

        If fitted files are missing there, it is the run's.
        """
        files = [Path(file["file"]) for file in self.origin.get("recordings", {}).values()]
        is_there = self.origin and all(file.exists() for file in files)
        return Path(self.origin["folder"]) if is_there else self.path.parent

    @staticmethod
    def origin_of(recordings: Sequence[Measurement], folder: Path) -> dict[str, Any]:
        """Record where the fitted files are; their names are relative to ``folder``."""
        files = {
            r.name: {"file": str(r.path.absolute()), "sha256": r.sha256}
            for r in recordings
            if r.path
        }
        return {"folder": str(folder.absolute()), "recordings": files}

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
            raise BadInput(where, error.problem, error.hint) from None


def read_config(path: Path) -> Config:
    """Read and validate a configuration."""
    return replace(parse_config(read_toml(path), path), origin=_origin(path))


def read_toml(path: Path) -> str:
    """Read the text of a TOML file."""
    return read_text(path, "name the .toml file")


def _origin(path: Path) -> Mapping[str, Any]:
    """Read the origin of a run's configuration; empty outside a run."""
    summary = path.with_name("summary.json")
    if path.name != RUN_CONFIG or not summary.is_file():
        return {}
    try:
        origin: dict[str, Any] = read_json(summary)["source"]
        texts = [f[key] for f in origin["recordings"].values() for key in ("file", "sha256")]
        return origin if all(isinstance(x, str) for x in (origin["folder"], *texts)) else {}
    except (BadInput, LookupError, TypeError, AttributeError):
        return {}


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
        problem = f"is not TOML ({str(error).partition(';')[0]})"
        hint = 'write key = value, each key once, with text in "quotes"'
        raise BadInput(str(path), problem, hint) from None


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
    return replace(parse_config(text, config.path), origin=config.origin)


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
