"""Result of sampling a model, and its run directory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from bayesfric.base.atomic_write import check_output_folder
from bayesfric.base.errors import BadInput
from bayesfric.base.progress import ProgressCallback, no_progress
from bayesfric.inference.fitting import Fit
from bayesfric.problem.config_text import saved_name
from bayesfric.problem.problem import Problem
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.readers import sha256
from bayesfric.report.summary.record import Summary, read_summary_file
from bayesfric.report.terminal import PrintedSummary

if TYPE_CHECKING:
    import xarray as xr

# Attribute by which the tree that Model.sample returns refers to its Result; copies and trees read
# from a file have none.
_RESULT = "_bayesfric_result"


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """A sampled model with its summary.

    :class:`bayesfric.inference.fitting.Fit` says how it differs from ``Fit`` and ``Finished``.
    """

    model: Problem
    fit: Fit  # draws, point estimates and predictions
    summary: Summary  # of ``summary.json``, without the place of recordings

    def __repr__(self) -> str:
        return str(self.summary)

    @property
    def recordings(self) -> list[Measurement]:
        """All recordings, also held-out ones."""
        return [*self.model.recordings, *(one.recording for one in self.model.held_out)]

    def tree(self) -> xr.DataTree:
        """Return the contents of ``posterior.nc``."""
        from bayesfric.report.posterior_file import posterior_tree  # imports xarray and pandas

        text = self.model.config.text
        tree = posterior_tree(self.fit, self.summary, text, self.recordings)
        object.__setattr__(tree, _RESULT, self)
        return tree

    def write(
        self,
        folder: Path,
        *,
        draws: int | None = None,
        paper: bool = False,
        progress: ProgressCallback = no_progress,
    ) -> Summary:
        """Write a run directory, and return what its ``summary.json`` holds.

        Nothing is left behind if the folder cannot be written. ``draws`` makes it a light one, see
        :func:`~bayesfric.report.run_directory.write_run`; ``paper`` adds LaTeX, and figures as PDF
        and PNG.
        """
        from bayesfric.report.run_directory import write_run  # brings Matplotlib with it

        config, recordings = self.model.config, self.recordings
        # tables in memory are saved in the run
        files = {
            recording.source.name or f"recording-{n}": (saved_name(n), recording)
            for n, recording in enumerate(self.model.given, start=1)
            if recording.table is not None
        }
        with TemporaryDirectory() as name:
            for k, measured in enumerate(recordings):
                if measured.name in files:
                    file, recording = files[measured.name]
                    saved = Path(name, file)
                    saved.parent.mkdir(exist_ok=True)
                    recording.saved(saved)
                    recordings[k] = replace(measured, path=folder / file, sha256=sha256(saved))
            origin = config.origin_of(recordings, folder if self.model.given else config.folder)
            summary = self.summary.model_copy(update={"source": origin.model_dump(mode="json")})
            write_run(
                folder,
                self.fit,
                summary,
                config.text,
                recordings,
                Path(name),
                draws,
                paper=paper,
                progress=progress,
            )
        return summary


def result_of(posterior: Any) -> Result:
    """Return the result of a posterior that :meth:`bayesfric.Model.sample` returned."""
    if isinstance(posterior, Result):
        return posterior
    result = getattr(posterior, _RESULT, None)
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
