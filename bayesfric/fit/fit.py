"""The method, step by step: choose the model, estimate, sample, examine, conclude."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from bayesfric.base.errors import BadInput
from bayesfric.base.progress import Progress, ProgressCallback
from bayesfric.diagnostics.calibration_check import CalibrationCheck, calibration_check
from bayesfric.diagnostics.explanation import Explanation
from bayesfric.diagnostics.finding import Finding
from bayesfric.estimates.assemble import collinear_losses
from bayesfric.fit.result import Result
from bayesfric.identifiability.identification import Identification, SpeedTerm, identify, speed_term
from bayesfric.inference import fitting
from bayesfric.inference.discrepancy import discrepancy
from bayesfric.inference.fitting import Fit
from bayesfric.inference.predictive import predict_held_out
from bayesfric.inference.sampling.sampling import Sampling
from bayesfric.inference.stiction_violations import StictionViolation, stiction_violations
from bayesfric.problem.problem import Problem, StartingPoint, starting_point
from bayesfric.report.summary.derived_quantities import groups
from bayesfric.report.summary.doubts import add_model_error, find_doubts, put_doubts
from bayesfric.report.summary.parts import friction_part, self_check_doubts, self_check_part
from bayesfric.report.summary.record import FindingRow, RegressionPart, Summary
from bayesfric.report.summary.summary import summarise
from bayesfric.report.words import line_of


@dataclass(frozen=True)
class Examination:
    """Checks of a posterior."""

    explained: Explanation  # what else explains the torque
    included: Sequence[Finding]  # effects added to the model automatically
    # priors that the data contradict: estimate, and distance in standard deviations
    contradicted: Mapping[str, tuple[float, float]]
    back_emf: SpeedTerm | None
    stiction_violations: Sequence[StictionViolation]
    calibration_check: CalibrationCheck | None  # None if it was not requested
    identified: Identification | None  # at the median; None if that cannot be simulated


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
    # examine
    errors = discrepancy(sampled.target, sampled.posterior, explained.missing)
    sampled = replace(sampled, discrepancy=errors)
    examined = _examine(problem, start, sampled, explained, included, progress)
    # conclude
    return Result.of_fit(problem, sampled, _conclude(problem, start, sampled, examined))


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


def _examine(
    problem: Problem,
    start: StartingPoint,
    sampled: Fit,
    explained: Explanation,
    included: Sequence[Finding],
    progress: ProgressCallback,
) -> Examination:
    target, posterior, recordings = sampled.target, sampled.posterior, problem.recordings
    tables = problem.config.tables
    checked: CalibrationCheck | None = None
    if tables.self_check.recordings != 0:
        checked = calibration_check(target, posterior, problem.observations, explained)
    progress(Progress("identifiability"))
    identified: Identification | None = None
    with suppress(BadInput):  # the median may be impossible to simulate
        identified = identify(start.target, posterior.median)
    usable = posterior.diagnostics.status != "unusable"
    return Examination(
        explained=explained,
        included=included,
        contradicted=problem.contradicted(dict(start.searched.point)),
        back_emf=speed_term(target, posterior.median, recordings),
        stiction_violations=[*stiction_violations(sampled, recordings, tables.processing)]
        if usable
        else [],
        calibration_check=checked,
        identified=identified,
    )


def _conclude(
    problem: Problem, start: StartingPoint, sampled: Fit, examined: Examination
) -> Summary:
    """Summarise a posterior: numbers with intervals, and doubts."""
    derived, explained = groups(sampled), examined.explained
    summary = summarise(sampled, problem.references(), start.choice, derived)
    summary = add_model_error(summary, sampled, derived)
    summary = _with_back_emf(summary, examined.back_emf)
    findings = explained.with_severity(widened=summary.widened)
    identifiability = summary.identifiability
    if examined.identified is not None:
        directions = {"directions": [*examined.identified.directions]}
        identifiability = identifiability.model_copy(update=directions)
    violations = {"rests": [*examined.stiction_violations]}
    update: dict[str, Any] = {
        "fit": summary.fit.model_copy(update=violations),
        "findings": [FindingRow.read(finding.as_dict()) for finding in findings],
        "taken": [FindingRow.read(finding.as_dict()) for finding in examined.included],
        "regression": RegressionPart(
            twins=len(explained.replicates),
            asked=len(explained.kinds),
            reason=explained.reason,
            share=explained.share,
        ),
        "identifiability": identifiability,
        "warnings": [*summary.warnings, *start.missing],
        # a data file does not say that it is simulated; the configuration may
        "may_be_simulated": may_be_simulated(problem),
    }
    summary = summary.model_copy(update=update)
    doubts = find_doubts(sampled, summary, examined.contradicted)
    if examined.calibration_check is not None:
        part = self_check_part(sampled, summary, examined.calibration_check, derived)
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
