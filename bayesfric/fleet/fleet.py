"""A fleet: many units fitted by one template, and their population."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from bayesfric.base.atomic_write import check_output_folder, run_lock, write_files
from bayesfric.base.errors import BadInput
from bayesfric.base.progress import Progress, ProgressCallback, progress_shown
from bayesfric.fleet.plan import FAILED, ClusterOptions, read_plan, read_units, units_of
from bayesfric.fleet.results import (
    FleetQuantity,
    fleet_population,
    population_record,
    results_table,
)
from bayesfric.fleet.workers import check_dask, fit_units, is_fitted
from bayesfric.problem.config import document_text
from bayesfric.report.summary.record import Summary, read_summary_file

if TYPE_CHECKING:
    import pandas as pd

# Files of a fleet's folder.
PLAN, TABLE, UNITS = "fleet.toml", "results.parquet", "units"


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
    population: Sequence[FleetQuantity]

    @property
    def frame(self) -> pd.DataFrame:
        """The table of results, a row for each unit and quantity."""
        import pandas as pd

        return pd.read_parquet(self.folder / TABLE)

    @property
    def outliers(self) -> list[dict[str, Any]]:
        """Units that are likelier outliers than not."""
        return list(population_record(self.population)["outliers"])

    def as_json(self) -> dict[str, Any]:
        """Give the output of ``bayesfric fleet --json``."""
        fields = {key: value for key, value in vars(self).items() if key != "population"}
        return fields | {"folder": str(self.folder)} | population_record(self.population)


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
        if isinstance(units, str | Path):
            rows = read_units(Path(units), name)
        else:
            import pandas as pd

            rows = units_of(pd.DataFrame(units), name, "units", first_row=1)
        if not isinstance(template, Mapping):
            template = str(Path(template).absolute())
        tables = {"template": template, "units": {"table": "units"}}
        text = document_text(tables | {"runs": runs or {}, "cluster": cluster or {}})
        self.plan = read_plan(Path("Fleet"), text, rows)

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
        options = self.plan.cluster.model_copy(
            update={key: value for key, value in arguments.items() if value is not None}
        )
        if resume != (folder / PLAN).is_file():
            problem = "there is no fleet to resume" if resume else "holds a fleet"
            hint = "leave --resume out" if resume else "add --resume, or name another folder"
            raise BadInput(str(folder), problem, hint)
        if not resume:
            check_output_folder(folder, force=None)
        check_dask(options)
        # what the table was made of: template, number of units and options
        record = {"template": self.plan.document, "units": {"count": len(self.plan.units)}}
        text = document_text(record | {"runs": self.plan.runs.model_dump()})
        with run_lock(folder), progress_shown(progress) as report:
            write_files({folder / PLAN: text}, replace=True)
            return self._run(folder, options, report, start)

    def _run(
        self, folder: Path, options: ClusterOptions, progress: ProgressCallback, start: float
    ) -> FleetRun:
        """Fit the units that are missing, and write table, population and page of all."""
        from bayesfric.fleet.page import fleet_page

        plan, names = self.plan, [unit.name for unit in self.plan.units]
        cpu_seconds = -time.process_time()
        failed, left, waiting = dict[str, str](), dict[str, str](), dict[str, str]()
        for unit in plan.units:
            try:
                text = plan.configuration(unit)
            except BadInput as error:  # an empty cell
                failed[unit.name] = str(error)
                continue
            if not is_fitted(folder / UNITS / unit.name, text, plan.template):
                waiting[unit.name] = text
        again = len(names) - len(failed) - len(waiting)
        draws = plan.runs.draws if plan.runs.light else None
        fits = fit_units(waiting, folder / UNITS, plan.template, draws, options)
        for done, (name, why, by_machine, seconds) in enumerate(fits, again + len(failed) + 1):
            cpu_seconds += seconds
            if why:
                (left if by_machine else failed)[name] = why
            counts = f"{done} of {len(names)} units, {len(failed) + len(left)} failed"
            progress(Progress(counts))
        progress(Progress("population"))
        errors = failed | {name: f"machine: {why}" for name, why in left.items()}
        runs = {}
        for name in (name for name in names if name not in errors):
            path = folder / UNITS / name
            runs[name] = Summary.read(read_summary_file(path), str(path))
        population = fleet_population(runs)
        table = results_table(plan.units, runs, errors)
        (folder / TABLE).write_bytes(table.to_parquet(index=False))
        record = population_record(population)
        text = json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False)
        page = fleet_page(folder, plan.units, runs, errors, population)
        texts = {folder / "population.json": f"{text}\n", folder / "fleet.html": page}
        write_files(texts, replace=True)
        outcomes = Counter(
            FAILED if name in errors else runs[name].verdict.outcome for name in names
        )
        return FleetRun(
            folder=folder,
            units=len(names),
            again=again,
            failed={name: failed[name] for name in names if name in failed},
            left=left,
            outcomes=dict(outcomes),
            seconds=time.monotonic() - start,
            cpu_seconds=cpu_seconds + time.process_time(),
            population=population,
        )
