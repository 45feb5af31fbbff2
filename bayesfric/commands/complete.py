"""``bayesfric explain -o BETTER.toml``: the configuration with what else explains the torque."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from bayesfric.diagnostics.finding import Finding
from bayesfric.errors import BadInput
from bayesfric.model import Model
from bayesfric.report.alerts import doubt_text
from bayesfric.report.files import parents_made, unwritable


def completed_file(path: Path, given: Model) -> Path:
    """Settle where the configuration goes, before anything is computed.

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
    return path


def write_completed(found: Model, path: Path) -> None:
    """Write the configuration of the model that was found."""
    try:
        with parents_made(path):
            aside = path.with_name(f".{path.name}.part")
            aside.write_text(found.config.text, encoding="utf-8")
            aside.replace(path)
    except OSError as error:
        raise unwritable(path, error, "file") from None


def completed_record(
    found: Model, taken: Sequence[Finding], left: Sequence[Finding], path: Path
) -> dict[str, Any]:
    """Put what was found into the form that ``--json`` prints."""
    rows = {name: [one.as_dict() for one in of] for name, of in _both(taken, left)}
    return {"config": str(found.config.path), "written": str(path), **rows}


def completed_text(
    found: Model, taken: Sequence[Finding], left: Sequence[Finding], path: Path
) -> Iterator[str]:
    """Say what was put in, and what is left."""
    if not taken:
        yield "Nothing that a key puts in explains this torque better than chance does."
    for name, of in _both(taken, left):
        for one in of:
            words = doubt_text(one.as_dict() | {"kind": "missing", "what": one.kind})
            yield f"{'Put in' if name == 'taken' else 'Left'}: {words}"
    joint = ", ".join(found.chain.names)
    yield f"{path}: {joint}"


def _both(
    taken: Sequence[Finding], left: Sequence[Finding]
) -> tuple[tuple[str, Sequence[Finding]], ...]:
    return ("taken", taken), ("left", left)
