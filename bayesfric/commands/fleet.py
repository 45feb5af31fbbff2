"""``bayesfric fleet``: the same fit of many units."""

from __future__ import annotations

from pathlib import Path

from bayesfric.base.errors import Interrupted
from bayesfric.base.progress import Shown, silent
from bayesfric.commands.unfinished import asked_to_stop
from bayesfric.fleet.fleet import PLAN, Fleet, FleetRun
from bayesfric.population.population import Interval
from bayesfric.report.words import filled


def fleet(
    path: Path,
    folder: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    progress: Shown = silent,
) -> FleetRun:
    """Work through what a ``FLEET.toml`` names.

    Ctrl-C and SIGTERM leave a folder to go on with.
    """
    plan = Fleet.from_config(path)
    with asked_to_stop(lambda: False) as asked:
        try:
            return plan.run(
                folder, workers=workers, scheduler=scheduler, resume=resume, progress=progress
            )
        except KeyboardInterrupt:
            done = sum(1 for _ in folder.glob("units/*/unit.json"))
            kept = f"{done} of {len(plan.plan.units)} units are" if (folder / PLAN).exists() else ""
            raise Interrupted(asked.by, saved=done, kept=kept) from None


def fleet_text(found: FleetRun) -> list[str]:
    """Say what came of it."""
    return filled("fleet.txt.j2", found=found, span=_span).splitlines()


def _span(one: Interval) -> str:
    return f"{one.median:.4g} [{one.low:.4g}, {one.high:.4g}]"
