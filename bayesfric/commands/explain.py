"""``bayesfric explain``: what else explains the torque, and the configuration with it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bayesfric.base.atomic_write import write_files
from bayesfric.base.errors import BadInput
from bayesfric.base.progress import ProgressCallback, no_progress
from bayesfric.diagnostics.before_a_fit import little_explained
from bayesfric.diagnostics.regression import Finding
from bayesfric.fit.model import Model
from bayesfric.report.terminal import wrapped
from bayesfric.report.words import clause, doubt_text, filled, line_of


def explain(
    model: Model, output: Path | None = None, *, progress: ProgressCallback = no_progress
) -> tuple[dict[str, Any], list[str]]:
    """Return the record and lines of text.

    ``output`` is a file to write next to the configuration, with the missing terms.
    """
    completed: dict[str, Any] = {}
    included: Sequence[Finding] = ()
    if output is None:
        explained = model.explain(progress=progress)
    else:
        _check_output(output, model.config.path.parent)
        model, included, explained = model.completed(progress=progress)
        write_files({output: model.config.text})
        completed = {"taken": [finding.as_dict() for finding in included], "written": str(output)}
    text = filled(
        "explain.txt.j2",
        found=explained,
        warnings=map(doubt_text, little_explained(model.chain, model.observations)),
        lines=[_line(finding) for finding in explained.findings],
        taken=[f"Put in: {_line(finding)}" for finding in included],
        indistinguishable=", ".join(clause(kind) for kind in explained.indistinguishable),
        path=output,
        names=model.chain.names,
    )
    lines = [part for line in text.splitlines() for part in wrapped(line, indent=3)]
    return {"config": str(model.config.path), **explained.as_json(), **completed}, lines


def _line(finding: Finding) -> str:
    """Describe a finding, its shifts and its rivals."""
    values = finding.as_dict()
    moves = ", ".join(f"{name} {by:+.1f}" for name, by in list(finding.moves.items())[:3])
    effect = f"; moves {moves} standard deviations" if moves else ""
    rivals = ", ".join(clause(kind) for kind in finding.rivals[:3])
    return line_of(finding.kind, values) + effect + (f"; looks like {rivals}" if rivals else "")


def _check_output(path: Path, folder: Path) -> None:
    if path.suffix != ".toml":
        raise BadInput(str(path), "is not named .toml", "name a configuration: BETTER.toml")
    if path.resolve().parent != folder.resolve():
        what = "is not in the configuration's folder, which its files are relative to"
        raise BadInput(str(path), what, f"write it to {folder / path.name}")
    if path.exists():
        raise BadInput(str(path), "exists", "name another file")
