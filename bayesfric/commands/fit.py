"""``bayesfric fit``: sample the posterior and write the run directory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bayesfric.commands.estimate import estimates_beside
from bayesfric.commands.identify import open_directions
from bayesfric.commands.problem import Problem, read_problem
from bayesfric.commands.unfinished import Unfinished, unfinished
from bayesfric.config import Config
from bayesfric.errors import BadInput
from bayesfric.inference.fit import Fit
from bayesfric.inference.fit import fit as fit_target
from bayesfric.inference.likelihood.noise_choice import Choice
from bayesfric.inference.predictive import predict_held_out
from bayesfric.inference.sampling.checkpoint import Checkpoint
from bayesfric.inference.sampling.sampling import Progress, Sampling, phase
from bayesfric.inference.target import Target
from bayesfric.report.run_directory import check_free, write_run
from bayesfric.report.summary.doubts import find_doubts, put_doubts
from bayesfric.report.summary.noise import add_white_intervals, white_alternative
from bayesfric.report.summary.record import Identifiability
from bayesfric.report.summary.summary import rms, spreads, summarise
from bayesfric.report.terminal import fit_text as fit_text

NOT_CONVERGED = 3
# Independent draws that are enough for an interval that only stands beside another.
_WHITE_ESS = 2000.0


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
        return _fit(config, folder, seed, output_error, progress, run)


def _fit(
    config: Config,
    folder: Path,
    seed: int | None,
    output_error: bool,
    progress: Callable[[Progress], None],
    run: Unfinished,
) -> dict[str, Any]:
    problem = read_problem(config)
    recordings = [*problem.recordings, *(one.recording for one in problem.held_out)]
    source = config.origin_of(recordings)
    sampling = _settings(config, seed)
    kept = run.sampling("posterior", problem, sampling)
    made = _sampled(problem, sampling, output_error, progress, kept)
    result = made.fit
    summary = summarise(result, problem.references(), made.choice)
    compared = None
    if white_alternative(result):
        progress(phase("the same with white noise"))
        quick = sampling.model_copy(update={"min_ess": min(sampling.min_ess, _WHITE_ESS)})
        kept = run.sampling("white-noise", problem, quick)
        with config.named():
            white = fit_target(
                problem.white_target(),
                quick,
                estimates=result.estimates,
                progress=progress,
                checkpoint=kept,
            )
        if white.posterior.diagnostics.status != "unusable":
            compared = spreads(white), rms(white)
        summary = add_white_intervals(summary, compared[0] if compared else None)
    summary = put_doubts(summary, find_doubts(result, summary, made.choice, compared))
    progress(phase("identifiability"))
    update: dict[str, Any] = {
        "warnings": [*summary.warnings, *made.missing],
        # nothing in a file of samples tells; the configuration may
        "may_be_simulated": config.tables.simulation is not None,
        "source": source.model_dump(mode="json"),
    }
    with suppress(BadInput):  # a simulation that fails there takes no result away
        open_ = open_directions(made.target, result.posterior.median)
        update["identifiability"] = Identifiability.model_validate(
            summary.identifiability.as_dict() | {"directions": open_}
        )
    summary = summary.model_copy(update=update)
    progress(phase("writing results"))
    try:
        write_run(folder, result, summary, config.text, recordings)
    except BadInput as error:
        mend = "mend that, then write them with --resume: nothing is sampled again"
        raise BadInput(error.where, error.what, mend) from None
    run.remove()
    return summary.as_dict()


def posterior(
    config: Config,
    *,
    seed: int | None = None,
    output_error: bool = False,
    progress: Callable[[Progress], None] = lambda _: None,
) -> Fit:
    """Sample the posterior of a configuration, the one :func:`fit` writes, and write nothing.

    Parameters
    ----------
    config, seed, output_error, progress
        As for :func:`fit`.

    Returns
    -------
    Fit
        With the point estimates it began from, and predictions of what was held out.

    Raises
    ------
    BadInput
        For anything that cannot be used.
    """
    return _sampled(read_problem(config), _settings(config, seed), output_error, progress).fit


@dataclass(frozen=True)
class _Sampled:
    """A fit with how it came about: the noise's choice, the target, the estimates there are not."""

    fit: Fit
    choice: Choice | None
    target: Target
    missing: list[str]


def _settings(config: Config, seed: int | None) -> Sampling:
    sampling = config.tables.sampling
    return sampling if seed is None else sampling.model_copy(update={"seed": seed})


def _sampled(
    problem: Problem,
    sampling: Sampling,
    output_error: bool,
    progress: Callable[[Progress], None],
    checkpoint: Checkpoint | None = None,
) -> _Sampled:
    """Estimate, choose the noise, sample, and predict what was held out."""
    found, missing = estimates_beside(
        problem,
        simulate=output_error,
        progress=lambda method: progress(phase(f"{method} estimate")),
    )
    points = [dict(e.point) for e in found if e.point]
    choice = problem.noise_choice(points[0])
    target = _target(problem, points, choice)
    with problem.config.named():
        result = fit_target(
            target, sampling, estimates=found, progress=progress, checkpoint=checkpoint
        )
    if problem.held_out:
        held_out = predict_held_out(result.target, result.posterior, problem.held_out)
        result = replace(result, held_out=held_out)
    return _Sampled(result, choice, target, missing)


def _target(
    problem: Problem, points: Sequence[Mapping[str, float]], choice: Choice | None
) -> Target:
    """Make the log-posterior; where it simulates, near the first estimate that can be simulated.

    The simulation is linearised there first, and anew at every mode this leads to.
    """
    for point in points[:-1]:
        try:
            return problem.target(point, choice)
        except BadInput:
            continue
    return problem.target(points[-1], choice)
