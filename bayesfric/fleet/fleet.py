"""A fleet, worked through and gone on with."""

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
from bayesfric.base.progress import Progress, Shown, progress_shown
from bayesfric.fleet.crew import check_engine, work_through
from bayesfric.fleet.fleet_population import FleetPopulation, fleet_population
from bayesfric.fleet.fleet_units import read_units, units_of
from bayesfric.fleet.plan import (
    ClusterOptions,
    Plan,
    RunOptions,
    Template,
    read_plan,
    read_template,
)
from bayesfric.fleet.results import FAILED, Record, Results, failure
from bayesfric.fleet.work import Done, Task

if TYPE_CHECKING:
    import pandas as pd

# Files of a fleet's folder.
PLAN, TABLE, UNITS, LOCK = "fleet.toml", "results.parquet", "units", ".lock"


@dataclass(frozen=True)
class FleetRun:
    """What came of a fleet."""

    folder: Path
    units: int
    again: int  # were finished before
    failed: Mapping[str, str]  # units by the line that says why
    left: Mapping[str, str]  # those that the machine failed; --resume tries them again
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
        """Give what ``bayesfric fleet --json`` prints."""
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
        A unit a row: a data frame, a mapping of columns, or a CSV file.
    name
        What units are called, such as ``"{serial}-{day}"``; the column ``unit`` if left out.
    runs, cluster
        The tables of a ``FLEET.toml``, as dicts of the same keys.

    Raises
    ------
    BadInput
        For anything that fits no unit.
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
            made = Template(Path("template").absolute(), dict(template))
        else:
            made = read_template(Path(template))
        if isinstance(units, str | Path):
            rows = read_units(Path(units), name)
        else:
            import pandas as pd

            rows = units_of(pd.DataFrame(units), name, "units", first_row=1)
        self.plan = Plan(
            Path("Fleet"),
            made,
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
        progress: bool | Shown = False,
    ) -> FleetRun:
        """Fit every unit that is not done.

        Parameters
        ----------
        folder
            To make, or with ``resume`` to go on in.
        workers
            Processes on this machine.
        scheduler
            Address of a running Dask scheduler, or in Python a cluster object of Dask's, such as
            dask-jobqueue's ``SLURMCluster``; its workers see the same files.
        resume
            Do only what is missing, or has changed since.
        progress
            Whether to show a bar, or what to call as work goes on.

        Raises
        ------
        BadInput
            If the folder is not free, or cannot be written to; or no scheduler answers.
        """
        began, folder = time.monotonic(), Path(folder).absolute()
        given = {"workers": workers, "scheduler": scheduler}
        told = {key: value for key, value in given.items() if value is not None}
        options = self.plan.cluster.model_copy(update=told)
        _check(folder, resume=resume)
        check_engine(options)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with FileLock(folder / LOCK).acquire(timeout=0), progress_shown(progress) as tell:
                write_files({folder / PLAN: _text(self.plan)}, replace=True)
                course = _Course(self.plan, Results(folder / TABLE, self.plan.units), tell)
                tasks = course.tasks(folder / UNITS)
                work_through(tasks, options, course.arrived)
                found = course.end(folder, began)
                (folder / LOCK).unlink(missing_ok=True)
                return found
        except Timeout:
            what = "another process works on this fleet"
            raise BadInput(str(folder), what, "wait for it, or name another folder") from None
        except OSError as error:
            what = f"cannot be written ({error.strerror or error})"
            raise BadInput(str(folder), what, "mend that, then go on with --resume") from None


Chosen = TypeVar("Chosen", bound=BaseModel)


def _options(kind: type[Chosen], given: Mapping[str, Any], name: str) -> Chosen:
    try:
        return kind.model_validate(dict(given), strict=True)
    except ValidationError as error:
        raise configuration_error(f"Fleet: {name}.", name, error, given, kind) from None


def _check(folder: Path, *, resume: bool) -> None:
    """Refuse a folder that is not free, or holds no fleet to go on with."""
    if folder.exists() and not folder.is_dir():
        raise BadInput(str(folder), "is a file", "name a folder with -o")
    there = (folder / PLAN).is_file()
    if resume and not there:
        raise BadInput(str(folder), "there is no fleet to resume", "leave --resume out")
    # hidden is what a killed process left before it had begun
    held = folder.exists() and any(path.name[0] != "." for path in folder.iterdir())
    if not resume and held:
        mend = "add --resume to do what is missing, or name another with -o" if there else ""
        raise BadInput(str(folder), "is not empty", mend or "name another folder with -o")


def _text(plan: Plan) -> str:
    """Keep what the fleet was made of."""
    from bayesfric.problem.config_text import document_text

    told = plan.runs.model_dump()
    units = {"count": len(plan.units)}
    return document_text({"template": plan.template.document, "units": units, "runs": told})


class _Course:
    """How far a fleet is."""

    def __init__(self, plan: Plan, results: Results, tell: Shown) -> None:
        self.plan, self.results, self._tell = plan, results, tell
        self.again, self.left = 0, dict[str, str]()
        self._cpu_seconds = -time.process_time()

    def tasks(self, folder: Path) -> list[Task]:
        """Fill the template for each unit; one with an empty cell has failed already."""
        tasks: list[Task] = []
        draws = self.plan.runs.draws if self.plan.runs.light else None
        for unit in self.plan.units:
            try:
                text = self.plan.template.filled(unit)
            except BadInput as error:
                self.results.records[unit.name] = failure(str(error))
                continue
            tasks.append(
                {
                    "name": unit.name,
                    "text": text,
                    "place": str(self.plan.template.path),
                    "folder": str(folder / unit.name),
                    "draws": draws,
                }
            )
        return tasks

    def arrived(self, name: str, done: Done | str) -> None:
        """Take what came of a unit."""
        if isinstance(done, str):
            self.left[name] = done
            record: Record = failure(f"machine: {done}")
        else:
            record = done["record"]
            self.again += done["again"]
            self._cpu_seconds += done["cpu_seconds"]
        self.results.add(name, record)
        self._tell(Progress(self._words()))

    def _words(self) -> str:
        records = self.results.records
        done, failed = len(records), sum(r["outcome"] == FAILED for r in records.values())
        return f"{done} of {len(self.plan.units)} units, {failed} failed"

    def end(self, folder: Path, began: float) -> FleetRun:
        """Sum it up, and write what the units are together: tables, figures, the page."""
        from bayesfric.fleet.page import draw, fleet_page

        self._tell(Progress("population"))
        self.results.write()
        plan, records = self.plan, self.results.records
        found = fleet_population(folder / UNITS, [unit.name for unit in plan.units])
        page = fleet_page(folder, plan.units, records, found, draw(folder, found))
        made = json.dumps(found.as_json(), indent=1, ensure_ascii=False, allow_nan=False)
        texts = {folder / "population.json": f"{made}\n", folder / "fleet.html": page}
        write_files(texts, replace=True)
        ordered = [(unit.name, records[unit.name]) for unit in plan.units]
        failed = {name: r["error"] for name, r in ordered if r["outcome"] == FAILED}
        return FleetRun(
            folder=folder,
            units=len(ordered),
            again=self.again,
            failed={name: why for name, why in failed.items() if name not in self.left},
            left=self.left,
            outcomes=dict(Counter(record["outcome"] for _, record in ordered)),
            seconds=time.monotonic() - began,
            cpu_seconds=self._cpu_seconds + time.process_time(),
            population=found,
        )
