"""``bayesfric identify``: what the recordings can and cannot tell, before sampling.

With ``--advise``: which recording to make next, and the torque to play.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.base.written import write_beside
from bayesfric.diagnostics.before_a_fit import little_explained
from bayesfric.fit.model import Model
from bayesfric.identifiability.identification import Identification
from bayesfric.identifiability.next_recording import ASSUMPTION, Ranking
from bayesfric.report.words import doubt_text, filled


def identify_record(found: Identification, model: Model) -> dict[str, Any]:
    """Put an identification into the form that ``--json`` prints; what is infinite is ``None``."""
    return {"config": str(model.config.path), **found.as_json(), "doubts": _doubts(model)}


def identify_text(found: Identification, model: Model) -> list[str]:
    """Word an identification for a person: first what cannot be told, then the tables."""
    unit = "rad" if model.chain.load.motion == "rotary" else "m"
    doubted = _warnings(model)
    told = filled("identify.txt.j2", found=found, unit=unit, doubted=bool(doubted), inf=np.inf)
    return [*doubted, *told.splitlines()]


def _doubts(model: Model) -> list[dict[str, Any]]:
    """Doubt a mechanism before anything is said of its parameters, as ``check`` does."""
    return little_explained(model.chain, model.observations)


def _warnings(model: Model) -> list[str]:
    """Word these doubts, a line between them and what follows."""
    told = [f"WARNING: {doubt_text(one)}" for one in _doubts(model)]
    return [*told, ""] if told else []


def advice_file(name: str, output: Path | None, *, force: bool) -> Path:
    """Settle where the winning excitation goes, before anything is computed.

    It is a CSV that is not there already, or is replaced by ``force``. One that nobody named may be
    there: of a second answer nothing is lost but the file.
    """
    path = output or Path(f"advice-{name}.csv")
    if path.suffix.lower() != ".csv":
        raise BadInput(str(path), "is not named .csv", "name the excitation something.csv")
    if output and path.exists() and not force:
        raise BadInput(
            str(path), "exists already", "name another file with -o, or replace it with --force"
        )
    return path


def write_advice(found: Ranking, path: Path, model: Model, *, force: bool) -> bool:
    """Write the winning excitation, and tell whether there was any that is worth it.

    Columns are time and torque, their units in the second line. A file that is there stays, but for
    ``force``.
    """
    if not found.worth or (path.exists() and not force):
        return False
    table = io.StringIO()
    np.savetxt(
        table,
        found.advices[0].candidate.rows,
        fmt=["%.10g", "%.6g"],
        delimiter=",",
        header=f"time,torque\ns,{_torque_unit(model)}",
        comments="",
    )
    write_beside({path: table.getvalue()}, replace=force)
    return True


def advice_record(found: Ranking, model: Model, written: Path | None) -> dict[str, Any]:
    """Put a ranking into the form that ``--json`` prints; what is infinite is ``None``."""
    file = str(written) if written else None
    return {"config": str(model.config.path), **found.as_json(), "written": file} | {
        "doubts": _doubts(model)
    }


def advice_text(found: Ranking, model: Model, path: Path, *, written: bool) -> list[str]:
    """Word a ranking for a person: what to do first, then the table."""
    told = filled(
        "advise.txt.j2",
        found=found,
        assumption=ASSUMPTION,
        inf=np.inf,
        path=path,
        written=written,
        torque_unit=_torque_unit(model),
        position_unit="rad" if model.chain.load.motion == "rotary" else "m",
    )
    return [*_warnings(model), *told.splitlines()]


def _torque_unit(model: Model) -> str:
    return "N m" if model.chain.motor_motion == "rotary" else "N"
