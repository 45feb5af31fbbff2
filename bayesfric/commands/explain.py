"""``bayesfric explain``: what else explains the torque, and the configuration with it put in."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bayesfric.base.errors import BadInput
from bayesfric.diagnostics.before_a_fit import little_explained
from bayesfric.diagnostics.explanation import Explanation
from bayesfric.diagnostics.finding import Finding
from bayesfric.fit.model import Model
from bayesfric.report.terminal import wrapped
from bayesfric.report.words import clause, doubt_text, filled, line_of


def explain_record(found: Explanation, model: Model) -> dict[str, Any]:
    """Put a ranking into the form that ``--json`` prints."""
    return {"config": str(model.config.path), **found.as_json()}


def explain_text(
    found: Explanation, model: Model, taken: Sequence[Finding] = (), path: Path | None = None
) -> list[str]:
    """Word a ranking: what was put in, what is found, and what this motion does not tell.

    ``path`` is the file that ``model`` was written to, with what was ``taken``.
    """
    text = filled(
        "explain.txt.j2",
        found=found,
        warnings=map(doubt_text, little_explained(model.chain, model.observations)),
        lines=[_line(one) for one in found.findings],
        taken=[f"Put in: {_line(one)}" for one in taken],
        untold=", ".join(clause(kind) for kind in found.untold),
        path=path,
        names=model.chain.names,
    )
    return [part for line in text.splitlines() for part in wrapped(line, indent=3)]


def _line(one: Finding) -> str:
    """Say a finding, what it moves and what looks like it in this motion."""
    told = one.as_dict()
    moves = ", ".join(f"{name} {by:+.1f}" for name, by in list(one.moves.items())[:3])
    more = f"; moves {moves} standard deviations" if moves else ""
    rivals = ", ".join(clause(kind) for kind in one.rivals[:3])
    return line_of(one.kind, told) + more + (f"; looks like {rivals}" if rivals else "")


def refuse_other_place(path: Path, given: Model) -> None:
    """Refuse, before anything is computed, a file that cannot be the configuration's neighbour.

    Raises
    ------
    BadInput
        If it is no TOML, lies elsewhere, where names of files mean something else, or is there.
    """
    folder = given.config.path.parent
    if path.suffix != ".toml":
        raise BadInput(str(path), "is not named .toml", "name a configuration: BETTER.toml")
    if path.resolve().parent != folder.resolve():
        what = "is not beside the configuration, whose recordings are named from there"
        raise BadInput(str(path), what, f"write it to {folder / path.name}")
    if path.exists():
        raise BadInput(str(path), "is there already", "name another file")


def completed_record(
    found: Model, taken: Sequence[Finding], left: Explanation, path: Path
) -> dict[str, Any]:
    """Put what was put in, and what is left, into the form that ``--json`` prints."""
    told = {"taken": [one.as_dict() for one in taken], "written": str(path)}
    return explain_record(left, found) | told
