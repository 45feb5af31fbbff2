"""``bayesfric explain -o BETTER.toml``: the configuration with what else explains the torque."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from bayesfric.diagnostics.finding import Finding
from bayesfric.errors import BadInput
from bayesfric.model import Model
from bayesfric.report.alerts import doubt_text


def refuse_other_place(path: Path, given: Model) -> None:
    """Refuse, before anything is computed, a file that cannot be the configuration's neighbour.

    Raises
    ------
    BadInput
        If it would lie elsewhere, where names of files mean something else, or is there already.
    """
    folder = given.config.path.parent
    if path.resolve().parent != folder.resolve():
        what = "is not beside the configuration, whose recordings are named from there"
        raise BadInput(str(path), what, f"write it to {folder / path.name}")
    if path.exists():
        raise BadInput(str(path), "is there already", "name another file")


def completed_record(
    found: Model, taken: Sequence[Finding], left: Sequence[Finding], path: Path
) -> dict[str, Any]:
    """Put what was found into the form that ``--json`` prints."""
    told = {"config": str(found.config.path), "written": str(path)}
    rows = {"taken": taken, "left": left}
    return told | {name: [one.as_dict() for one in of] for name, of in rows.items()}


def completed_text(
    found: Model, taken: Sequence[Finding], left: Sequence[Finding], path: Path
) -> Iterator[str]:
    """Say what was put in, and what is left."""
    if not taken:
        yield "Nothing that a key puts in explains this torque better than chance does."
    for first, of in (("Put in", taken), ("Left", left)):
        for one in of:
            yield f"{first}: {doubt_text(one.as_dict() | {'kind': 'missing', 'what': one.kind})}"
    yield f"{path}: {', '.join(found.chain.names)}"
