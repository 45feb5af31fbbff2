"""``bayesfric export``: a finished run in a simulator's files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayesfric.export.exported import Exported, check_output, export


def export_run(
    run: Path, to: str, output: Path | None, *, force: bool, **options: Any
) -> tuple[Exported, list[str]]:
    """Export a run and write it; give what it says, and what was written."""
    place = output or Path(f"{run.resolve().name}-{to}")
    check_output(place, force=force)
    found = export(run, to, **options)
    return found, found.write(place, force=force)
