"""``bayesfric identify``: what the recordings can and cannot tell, before sampling.

With ``--advise``: which recording to make next, and the torque to play.
"""

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
    """Give what ``--json`` prints, infinite as ``None``; and words, what cannot be told first."""
    found = model.identification(progress=progress)
    doubts, warned = _doubts(model)
    told = filled(
        "identify.txt.j2", found=found, inf=np.inf, unit=_position_unit(model), doubted=bool(warned)
    )
    return _record(model, found.as_json(), doubts=doubts), [*warned, *told.splitlines()]


def advise(
    model: Model,
    name: str,
    path: Path | None = None,
    *,
    force: bool = False,
    progress: ProgressCallback = no_progress,
) -> tuple[dict[str, Any], list[str]]:
    """Say what to record next to know a quantity, and write the torque to play where asked.

    ``path`` is a CSV that is not there already, or is replaced by ``force``; columns are time and
    torque, their units in the second line.
    """
    if path and path.suffix.lower() != ".csv":
        raise BadInput(str(path), "is not named .csv", "name the excitation something.csv")
    if path and path.exists() and not force:
        mend = "name another file with -o, or replace it with --force"
        raise BadInput(str(path), "exists already", mend)
    unit = "N m" if model.chain.motor_motion == "rotary" else "N"
    found = model.advise(name, progress=progress)
    written = path if found.worth else None
    if written:
        write_files({written: _excitation(found, unit)}, replace=force)
    doubts, warned = _doubts(model)
    told = filled(
        "advise.txt.j2",
        found=found,
        assumption=ASSUMPTION,
        inf=np.inf,
        written=written,
        torque_unit=unit,
        position_unit=_position_unit(model),
    )
    file = str(written) if written else None
    return _record(model, found.as_json(), written=file, doubts=doubts), [
        *warned,
        *told.splitlines(),
    ]


def _record(model: Model, found: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"config": str(model.config.path), **found, **more}


def _doubts(model: Model) -> tuple[list[dict[str, Any]], list[str]]:
    """Doubt a mechanism before anything is said of its parameters, as ``check`` does."""
    doubts = little_explained(model.chain, model.observations)
    warned = [f"WARNING: {doubt_text(one)}" for one in doubts]
    return doubts, [*warned, ""] if warned else []


def _excitation(found: Ranking, unit: str) -> str:
    table = io.StringIO()
    rows, header = found.advices[0].candidate.rows, f"time,torque\ns,{unit}"
    np.savetxt(table, rows, fmt=["%.10g", "%.6g"], delimiter=",", header=header, comments="")
    return table.getvalue()


def _position_unit(model: Model) -> str:
    return "rad" if model.chain.load.motion == "rotary" else "m"
