"""Which recordings are played: those of the run, or others."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayesfric.errors import BadInput
from bayesfric.finished_run import Finished
from bayesfric.opened import read_text
from bayesfric.problem.config import Config, parse_config, read_config
from bayesfric.problem.config_text import config_of, document_text, recording_table
from bayesfric.problem.problem import Problem
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import Observation
from bayesfric.recordings.recording import Recording
from bayesfric.results.roll_out import Part


@dataclass(frozen=True, eq=False)
class Recorded:
    """A recording to be played, as read and as prepared."""

    measurement: Measurement
    observation: Observation
    part: Part


def own(posterior: Finished, *, every: bool = False) -> list[Recorded]:
    """Take what the run held out; what it fitted where it held nothing out, or with ``every``."""
    model = posterior.model
    held = [Recorded(one.recording, one.observation, "held out") for one in model.held_out]
    if held and not every:
        return held
    pairs = zip(model.recordings, model.observations, strict=True)
    return [*held, *(Recorded(m, o, "fitted") for m, o in pairs)]


def of_config(posterior: Finished, path: Path) -> list[Recorded]:
    """Read the recordings of another configuration, which may leave out what the run's says.

    Raises
    ------
    BadInput
        If it describes another mechanism than the run's, or for what cannot be used.
    """
    run = tomllib.loads(posterior.model.config.text)
    try:
        document = tomllib.loads(read_text(path, "name the .toml file"))
    except (ValueError, RecursionError):
        read_config(path)  # says what is wrong
        raise
    for table in ("mechanism", "processing"):
        if table in run:
            document.setdefault(table, run[table])
    if document["mechanism"].get("terms") == "auto":  # what was put in, only the run knows
        document["mechanism"] = run["mechanism"]
    config = parse_config(document_text(document), path)
    if config.tables.mechanism != posterior.model.config.tables.mechanism:
        raise BadInput(
            f"{path}: mechanism", "is not the run's", "leave it out: it is taken from the run"
        )
    return _new(posterior, config, None)


def of_recordings(posterior: Finished, recordings: Sequence[Recording]) -> list[Recorded]:
    """Read recordings made in Python, prepared as the run's."""
    run = tomllib.loads(posterior.model.config.text)
    document: dict[str, Any] = {k: run[k] for k in ("mechanism", "processing") if k in run}
    tables = [recording_table(one, n) for n, one in enumerate(recordings, start=1)]
    return _new(posterior, config_of({**document, "recordings": tables}), recordings)


def _new(
    posterior: Finished, config: Config, recordings: Sequence[Recording] | None
) -> list[Recorded]:
    made = Problem.from_config(config, terms=posterior.joint.terms, recordings=recordings)
    parts = [*zip(made.recordings, made.observations, strict=True)]
    parts += [(one.recording, one.observation) for one in made.held_out]
    return [Recorded(m, o, _part(posterior, m)) for m, o in parts]


def _part(posterior: Finished, m: Measurement) -> Part:
    """Say whether any of it was fitted: a piece of a file that was is not new by another name."""
    same = (one for one in posterior.model.recordings if one.sha256 == m.sha256)
    within = any(one.time[0] <= m.time[-1] and m.time[0] <= one.time[-1] for one in same)
    return "fitted" if within else "new"
