"""``bayesfric identify --advise``: which recording to make next, and the torque to play."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.commands.identify import local_picture
from bayesfric.commands.problem import Problem
from bayesfric.errors import BadInput
from bayesfric.estimates.descent import few_threads
from bayesfric.identifiability.next_recording import Ranking, ranking
from bayesfric.identifiability.plausible import points_around
from bayesfric.identifiability.sentences import page
from bayesfric.report.files import write_beside

# Points besides the estimate that everything is simulated at.
_AROUND = 6


def advice_file(name: str, output: Path | None, *, force: bool) -> Path:
    """Settle where the winning excitation goes, before anything is computed.

    Parameters
    ----------
    name
        What is advised on.
    output
        As given; ``advice-<name>.csv`` in the current folder if not.
    force
        Whether a file that is there may be replaced.

    Raises
    ------
    BadInput
        If it is no CSV, or is there already.
    """
    path = output or Path(f"advice-{name}.csv")
    if path.suffix.lower() != ".csv":
        raise BadInput(str(path), "is not named .csv", "name the excitation something.csv")
    if path.exists() and not force:
        raise BadInput(
            str(path), "exists already", "name another file with -o, or replace it with --force"
        )
    return path


def advice(
    problem: Problem, name: str, *, progress: Callable[[str], None] = lambda _: None
) -> Ranking:
    """Rank recordings to make next by what they would leave of one quantity.

    Parameters
    ----------
    problem
        From :func:`bayesfric.commands.problem.read_problem`.
    name
        A free parameter or a derived quantity.
    progress
        Called with the name of each stage before it begins.

    Raises
    ------
    BadInput
        If nothing has that name, it is fixed, or nothing can be estimated here.
    """
    target, point, local = local_picture(problem, progress)
    # the seed of the whole analysis, in a stream of its own
    seed = np.random.SeedSequence(problem.config.tables.sampling.seed, spawn_key=(5,))
    with problem.config.named(), few_threads(problem.observations):
        others = points_around(
            target, point, local, np.random.default_rng(seed), around=_AROUND, prior=0
        )
        options = problem.config.tables.advice
        return ranking(target, [point, *others], local, options, name, progress=progress)


def write_advice(found: Ranking, path: Path, problem: Problem, *, force: bool) -> bool:
    """Write the winning excitation: time and torque, their units in the second line.

    Returns
    -------
    bool
        Whether there was anything worth writing.

    Raises
    ------
    BadInput
        If it cannot be written.
    """
    if not found.worth:
        return False
    table = io.StringIO()
    np.savetxt(
        table,
        found.advices[0].candidate.rows,
        fmt=["%.10g", "%.6g"],
        delimiter=",",
        header=f"time,torque\ns,{_torque_unit(problem)}",
        comments="",
    )
    write_beside({path: table.getvalue()}, replace=force)
    return True


def advice_record(found: Ranking, problem: Problem, written: Path | None) -> dict[str, Any]:
    """Put a ranking into the form that ``--json`` prints; what is infinite is ``None``."""
    file = str(written) if written else None
    return {"config": str(problem.config.path), **found.as_json(), "written": file}


def advice_text(found: Ranking, problem: Problem, written: Path | None) -> list[str]:
    """Word a ranking for a person: what to do first, then the table."""
    return page(
        "advise.txt",
        found=found,
        written=written,
        torque_unit=_torque_unit(problem),
        position_unit="rad" if problem.chain.load.motion == "rotary" else "m",
    )


def _torque_unit(problem: Problem) -> str:
    return "N m" if problem.chain.motor_motion == "rotary" else "N"
