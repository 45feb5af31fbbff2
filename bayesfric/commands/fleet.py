"""``bayesfric fleet``: the same fit of many units."""

from __future__ import annotations

from pathlib import Path

from bayesfric.base.errors import Interrupted
from bayesfric.base.progress import Shown, silent
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

    :class:`Interrupted` where Ctrl-C or SIGTERM leaves a folder to go on with.
    """
    plan = Fleet.from_config(path)
    try:
        return plan.run(
            folder, workers=workers, scheduler=scheduler, resume=resume, progress=progress
        )
    except KeyboardInterrupt:
        if not (folder / PLAN).exists():
            raise
        done = sum(1 for _ in folder.glob("units/*/unit.toml"))
        raise Interrupted(f"{done} of {len(plan.plan.units)} units are kept") from None


def fleet_text(found: FleetRun) -> list[str]:
    """Say what came of it."""
    return filled("fleet.txt.j2", found=found, span=_span).splitlines()


def _span(one: Interval) -> str:
    return f"{one.median:.4g} [{one.low:.4g}, {one.high:.4g}]"
