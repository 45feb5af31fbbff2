"""``bayesfric identify``: what recordings determine, and with ``--advise`` what to record next."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.base.atomic_write import write_files
from bayesfric.base.errors import BadInput
from bayesfric.base.progress import ProgressCallback, no_progress
from bayesfric.diagnostics.before_a_fit import little_explained
from bayesfric.fit.model import Model
from bayesfric.identifiability.next_recording import ASSUMPTION, Ranking
from bayesfric.report.words import doubt_text, filled


def identify(
    model: Model, *, progress: ProgressCallback = no_progress
) -> tuple[dict[str, Any], list[str]]:
    """Return the record, infinite numbers as ``None``, and lines of text."""
    identification = model.identification(progress=progress)
    doubts, warnings = _doubts(model)
    text = filled(
        "identify.txt.j2",
        found=identification,
        inf=np.inf,
        unit=_position_unit(model),
        doubted=bool(warnings),
    )
    return _record(model, identification.as_json(), doubts=doubts), [*warnings, *text.splitlines()]


def advise(
    model: Model,
    name: str,
    path: Path | None = None,
    *,
    force: bool = False,
    progress: ProgressCallback = no_progress,
) -> tuple[dict[str, Any], list[str]]:
    """Rank next recordings for one quantity, and write the best one's torque.

    ``path`` is a new CSV, or replaced by ``force``; units are in the second line.
    """
    if path and path.suffix.lower() != ".csv":
        raise BadInput(str(path), "is not named .csv", "name the excitation something.csv")
    if path and path.exists() and not force:
        mend = "name another file with -o, or replace it with --force"
        raise BadInput(str(path), "exists already", mend)
    unit = "N m" if model.chain.motor_motion == "rotary" else "N"
    ranking = model.advise(name, progress=progress)
    written = path if ranking.worth else None
    if written:
        write_files({written: _excitation(ranking, unit)}, replace=force)
    doubts, warnings = _doubts(model)
    text = filled(
        "advise.txt.j2",
        found=ranking,
        assumption=ASSUMPTION,
        inf=np.inf,
        written=written,
        torque_unit=unit,
        position_unit=_position_unit(model),
    )
    file = str(written) if written else None
    return _record(model, ranking.as_json(), written=file, doubts=doubts), [
        *warnings,
        *text.splitlines(),
    ]


def _record(model: Model, record: dict[str, Any], **extra: Any) -> dict[str, Any]:
    return {"config": str(model.config.path), **record, **extra}


def _doubts(model: Model) -> tuple[list[dict[str, Any]], list[str]]:
    """Check first whether the mechanism explains the torque."""
    doubts = little_explained(model.chain, model.observations)
    warnings = [f"WARNING: {doubt_text(doubt)}" for doubt in doubts]
    return doubts, [*warnings, ""] if warnings else []


def _excitation(ranking: Ranking, unit: str) -> str:
    table = io.StringIO()
    rows, header = ranking.candidates[0].rows, f"time,torque\ns,{unit}"
    np.savetxt(table, rows, fmt=["%.10g", "%.6g"], delimiter=",", header=header, comments="")
    return table.getvalue()


def _position_unit(model: Model) -> str:
    return "rad" if model.chain.load.motion == "rotary" else "m"
