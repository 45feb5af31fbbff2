"""Functions of a posterior, however it is given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayesfric.base.atomic_write import check_output_folder
from bayesfric.base.errors import BadInput
from bayesfric.fit.model import RESULT, Result
from bayesfric.report.summary.record import Summary, read_summary_file
from bayesfric.report.terminal import PrintedSummary


def result_of(posterior: Any) -> Result:
    """Return the result of a posterior of :meth:`bayesfric.Model.sample`, or of a run's folder."""
    if isinstance(posterior, str | Path):
        return Result.read(Path(posterior))
    if isinstance(posterior, Result):
        return posterior
    result = getattr(posterior, RESULT, None)
    if not isinstance(result, Result):
        raise BadInput(
            "posterior", "is not what Model.sample returned", "give that, not a copy or part of it"
        )
    return result


def summary(posterior: Any) -> Summary:
    """Sum a posterior up.

    Parameters
    ----------
    posterior
        From :meth:`bayesfric.Model.sample`, or the folder of a finished run.

    Returns
    -------
    Summary
        Every number with its verdict; ``frame`` is its table; it shows as on a terminal.
    """
    if isinstance(posterior, str | Path):
        return PrintedSummary.read(read_summary_file(Path(posterior)), str(posterior))
    return result_of(posterior).summary


def report(posterior: Any, folder: Path | str, *, force: bool = False, paper: bool = False) -> Path:
    """Write the run directory of a posterior, as ``bayesfric fit`` does.

    Recordings that were given as arrays are saved in it, and its ``config.toml`` names them.

    Parameters
    ----------
    posterior
        From :meth:`bayesfric.Model.sample`.
    folder
        The run directory to make.
    force
        Replace an old run.
    paper
        Add LaTeX tables, methods and references, and figures as PDF and PNG.

    Returns
    -------
    Path
        The page to read.

    Raises
    ------
    BadInput
        If the folder is not free, or cannot be written to.
    """
    folder = Path(folder)
    result = result_of(posterior)
    check_output_folder(folder, force=force)
    result.write(folder, paper=paper)
    return folder / "report.html"
