"""The method, step by step: choose the model, estimate, sample, examine, conclude."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from bayesfric.base.errors import BadInput
from bayesfric.base.progress import Progress, ProgressCallback
from bayesfric.diagnostics.calibration_check import CalibrationCheck, calibration_check
from bayesfric.diagnostics.explanation import Explanation
from bayesfric.diagnostics.regression import Finding
from bayesfric.estimates.assemble import collinear_losses
from bayesfric.fit.result import Result
from bayesfric.identifiability.identification import OpenDirection, SpeedTerm, identify, speed_term
from bayesfric.inference import fitting
from bayesfric.inference.discrepancy import discrepancy
from bayesfric.inference.fitting import Fit
from bayesfric.inference.posterior import StictionViolation, predict_held_out, stiction_violations
from bayesfric.inference.sampling import Sampling
from bayesfric.problem.problem import Problem, StartingPoint, starting_point
from bayesfric.report.summary.derived_quantities import groups
from bayesfric.report.summary.doubts import add_model_error, find_doubts, put_doubts
from bayesfric.report.summary.parts import friction_part, self_check_doubts, self_check_part
from bayesfric.report.summary.record import Message, Summary
from bayesfric.report.summary.summary import summarise
from bayesfric.report.words import line_of


def fit(
    problem: Problem, sampling: Sampling, *, output_error: bool, progress: ProgressCallback
) -> Result:
    """Sample a problem and summarise the posterior; see :meth:`bayesfric.Model.fit`."""
    tables = problem.config.tables
    if tables.pooling.vary:
        raise BadInput(
            "pooling.vary",
            "is for 'bayesfric pool': a fit shares all parameters between recordings",
            "run that, or leave the table out",
        )
    # choose the model
    included: Sequence[Finding] = ()
    explained: Explanation | None = None
    if tables.mechanism.auto:
        problem, included, explained = problem.completed(progress=progress)
    # estimate
    start = starting_point(problem, output_error=output_error, progress=progress)
    _refuse_collinear_losses(problem, start)
    explained = explained or problem.explain(start.estimates, progress=progress)
    # sample
    with problem.config.named():
        sampled = fitting.fit(start.target, sampling, estimates=start.estimates, progress=progress)
    if problem.held_out:
        held_out = predict_held_out(sampled.target, sampled.posterior, problem.held_out)
        sampled = replace(sampled, held_out=held_out)
    # examine and conclude
    errors = discrepancy(sampled.target, sampled.posterior, explained.missing)
    sampled = replace(sampled, discrepancy=errors)
    summary = _conclude(problem, start, sampled, explained, included, progress)
    return Result.of_fit(problem, sampled, summary)


def _refuse_collinear_losses(problem: Problem, start: StartingPoint) -> None:
    """Refuse load-dependent friction of several elements that is not identifiable."""
    known = [name for name, prior in problem.priors.items() if not prior.default]
    if names := collinear_losses(problem.chain, start.searched, known):
        first, *_, last = names
        raise BadInput(
            f"{problem.config.path}: mechanism.elements.{last.partition('.')[0]}.load_loss",
            f"these recordings cannot distinguish {', '.join(names)}, load losses in series",
            f'set load_loss = "none" in all elements but one, or give {first} a number or a '
            "narrow range under [priors]",
        )


def _conclude(
    problem: Problem,
    start: StartingPoint,
    sampled: Fit,
    explained: Explanation,
    included: Sequence[Finding],
    progress: ProgressCallback,
) -> Summary:
    """Check a posterior, and summarise it: numbers with intervals, and doubts."""
    target, posterior, tables = sampled.target, sampled.posterior, problem.config.tables
    checked: CalibrationCheck | None = None
    if tables.self_check.recordings != 0:
        checked = calibration_check(target, posterior, problem.observations, explained)
    progress(Progress("identifiability"))
    directions: list[OpenDirection] = []
    with suppress(BadInput):  # the median may be impossible to simulate
        directions += identify(start.target, posterior.median).directions
    violations: list[StictionViolation] = []
    if posterior.diagnostics.status != "unusable":
        violations += stiction_violations(
            target,
            sampled.wide.posterior,
            sampled.residuals,
            problem.recordings,
            tables.processing,
        )
    derived = groups(sampled)
    summary = summarise(sampled, problem.references(), start.choice, derived)
    summary = add_model_error(summary, sampled, derived)
    summary = _with_back_emf(summary, speed_term(start.target, problem.recordings))
    findings = explained.with_severity(widened=summary.widened)
    update: dict[str, Any] = {
        "fit": summary.fit.model_copy(update={"rests": violations}),
        "findings": [Message.read(finding.as_dict()) for finding in findings],
        "taken": [Message.read(finding.as_dict()) for finding in included],
        "regression": {
            "twins": len(explained.replicates),
            "asked": len(explained.kinds),
            "reason": explained.reason,
            "share": explained.share,
        },
        "identifiability": summary.identifiability.model_copy(update={"directions": directions}),
        "warnings": [*summary.warnings, *start.missing],
        # a data file does not say that it is simulated; the configuration may
        "may_be_simulated": may_be_simulated(problem),
    }
    summary = summary.model_copy(update=update)
    contradicted = problem.contradicted(dict(start.searched.point))
    doubts = find_doubts(sampled, summary, contradicted)
    if checked is not None:
        part = self_check_part(sampled, summary, checked, derived)
        summary = summary.model_copy(update={"self_check": part})
        doubts += self_check_doubts(summary)
    summary = put_doubts(summary, doubts)
    return summary.model_copy(update={"friction": friction_part(sampled, summary)})


def may_be_simulated(problem: Problem) -> bool:
    """Whether there are simulation options or true parameters; ``init`` writes an empty table."""
    options = problem.config.tables.simulation
    paths = [recording.path for recording in problem.recordings if recording.path is not None]
    has_truth = any(path.with_suffix(".truth.json").is_file() for path in paths)
    return has_truth or (
        options is not None and any(options.model_dump(exclude_unset=True).values())
    )


def _with_back_emf(summary: Summary, term: SpeedTerm | None) -> Summary:
    """Add what an error of the nominal back-EMF is collinear with, for voltage drives."""
    if term is None:
        return summary
    changes = {
        name: {"meaning": line_of("with back-emf", {"meaning": summary.parameters[name].meaning})}
        for name in term.same_as_back_emf
    }
    return summary.with_rows(changes, fit=summary.fit.model_copy(update={"back_emf": term}))
