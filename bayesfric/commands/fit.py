"""``bayesfric fit``: sample the posterior and write the run directory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from bayesfric.commands.unfinished import unfinished
from bayesfric.config import Config
from bayesfric.errors import BadInput
from bayesfric.inference.sampling.sampling import Progress, phase
from bayesfric.model import Model
from bayesfric.report.alerts import DOUBTS, alerts_of
from bayesfric.report.comparison.cell import DOUBTFUL, TOGETHER, posterior_cells
from bayesfric.report.run_directory import check_free
from bayesfric.report.summary.bounds import bound_mend, told_by_data
from bayesfric.report.summary.noise import noise_lines
from bayesfric.report.summary.read_back import PosteriorRow
from bayesfric.report.summary.validation import validation_lines


def fit(
    config: Config,
    folder: Path,
    *,
    seed: int | None = None,
    resume: bool = False,
    force: bool = False,
    output_error: bool = False,
    progress: Callable[[Progress], None] = lambda _: None,
) -> dict[str, Any]:
    """Fit a configuration and write the run directory.

    Parameters
    ----------
    config
        From :func:`bayesfric.config.read_config`.
    folder
        Run directory to make.
    seed
        Replaces the configuration's.
    resume
        Go on with an interrupted run; the result is that of one never interrupted.
    force
        Keep what stands there, and an interrupted run's checkpoint, under other names
        and start afresh.
    output_error
        Make the output-error estimate too, as ``estimation.output_error`` asks for it.
    progress
        Called as sampling goes on.

    Returns
    -------
    dict
        What ``summary.json`` holds.

    Raises
    ------
    BadInput
        For anything that cannot be used; nothing is written then. For a disk that is full
        or gone; the last checkpoint is kept then.
    Interrupted
        On Ctrl-C or SIGTERM; what was sampled is kept.
    """
    # who resumes has an old run kept, if --force came with the first command
    check_free(folder, force=force or resume)
    with unfinished(folder, resume=resume, force=force) as run:
        model = Model.from_config(config)
        result = model.fit(
            seed=seed,
            output_error=output_error,
            progress=progress,
            checkpoint=partial(run.sampling, model),
        )
        progress(phase("writing results"))
        try:
            summary = result.write(folder)
        except BadInput as error:
            mend = "mend that, then write them with --resume: nothing is sampled again"
            raise BadInput(error.where, error.what, mend) from None
        run.remove()
    return summary


def fit_text(summary: dict[str, Any], folder: Path) -> Iterator[str]:
    """Word a summary for a person, line by line."""
    sampler = summary["sampler"]
    yield (
        f"{sampler['status']}: {sampler['min_ess']:.0f} independent draws of the least certain "
        f"parameter, nested R-hat {sampler['max_rhat']:.4f}, {sampler['seconds']:.1f} s"
        if sampler["min_ess"] is not None and sampler["max_rhat"] is not None
        else f"{sampler['status']}: a parameter never moved"
    )
    alerts = alerts_of(summary)
    first = ("sampler", *DOUBTS)
    yield from (f"  {one.text}" for one in alerts if one.kind in first)
    yield ""
    combined = {name: row for name, row in summary["derived"].items() if row["gauge_free"]}
    sound = {name for name, cell in posterior_cells(summary).items() if cell.converged}
    for title, rows in (
        ("What the motor feels, whatever the scale", combined),
        ("Parameters", summary["parameters"]),
    ):
        if sound & set(rows):
            yield f"{title} (90 % intervals)"
            for name in rows:
                if name in sound:
                    yield from _row(name, rows[name])
            yield ""
    if lost := [name for name in [*combined, *summary["parameters"]] if name not in sound]:
        yield (
            "No intervals: what ensembles make that disagree, or stand still, is no posterior. "
            f"Not converged: {', '.join(lost)}"
        )
    for direction in summary["identifiability"]["null_directions"]:
        yield ""
        yield f"No recording of this kind can tell: {direction['meaning']}."
    yield from (f"WARNING: {one.text}" for one in alerts if one.kind not in first)
    yield ""
    yield from noise_lines(summary["noise"])
    yield f"Residual rms {summary['fit']['residual_rms']:.4g} {summary['fit']['unit']}"
    if "validation" in summary:
        yield from validation_lines(summary["validation"])
    yield f"Written to {folder}"


def _remark(row: dict[str, Any], read: PosteriorRow) -> str:
    """Say beside an interval what made it."""
    bound = read.at_bound
    if bound and read.verdict != "data" and told_by_data(read):
        limit = row["interval"][1 if bound == "lower" else 0]
        kind = "upper" if bound == "lower" else "lower"
        return f"the data push it against its {bound} bound: read it as {kind} limit {limit:.3g}"
    words = {
        "data": "",
        "weak": DOUBTFUL if read.doubted else f"weakly determined: {TOGETHER}",
        "prior": "NOT determined by the data: this is the prior and the bounds",
    }[row["verdict"]]
    if row.get("undefined_share"):
        words += f"; undefined (irreversible) in {100 * row['undefined_share']:.0f} % of the draws"
    return words.removeprefix("; ") + (f"; leans on its {bound} bound" if bound and words else "")


def _row(name: str, row: dict[str, Any]) -> Iterator[str]:
    """Write one number, and below it what to do about a bound that holds it."""
    low, high = row["interval"]
    read = PosteriorRow.model_validate(row)
    remark = _remark(row, read)
    text = f"  {name:<30} {row['median']:>11.5g}  [{low:.5g}, {high:.5g}] {row['unit']}"
    if row.get("white_interval") and row["verdict"] == "data":
        low, high = row["white_interval"]
        text += f"   (white noise: [{low:.5g}, {high:.5g}])"
    yield text + (f"   {remark}" if remark else "")
    if mend := bound_mend(name, read):
        yield f"      {mend}"
