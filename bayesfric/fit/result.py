"""Result of a fit: sampled by a model, or read back from a run directory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from bayesfric.base.atomic_write import check_output_folder
from bayesfric.base.errors import BadInput
from bayesfric.base.progress import ProgressCallback, no_progress
from bayesfric.base.safe_read import open_hdf5, read_array
from bayesfric.inference.fitting import Fit
from bayesfric.inference.noise import NoiseChoice
from bayesfric.inference.posterior import Diagnostics, Posterior, Status, predict_held_out
from bayesfric.mechanism.joint import Joint
from bayesfric.problem.config_text import saved_name
from bayesfric.problem.problem import Problem
from bayesfric.recordings.arrays import Array
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
    """A model, the summary of its posterior, and draws that allow for model discrepancy."""

    model: Problem
    summary: Summary  # of ``summary.json``; after a fit without the place of recordings
    name: str  # of the run, for messages and captions
    draws: Array  # (n, len(names)) in SI units
    sampled: Fit | None = None  # draws, point estimates and predictions of a fit in this process
    folder: Path | None = None  # run directory that it was read from

    @classmethod
    def of_fit(cls, model: Problem, fit: Fit, summary: Summary) -> Result:
        """Return the result of sampling a model."""
        return cls(model, summary, model.config.path.stem, fit.wide.posterior.flat(), fit)

    @classmethod
    def read(cls, run: Path) -> Result:
        """Read a run directory.

        Raises
        ------
        BadInput
            If it is not complete, or its recordings cannot be read.
        """
        summary = Summary.read(read_summary_file(run), str(run))
        model = Problem.from_config(run / "config.toml")
        groups = _read_draws(run, summary)
        free = [name for name in model.chain.names if not model.priors[name].fixed]
        if missing := [name for name in free if name not in summary.parameters]:
            raise BadInput(
                str(run / "config.toml"), f"{missing[0]} was not sampled", "fit the run again"
            )
        draws = groups.get("widened", groups["posterior"])
        return cls(model, summary, run.resolve().name, _flat(draws), folder=run)

    def __repr__(self) -> str:
        return str(self.summary)

    @property
    def names(self) -> tuple[str, ...]:
        """Sampled parameters in the order of the draws, noise scales last."""
        return tuple(self.summary.parameters)

    @property
    def joint(self) -> Joint:
        """The joint, with the offsets of its recordings."""
        return self.model.chain

    @property
    def recordings(self) -> list[Measurement]:
        """All recordings, also held-out ones."""
        return [*self.model.recordings, *(part.recording for part in self.model.held_out)]

    def picked(self, most: int) -> Array:
        """Return at most so many draws ``(n, len(names))``, evenly spaced."""
        if most >= len(self.draws):
            return self.draws
        return np.asarray(self.draws[np.linspace(0, len(self.draws) - 1, most).astype(int)])

    def values(self, draws: Array) -> Array:
        """Insert fixed parameters: ``(n, d)`` to ``(n, n_parameters)``."""
        parameters = np.empty((len(draws), len(self.joint.names)))
        for k, name in enumerate(self.joint.names):
            if name in self.names:
                parameters[:, k] = draws[:, self.names.index(name)]
            else:
                parameters[:, k] = self.model.priors[name].value
        return parameters

    @cached_property
    def fit(self) -> Fit:
        """The fit; of a run directory made again from draws and recordings, without estimates."""
        if self.sampled is not None:
            return self.sampled
        assert self.folder is not None
        return _restored(self.model, self.summary, _read_draws(self.folder, self.summary))

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


def _read_draws(run: Path, summary: Summary) -> dict[str, dict[str, Array]]:
    """Read the draws of a run's parameters, by group; they are finite and of one shape."""
    path = run / "posterior.nc"
    groups: dict[str, dict[str, Array]] = {}
    try:
        with open_hdf5(path, "fit the run again") as file:
            for group in ("posterior", "widened"):
                if group in file:
                    groups[group] = {n: read_array(file[group][n]) for n in summary.parameters}
            if "sample_stats" in file:
                groups["sample_stats"] = {"lp": read_array(file["sample_stats"]["lp"])}
    except BadInput:
        groups = {}
    whole = len(next((x.shape for x in groups.get("posterior", {}).values()), ())) == 2 and all(
        len({x.shape for x in group.values()}) == 1
        and all(x.size and x.dtype.kind == "f" and np.isfinite(x).all() for x in group.values())
        for group in groups.values()
    )
    if not whole:
        raise BadInput(str(path), "holds no draws of the run's parameters", "fit the run again")
    return groups


def _flat(group: dict[str, Array]) -> Array:
    """Stack the draws of every parameter, ``(n, d)``."""
    return np.stack([x.ravel() for x in group.values()], axis=1).astype(np.float64)


def _restored(model: Problem, summary: Summary, groups: dict[str, dict[str, Array]]) -> Fit:
    """Make a run's fit again from its draws and recordings, without point estimates."""
    sampler, rows = summary.sampler, summary.parameters
    chains = np.stack([*groups["posterior"].values()], axis=-1).astype(np.float64)
    ensembles = sampler.ensembles or 1
    if len(chains) % ensembles:  # the draws of a light run are one chain
        ensembles = 1
    draws = chains.reshape(ensembles, -1, *chains.shape[1:])
    median = np.median(chains.reshape(-1, chains.shape[-1]), axis=0)
    fixed = {n: p.value for n, p in model.priors.items() if p.fixed}
    point = fixed | dict(zip(rows, median.tolist(), strict=True))
    noise = summary.noise
    target = model.target(
        {name: point[name] for name in model.chain.names},
        NoiseChoice(noise.order or 0, (), tuple(noise.memory), noise.room),
    )
    # a walker that never moved has no spread
    moved = np.ptp(draws, axis=2).any(axis=-1)
    posterior = Posterior(
        names=target.names,
        priors=target.priors,
        draws=draws,
        log_density=groups["sample_stats"]["lp"].reshape(draws.shape[:-1]),
        diagnostics=Diagnostics(
            status=cast(Status, sampler.status),
            problems=tuple(sampler.problems),
            rhat=np.array([row.rhat or np.nan for row in rows.values()]),
            ess=np.array([row.ess or np.nan for row in rows.values()]),
            tau=np.full(len(rows), sampler.tau or np.nan),
            acceptance=moved * (sampler.acceptance or 1.0),
            ensembles=ensembles,
            walkers=draws.shape[1],
            warmup=sampler.warmup or 0,
            steps=sampler.steps or draws.shape[2],
            thin=sampler.thin or 1,
            not_finite=sampler.not_finite or 0,
            seconds=sampler.seconds or 0.0,
        ),
        seed=sampler.seed or 0,
    )
    held_out = predict_held_out(target, posterior, model.held_out) if model.held_out else ()
    # they were made in the coordinates that were sampled, which differ here
    widened = _flat(groups["widened"]) if "widened" in groups else None
    return Fit(target, posterior, (), tuple(held_out), widened_draws=widened)


def result_of(posterior: Any) -> Result:
    """Return the result of a posterior of :meth:`bayesfric.Model.sample`, or of a run's folder."""
    if isinstance(posterior, str | Path):
        return Result.read(Path(posterior))
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
