"""``bayesfric explain``: what else explains the torque, and the configuration with it put in."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bayesfric.base.atomic_write import write_files
from bayesfric.base.errors import BadInput
from bayesfric.base.progress import Shown, silent
from bayesfric.diagnostics.before_a_fit import little_explained
from bayesfric.diagnostics.finding import Finding
from bayesfric.fit.model import Model
from bayesfric.report.terminal import wrapped
from bayesfric.report.words import clause, doubt_text, filled, line_of


def explain(
    model: Model, output: Path | None = None, *, progress: Shown = silent
) -> tuple[dict[str, Any], list[str]]:
    """Give what ``--json`` prints, and words: what is found, and what this motion does not tell.

    ``output`` is a file to write beside the configuration, with what explains the torque put in.
    """
    told: dict[str, Any] = {}
    taken: Sequence[Finding] = ()
    if output is None:
        found = model.explain(progress=progress)
    else:
        _refuse_other_place(output, model.config.path.parent)
        model, taken, found = model.completed(progress=progress)
        write_files({output: model.config.text})
        told = {"taken": [one.as_dict() for one in taken], "written": str(output)}
    text = filled(
        "explain.txt.j2",
        found=found,
        warnings=map(doubt_text, little_explained(model.chain, model.observations)),
        lines=[_line(one) for one in found.findings],
        taken=[f"Put in: {_line(one)}" for one in taken],
        indistinguishable=", ".join(clause(kind) for kind in found.indistinguishable),
        path=output,
        names=model.chain.names,
    )
    lines = [part for line in text.splitlines() for part in wrapped(line, indent=3)]
    return {"config": str(model.config.path), **found.as_json(), **told}, lines


def _line(one: Finding) -> str:
    """Say a finding, what it moves and what looks like it in this motion."""
    told = one.as_dict()
    moves = ", ".join(f"{name} {by:+.1f}" for name, by in list(one.moves.items())[:3])
    more = f"; moves {moves} standard deviations" if moves else ""
    rivals = ", ".join(clause(kind) for kind in one.rivals[:3])
    return line_of(one.kind, told) + more + (f"; looks like {rivals}" if rivals else "")


def _refuse_other_place(path: Path, folder: Path) -> None:
    if path.suffix != ".toml":
        raise BadInput(str(path), "is not named .toml", "name a configuration: BETTER.toml")
    if path.resolve().parent != folder.resolve():
        what = "is not beside the configuration, whose recordings are named from there"
        raise BadInput(str(path), what, f"write it to {folder / path.name}")
    if path.exists():
        raise BadInput(str(path), "is there already", "name another file")
