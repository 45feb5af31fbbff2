"""``bayesfric estimate``, ``identify`` and ``explain``: what recordings say without sampling.

Each returns the record for ``--json``, and lines of text.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.base.atomic_write import write_files
from bayesfric.base.errors import BadInput
from bayesfric.base.progress import ProgressCallback, no_progress
from bayesfric.diagnostics.before_a_fit import little_explained
from bayesfric.diagnostics.regression import Finding
from bayesfric.estimates.methods import TITLES
from bayesfric.fit.model import Model
from bayesfric.identifiability.next_recording import ASSUMPTION
from bayesfric.report.summary.summary import estimate_table
from bayesfric.report.terminal import wrapped
from bayesfric.report.words import clause, doubt_text, filled, line_of

Answer = tuple[dict[str, Any], list[str]]


def estimate(
    model: Model, method: str = "all", *, progress: ProgressCallback = no_progress
) -> Answer:
    """Estimate by a method of the paper, or ``all``."""
    methods: Sequence[Any] = () if method == "all" else [method]
    estimates = model.estimates(methods, progress=progress)
    references = model.references
    record = {
        "config": str(model.config.path),
        "estimates": {x.method: estimate_table(x).as_dict() for x in estimates},
        "references": references,
    }
    lines = []
    for estimate in estimates:
        lines += [
            TITLES[estimate.method],
            f"  {estimate.n_outputs} residuals, rms {estimate.residual_rms:.4g} "
            f"{estimate.residual_unit}. {estimate.assumption}.",
            f"  {'':<30} {'value':>11}   {'sd':>9}   {'sd_robust':>9}   {'sd %':>6}",
            *(f"  {_row(v, references.get(v.name), estimate.converged)}" for v in estimate.values),
            *(f"  {note}" for note in estimate.notes),
            "",
        ]
    return record, lines


def _row(v: Any, reference: dict[str, Any] | None, converged: bool) -> str:
    unit = f" {v.unit}" if v.unit else ""
    end = f"{unit}   {reference['source']}: {reference['value']:.5g}" if reference else unit
    if not converged:
        return f"{v.name:<30} {'-':>11}   not converged{end}"
    if v.at_bound:
        return f"{v.name:<30} {v.value:>11.5g}   on its {v.at_bound} bound{end}"
    if not v.determined:
        span = f"; {v.span[0]:.3g} to {v.span[1]:.3g} fit as well" if v.span else ""
        return f"{v.name:<30} {'-':>11}   not determined{span}{end}"
    robust = f"{v.sd_robust:>9.2g}" if np.isfinite(v.sd_robust) else f"{'-':>9}"
    percent = f"{v.relative_sd:>6.1f}" if np.isfinite(v.relative_sd) else f"{'-':>6}"
    small = "   ? sd too small, see sd_robust" if v.sd_robust > 2.0 * v.sd else ""
    return f"{v.name:<30} {v.value:>11.5g} ± {v.sd:>9.2g}   {robust}   {percent}{end}{small}"


def identify(model: Model, *, progress: ProgressCallback = no_progress) -> Answer:
    """Find what the recordings determine; infinite numbers are ``None`` in the record."""
    identification = model.identification(progress=progress)
    return _identifiability(model, "identify.txt.j2", identification)


def advise(
    model: Model,
    name: str,
    path: Path | None = None,
    *,
    force: bool = False,
    progress: ProgressCallback = no_progress,
) -> Answer:
    """Rank next recordings for one quantity, and write the best one's torque.

    ``path`` is a new CSV, or replaced by ``force``; units are in the second line.
    """
    if path and path.suffix.lower() != ".csv":
        raise BadInput(str(path), "is not named .csv", "name the excitation something.csv")
    if path and path.exists() and not force:
        hint = "name another file with -o, or replace it with --force"
        raise BadInput(str(path), "exists already", hint)
    unit = model.chain.torque_unit
    ranking = model.advise(name, progress=progress)
    written = str(path) if path and ranking.worth else None
    if path and written:
        table = io.StringIO()
        rows, header = ranking.candidates[0].rows, f"time,torque\ns,{unit}"
        np.savetxt(table, rows, fmt=["%.10g", "%.6g"], delimiter=",", header=header, comments="")
        write_files({path: table.getvalue()}, replace=force)
    record, lines = _identifiability(
        model, "advise.txt.j2", ranking, assumption=ASSUMPTION, written=written, torque_unit=unit
    )
    return record | {"written": written}, lines


def _identifiability(model: Model, template: str, result: Any, **variables: Any) -> Answer:
    """Fill a template, after a warning where the mechanism does not explain the torque."""
    doubts = little_explained(model.chain, model.observations)
    warnings = [f"WARNING: {doubt_text(doubt)}" for doubt in doubts]
    unit = "rad" if model.chain.load.motion == "rotary" else "m"
    variables |= {"inf": np.inf, "doubted": bool(doubts), "unit": unit, "position_unit": unit}
    text = filled(template, found=result, **variables)
    lines = [*warnings, *([""] if warnings else []), *text.splitlines()]
    return {"config": str(model.config.path), **result.as_json(), "doubts": doubts}, lines


def explain(
    model: Model, output: Path | None = None, *, progress: ProgressCallback = no_progress
) -> Answer:
    """Find what else explains the torque.

    ``output`` is a file to write next to the configuration, with the missing terms.
    """
    completed: dict[str, Any] = {}
    included: Sequence[Finding] = ()
    if output is None:
        explained = model.explain(progress=progress)
    else:
        _check_better(output, model.config.path.parent)
        model, included, explained = model.completed(progress=progress)
        write_files({output: model.config.text})
        completed = {"taken": [finding.as_dict() for finding in included], "written": str(output)}
    text = filled(
        "explain.txt.j2",
        found=explained,
        warnings=map(doubt_text, little_explained(model.chain, model.observations)),
        lines=[_finding_line(finding) for finding in explained.findings],
        taken=[f"Put in: {_finding_line(finding)}" for finding in included],
        indistinguishable=", ".join(clause(kind) for kind in explained.indistinguishable),
        path=output,
        names=model.chain.names,
    )
    lines = [part for line in text.splitlines() for part in wrapped(line, indent=3)]
    return {"config": str(model.config.path), **explained.as_json(), **completed}, lines


def _finding_line(finding: Finding) -> str:
    """Describe a finding, its shifts and its rivals."""
    moves = ", ".join(f"{name} {by:+.1f}" for name, by in list(finding.moves.items())[:3])
    effect = f"; moves {moves} standard deviations" if moves else ""
    rivals = ", ".join(clause(kind) for kind in finding.rivals[:3])
    described = line_of(finding.kind, finding.as_dict())
    return described + effect + (f"; looks like {rivals}" if rivals else "")


def _check_better(path: Path, folder: Path) -> None:
    """Check the name of a better configuration: files in it are relative to its folder."""
    if path.suffix != ".toml":
        raise BadInput(str(path), "is not named .toml", "name a configuration: BETTER.toml")
    if path.resolve().parent != folder.resolve():
        hint = f"write it to {folder / path.name}"
        raise BadInput(str(path), "is not in the configuration's folder", hint)
    if path.exists():
        raise BadInput(str(path), "exists", "name another file")
