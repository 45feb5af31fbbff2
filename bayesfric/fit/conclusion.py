"""What is concluded of a posterior: its summary, with all that was asked of it put in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bayesfric.base.atomic_write import jsonable
from bayesfric.diagnostics.calibration_check import CalibrationCheck
from bayesfric.diagnostics.explanation import Explanation
from bayesfric.diagnostics.finding import Finding
from bayesfric.identifiability.back_emf import SpeedTerm
from bayesfric.identifiability.identification import Identification
from bayesfric.inference.fitting import Fit
from bayesfric.inference.stiction_violations import StictionViolation
from bayesfric.problem.problem import Problem, StartingPoint
from bayesfric.report.summary.conclusions import add_model_error, put_reported
from bayesfric.report.summary.derived_quantities import groups
from bayesfric.report.summary.doubts import find_doubts, put_doubts
from bayesfric.report.summary.friction_part import friction_part
from bayesfric.report.summary.record import FindingRow, Identifiability, RegressionPart, Summary
from bayesfric.report.summary.rows import BackEmfPart, RestsPart
from bayesfric.report.summary.self_check_part import self_check_doubts, self_check_part
from bayesfric.report.summary.summary import summarise
from bayesfric.report.words import line_of


@dataclass(frozen=True)
class Examination:
    """All that was asked of a posterior before anyone may read it."""

    explained: Explanation  # what else explains the torque
    taken: Sequence[Finding]  # what of that was put into the model
    contradicted: Mapping[str, tuple[float, float]]  # priors, by the data: their value, and sds
    back_emf: SpeedTerm | None  # what its nominal constant cannot be told from
    stiction_violations: Sequence[StictionViolation]  # those that the law contradicts
    calibration_check: (
        CalibrationCheck | None
    )  # on simulated recordings like its own, unless none were wanted
    identified: Identification | None  # at the median, unless no motion can be simulated there


def conclude(problem: Problem, start: StartingPoint, found: Fit, examined: Examination) -> Summary:
    """Sum a posterior up: each number with its interval and what is doubtful of it."""
    derived = groups(found)
    summary = summarise(found, problem.references(), start.choice, derived)
    summary = add_model_error(summary, found, derived)
    summary = _with_back_emf(summary, examined.back_emf, len(problem.recordings))
    rests = [RestsPart.model_validate(vars(one)) for one in examined.stiction_violations]
    summary = summary.model_copy(update={"fit": summary.fit.model_copy(update={"rests": rests})})
    summary = _with_findings(summary, examined.explained, examined.taken)
    doubts = find_doubts(found, summary, examined.contradicted)
    if examined.calibration_check is not None:
        part = self_check_part(found, summary, examined.calibration_check, derived)
        summary = summary.model_copy(update={"self_check": part})
        doubts += self_check_doubts(summary)
    summary = put_doubts(summary, doubts)
    update: dict[str, Any] = {
        "friction": friction_part(found, summary),
        "warnings": [*summary.warnings, *start.missing],
        # nothing in a file of samples tells; the configuration may
        "may_be_simulated": may_be_simulated(problem),
    }
    if examined.identified is not None:
        directions = {"directions": jsonable(examined.identified.directions)}
        told = summary.identifiability.as_dict() | directions
        update["identifiability"] = Identifiability.model_validate(told)
    return put_reported(summary.model_copy(update=update))


def may_be_simulated(problem: Problem) -> bool:
    """Whether something says how, or there is the truth; ``init`` writes an empty table."""
    told = problem.config.tables.simulation
    files = [one.path for one in problem.recordings if one.path is not None]
    there = any(path.with_suffix(".truth.json").is_file() for path in files)
    return there or (told is not None and any(told.model_dump(exclude_unset=True).values()))


def _with_findings(summary: Summary, found: Explanation, taken: Sequence[Finding]) -> Summary:
    """Put in what else explains the torque, and how that was asked."""
    asked: dict[str, Any] = {"twins": len(found.replicates), "asked": len(found.kinds)}
    asked |= {"reason": found.reason, "share": found.share}
    findings = found.with_severity(widened=summary.widened)
    update = {
        "findings": [FindingRow.model_validate(one.as_dict()) for one in findings],
        "taken": [FindingRow.model_validate(one.as_dict()) for one in taken],
        "regression": RegressionPart.model_validate(asked),
    }
    return summary.model_copy(update=update)


def _with_back_emf(summary: Summary, term: SpeedTerm | None, recordings: int) -> Summary:
    """Put in what the nominal back-EMF's error cannot be told from, where a voltage drives."""
    if term is None:
        return summary
    part = BackEmfPart.model_validate(jsonable({**vars(term), "among": recordings}))
    changes = {
        name: {"meaning": line_of("with back-emf", {"meaning": summary.parameters[name].meaning})}
        for name in term.same_as_back_emf
    }
    fit = summary.fit.model_copy(update={"back_emf": part})
    return summary.with_rows(changes, fit=fit)
