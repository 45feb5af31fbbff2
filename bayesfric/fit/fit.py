"""The method, step by step: choose the model, estimate, sample, examine, conclude."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from bayesfric.base.errors import BadInput
from bayesfric.base.progress import Progress, Shown
from bayesfric.diagnostics.calibration_check import CalibrationCheck, calibration_check
from bayesfric.diagnostics.explanation import Explanation
from bayesfric.diagnostics.finding import Finding
from bayesfric.estimates.collinear_losses import collinear_losses
from bayesfric.fit.conclusion import Examination, conclude
from bayesfric.fit.result import Result
from bayesfric.identifiability.back_emf import speed_term
from bayesfric.identifiability.identification import Identification, identify
from bayesfric.inference import fitting
from bayesfric.inference.discrepancy import discrepancy
from bayesfric.inference.fitting import Fit
from bayesfric.inference.predictive import predict_held_out
from bayesfric.inference.stiction_violations import stiction_violations
from bayesfric.inference.sampling.sampling import Sampling
from bayesfric.problem.problem import Problem, StartingPoint, starting_point


def fit(
    problem: Problem,
    sampling: Sampling,
    *,
    output_error: bool,
    progress: Shown,
) -> Result:
    """Sample a problem as it was read, and sum it up; see :meth:`bayesfric.Model.fit`."""
    tables = problem.config.tables
    if tables.pooling.vary:
        raise BadInput(
            "pooling.vary",
            "is for 'bayesfric pool': a fit shares all parameters between recordings",
            "ask that, or leave the table out",
        )
    # choose the model
    taken: Sequence[Finding] = ()
    explained: Explanation | None = None
    if tables.mechanism.auto:
        problem, taken, explained = problem.completed(progress=progress)
    # estimate
    start = starting_point(problem, output_error=output_error, progress=progress)
    _refuse_collinear_losses(problem, start)
    explained = explained or problem.explain(start.estimates, progress=progress)
    # sample
    with problem.config.named():
        found = fitting.fit(start.target, sampling, estimates=start.estimates, progress=progress)
    if problem.held_out:
        held_out = predict_held_out(found.target, found.posterior, problem.held_out)
        found = replace(found, held_out=held_out)
    # examine
    room = discrepancy(found.target, found.posterior, explained.missing)
    found = replace(found, discrepancy=room)
    examined = _examine(problem, start, found, explained, taken, progress)
    # conclude
    return Result(problem, found, conclude(problem, start, found, examined))


def _refuse_collinear_losses(problem: Problem, start: StartingPoint) -> None:
    """Refuse load losses of several elements that these recordings do not tell apart."""
    known = [name for name, prior in problem.priors.items() if not prior.default]
    if names := collinear_losses(problem.chain, start.searched, known):
        first, *_, last = names
        raise BadInput(
            f"{problem.config.path}: mechanism.elements.{last.partition('.')[0]}.load_loss",
            f"these recordings cannot tell {', '.join(names)} apart, load losses one behind the "
            "other",
            f'set load_loss = "none" in all elements but one, or give {first} a number or a '
            "narrow range under [priors]",
        )


def _examine(
    problem: Problem,
    start: StartingPoint,
    found: Fit,
    explained: Explanation,
    taken: Sequence[Finding],
    progress: Shown,
) -> Examination:
    target, median, recordings = found.target, found.posterior.median, problem.recordings
    usable = found.posterior.diagnostics.status != "unusable"
    checked: CalibrationCheck | None = None
    if problem.config.tables.self_check.recordings != 0:
        seen = problem.observations
        checked = calibration_check(target, found.posterior, seen, explained)
    progress(Progress("identifiability"))
    identified: Identification | None = None
    with suppress(BadInput):  # a simulation that fails there takes no result away
        identified = identify(start.target, median)
    return Examination(
        explained=explained,
        taken=taken,
        contradicted=problem.contradicted(dict(start.searched.point)),
        back_emf=speed_term(target, median, recordings),
        stiction_violations=[*stiction_violations(found, recordings, problem.config.tables.processing)]
        if usable
        else [],
        calibration_check=checked,
        identified=identified,
    )
