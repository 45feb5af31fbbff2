"""Check a sampled posterior, and conclude: numbers with intervals, findings and doubts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from bayesfric.base.errors import BadInput
from bayesfric.diagnostics.explanation import CalibrationCheck, Explanation, calibration_check
from bayesfric.diagnostics.regression import Finding
from bayesfric.estimates.assemble import collinear_losses
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.identifiability.identification import OpenDirection, identify, speed_term
from bayesfric.inference.fitting import Fit
from bayesfric.inference.noise import NoiseChoice
from bayesfric.inference.posterior import stiction_violations
from bayesfric.inference.priors import Prior
from bayesfric.inference.target import Target
from bayesfric.mechanism.joint import Joint
from bayesfric.problem.config import Config
from bayesfric.recordings.measurement import Measurement
from bayesfric.report.summary.derived_quantities import groups
from bayesfric.report.summary.doubts import add_model_error, find_doubts, put_doubts
from bayesfric.report.summary.parts import friction_part, self_check_part
from bayesfric.report.summary.record import Message, Summary
from bayesfric.report.summary.summary import summarise
from bayesfric.report.words import line_of


@dataclass(frozen=True)
class StartingPoint:
    """Estimates, noise and log-posterior to start sampling from."""

    estimates: list[Estimate]  # least squares first
    missing: list[str]  # a sentence for each that failed
    choice: NoiseChoice | None  # None if the noise is configured
    target: Target  # the log-posterior

    @property
    def searched(self) -> Estimate:
        """The first estimate with all parameters; there always is one."""
        return next(estimate for estimate in self.estimates if estimate.point)


def refuse_collinear_losses(
    config: Config, chain: Joint, priors: Mapping[str, Prior], start: StartingPoint
) -> None:
    """Refuse load-dependent friction of several elements that is not identifiable."""
    known = [name for name, prior in priors.items() if not prior.default]
    if names := collinear_losses(chain, start.searched, known):
        first, *_, last = names
        raise BadInput(
            f"{config.path}: mechanism.elements.{last.partition('.')[0]}.load_loss",
            f"these recordings cannot distinguish {', '.join(names)}, load losses in series",
            f'set load_loss = "none" in all elements but one, or give {first} a number or a '
            "narrow range under [priors]",
        )


def conclude(
    config: Config,
    recordings: Sequence[Measurement],
    references: Mapping[str, Mapping[str, Any]],
    start: StartingPoint,
    fit: Fit,
    explained: Explanation,
    included: Sequence[Finding],
    contradicted: Mapping[str, tuple[float, float]],
) -> Summary:
    """Check a posterior, and summarise it: numbers with intervals, and doubts."""
    target, posterior, tables = fit.target, fit.posterior, config.tables
    checked: CalibrationCheck | None = None
    if tables.self_check.recordings != 0:
        checked = calibration_check(target, posterior, fit.observations, explained)
    directions: list[OpenDirection] = []
    with suppress(BadInput):  # the median may be impossible to simulate
        directions += identify(start.target, posterior.median).directions
    violations: list[dict[str, Any]] = []
    if posterior.diagnostics.status != "unusable":
        violations += stiction_violations(
            target, fit.wide.posterior, fit.residuals, recordings, tables.processing
        )
    derived = groups(fit)
    summary = summarise(fit, references, start.choice, derived)
    summary = add_model_error(summary, fit, derived)
    summary = _with_back_emf(summary, speed_term(start.target, recordings))
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
        "may_be_simulated": may_be_simulated(config, recordings),
    }
    summary = summary.model_copy(update=update)
    if checked is not None:
        part = self_check_part(fit, summary, checked, derived)
        summary = summary.model_copy(update={"self_check": part})
    summary = put_doubts(summary, find_doubts(fit, summary, contradicted))
    return summary.model_copy(update={"friction": friction_part(fit, summary)})


def may_be_simulated(config: Config, recordings: Sequence[Measurement]) -> bool:
    """Whether there are simulation options or true parameters; ``init`` writes an empty table."""
    options = config.tables.simulation
    paths = [recording.path for recording in recordings if recording.path is not None]
    has_truth = any(path.with_suffix(".truth.json").is_file() for path in paths)
    return has_truth or (
        options is not None and any(options.model_dump(exclude_unset=True).values())
    )


def _with_back_emf(summary: Summary, term: Mapping[str, Any] | None) -> Summary:
    """Add what an error of the nominal back-EMF is collinear with, for voltage drives."""
    if term is None:
        return summary
    changes = {
        name: {"meaning": line_of("with back-emf", {"meaning": summary.parameters[name].meaning})}
        for name in term["same_as_back_emf"]
    }
    return summary.with_rows(changes, fit=summary.fit.model_copy(update={"back_emf": term}))
