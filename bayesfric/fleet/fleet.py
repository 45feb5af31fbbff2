"""A fleet: many units fitted by one template, and their population."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

from filelock import FileLock, Timeout
from pydantic import BaseModel, ValidationError

from bayesfric.base.atomic_write import write_files
from bayesfric.base.errors import BadInput
from bayesfric.base.options import configuration_error
from bayesfric.base.progress import Progress, ProgressCallback, progress_shown
from bayesfric.fleet.plan import (
    FAILED,
    ClusterOptions,
    Plan,
    RunOptions,
    Template,
    read_plan,
    read_template,
    read_units,
    units_of,
)
from bayesfric.fleet.results import FleetPopulation, fleet_population, results_table
from bayesfric.fleet.workers import check_dask, fit_units, is_fitted
from bayesfric.report.summary.record import Summary, read_summary_file

if TYPE_CHECKING:
    import pandas as pd

# Files of a fleet's folder.
PLAN, TABLE, UNITS, LOCK = "fleet.toml", "results.parquet", "units", ".lock"


@dataclass(frozen=True)
class FleetRun:
    """Outcome of a fleet."""

    folder: Path
    units: int
    again: int  # units that were finished before
    failed: Mapping[str, str]  # units whose configuration or recordings cannot be used, and why
    left: Mapping[str, str]  # units whose worker failed, and how
    outcomes: Mapping[str, int]  # number of units by the outcome of their fits
    seconds: float  # by the clock
    cpu_seconds: float  # of this process, and of all workers on units
    population: FleetPopulation

    @property
    def frame(self) -> pd.DataFrame:
        """The table of results, a row for each unit and quantity."""
        import pandas as pd

        return pd.read_parquet(self.folder / TABLE)

    def as_json(self) -> dict[str, Any]:
        """Give the output of ``bayesfric fleet --json``."""
        return {
            "folder": str(self.folder),
            "units": self.units,
            "again": self.again,
            "outcomes": dict(self.outcomes),
            "failed": dict(self.failed),
            "left": dict(self.left),
            "seconds": self.seconds,
            "cpu_seconds": self.cpu_seconds,
            **self.population.as_json(),
        }


class Fleet:
    """The same fit of many units: joints, days, or both.

    Parameters
    ----------
    template
        A configuration as nested dicts, or the file of one, with ``{column}`` in its texts.
    units
        A unit in each row: a data frame, a mapping of columns, or a CSV file.
    name
        Pattern of the units' names, such as ``"{serial}-{day}"``; the column ``unit`` if left out.
    runs, cluster
        The tables of a ``FLEET.toml``, as dicts of the same keys.

    Raises
    ------
    BadInput
        If no unit can be fitted.
    """

    def __init__(
        self,
        template: Mapping[str, Any] | Path | str,
        units: Any,
        *,
        name: str | None = None,
        runs: Mapping[str, Any] | None = None,
        cluster: Mapping[str, Any] | None = None,
    ) -> None:
        if isinstance(template, Mapping):
            read = Template(Path("template").absolute(), dict(template))
        else:
            read = read_template(Path(template))
        if isinstance(units, str | Path):
            rows = read_units(Path(units), name)
        else:
            import pandas as pd

            rows = units_of(pd.DataFrame(units), name, "units", first_row=1)
        self.plan = Plan(
            Path("Fleet"),
            read,
            rows,
            _options(RunOptions, runs or {}, "runs"),
            _options(ClusterOptions, cluster or {}, "cluster"),
        ).checked()

    @classmethod
    def from_config(cls, path: Path | str) -> Self:
        """Read a ``FLEET.toml``."""
        fleet = cls.__new__(cls)
        fleet.plan = read_plan(Path(path))
        return fleet

    def run(
        self,
        folder: Path | str,
        *,
        workers: int | None = None,
        scheduler: Any = None,
        resume: bool = False,
        progress: bool | ProgressCallback = False,
    ) -> FleetRun:
        """Fit every unit that is not finished.

        Parameters
        ----------
        folder
            Folder to make, or with ``resume`` to continue.
        workers
            Processes on this machine.
        scheduler
            Address of a running Dask scheduler, or a cluster object of Dask's, such as
            dask-jobqueue's ``SLURMCluster``; its workers need access to the same files.
        resume
            Fit only units that are missing, failed, or whose configuration or recording changed.
        progress
            Whether to show a bar, or a callback.

        Raises
        ------
        BadInput
            If the folder is not empty or cannot be written, or no scheduler answers.
        """
        start, folder = time.monotonic(), Path(folder).absolute()
        arguments = {"workers": workers, "scheduler": scheduler}
        update = {key: value for key, value in arguments.items() if value is not None}
        options = self.plan.cluster.model_copy(update=update)
        _check(folder, resume=resume)
        check_dask(options)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with FileLock(folder / LOCK).acquire(timeout=0), progress_shown(progress) as report:
                write_files({folder / PLAN: _text(self.plan)}, replace=True)
                result = self._run(folder, options, report, start)
                (folder / LOCK).unlink(missing_ok=True)
                return result
        except Timeout:
            problem = "another process is fitting this fleet"
            raise BadInput(str(folder), problem, "wait for it, or name another folder") from None
        except OSError as error:
            problem = f"cannot be written ({error.strerror or error})"
            raise BadInput(str(folder), problem, "correct that, then use --resume") from None

    def _run(
        self, folder: Path, options: ClusterOptions, progress: ProgressCallback, start: float
    ) -> FleetRun:
        """Fit the units that are missing, and write table, population and page of all."""
        from bayesfric.fleet.page import fleet_page

        plan = self.plan
        cpu_seconds = -time.process_time()
        failed, left, waiting = dict[str, str](), dict[str, str](), dict[str, str]()
        again = 0
        for unit in plan.units:
            try:
                text = plan.template.filled(unit)
            except BadInput as error:  # an empty cell
                failed[unit.name] = str(error)
                continue
            if is_fitted(folder / UNITS / unit.name, text, plan.template.path):
                again += 1
            else:
                waiting[unit.name] = text
        done = again + len(failed)

        def finished(name: str, why: str, by_machine: bool, seconds: float) -> None:
            nonlocal cpu_seconds, done
            cpu_seconds += seconds
            done += 1
            if why:
                (left if by_machine else failed)[name] = why
            counts = f"{done} of {len(plan.units)} units, {len(failed) + len(left)} failed"
            progress(Progress(counts))

        draws = plan.runs.draws if plan.runs.light else None
        if waiting:
            fit_units(waiting, folder / UNITS, plan.template.path, draws, options, finished)
        progress(Progress("population"))
        errors = failed | {name: f"machine: {why}" for name, why in left.items()}
        folders = {u.name: folder / UNITS / u.name for u in plan.units if u.name not in errors}
        runs = {
            name: Summary.read(read_summary_file(path), str(path)) for name, path in folders.items()
        }
        population = fleet_population(folder / UNITS, runs)
        table = results_table(plan.units, runs, errors)
        (folder / TABLE).write_bytes(table.to_parquet(index=False))
        page = fleet_page(folder, plan.units, runs, errors, population)
        record = json.dumps(population.as_json(), indent=1, ensure_ascii=False, allow_nan=False)
        texts = {folder / "population.json": f"{record}\n", folder / "fleet.html": page}
        write_files(texts, replace=True)
        outcomes = Counter(
            FAILED if unit.name in errors else runs[unit.name].verdict.outcome
            for unit in plan.units
        )
        return FleetRun(
            folder=folder,
            units=len(plan.units),
            again=again,
            failed={unit.name: failed[unit.name] for unit in plan.units if unit.name in failed},
            left=left,
            outcomes=dict(outcomes),
            seconds=time.monotonic() - start,
            cpu_seconds=cpu_seconds + time.process_time(),
            population=population,
        )


Table = TypeVar("Table", bound=BaseModel)


def _options(kind: type[Table], keys: Mapping[str, Any], name: str) -> Table:
    try:
        return kind.model_validate(dict(keys), strict=True)
    except ValidationError as error:
        raise configuration_error(f"Fleet: {name}.", name, error, keys, kind) from None


def _check(folder: Path, *, resume: bool) -> None:
    """Refuse a folder that is not empty, or has no fleet to resume."""
    if folder.exists() and not folder.is_dir():
        raise BadInput(str(folder), "is a file", "name a folder with -o")
    has_fleet = (folder / PLAN).is_file()
    if resume and not has_fleet:
        raise BadInput(str(folder), "there is no fleet to resume", "leave --resume out")
    # hidden files are of a process that was killed at its start
    occupied = folder.exists() and any(path.name[0] != "." for path in folder.iterdir())
    if not resume and occupied:
        hint = "add --resume to continue, or name another with -o" if has_fleet else ""
        raise BadInput(str(folder), "is not empty", hint or "name another folder with -o")


def _text(plan: Plan) -> str:
    """Write the record of a fleet's template, units and options."""
    from bayesfric.problem.config import document_text

    runs = plan.runs.model_dump()
    units = {"count": len(plan.units)}
    return document_text({"template": plan.template.document, "units": units, "runs": runs})
