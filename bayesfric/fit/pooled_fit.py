"""One posterior of several recordings of a joint of which some parameters differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.progress import Progress, ProgressCallback, Timer, no_progress
from bayesfric.diagnostics.explanation import Explanation
from bayesfric.diagnostics.regression import Finding
from bayesfric.fit.check_report import check
from bayesfric.fit.model import Model
from bayesfric.inference.discrepancy import discrepancy
from bayesfric.inference.fitting import fit, make_target
from bayesfric.inference.posterior import Status
from bayesfric.inference.sampling import sample
from bayesfric.population.joint_runs import JointTarget, varying_parts
from bayesfric.population.population import Interval, Varying, interval
from bayesfric.results.reported import LEVEL, Outcome, outcome_of


@dataclass(frozen=True)
class PooledParameter:
    """A parameter that differs between recordings."""

    name: str
    unit: str
    jointly: Varying
    findings: tuple[str, ...]  # kinds of doubts that move it in a recording


@dataclass(frozen=True)
class SharedParameter:
    """A parameter that all recordings share."""

    name: str
    unit: str
    value: Interval
    findings: tuple[str, ...]


@dataclass(frozen=True)
class Pooled:
    """Result of all recordings together; intervals hold ``level``."""

    recordings: tuple[str, ...]
    varying: tuple[PooledParameter, ...]
    shared: tuple[SharedParameter, ...]
    level: float
    status: Status
    outcome: Outcome
    findings: tuple[Finding, ...]  # of each recording
    problems: tuple[str, ...]
    warnings: tuple[str, ...]  # of :func:`bayesfric.check`
    seconds: float
    cpu_seconds: float

    def as_json(self) -> dict[str, Any]:
        """Return JSON data."""
        return asdict(self) | {"findings": [finding.as_dict() for finding in self.findings]}


def pool(
    model: Model, *, seed: int | None = None, progress: ProgressCallback = no_progress
) -> Pooled:
    """Fit recordings of a model separately, then all together while some parameters differ.

    Parameters
    ----------
    model
        A model whose ``vary``, or table ``pooling``, names these parameters.
    seed
        Replaces that of the table ``sampling``.
    progress
        Progress callback.

    Raises
    ------
    BadInput
        If no parameter is named or one is fixed, or recordings are too few, or too many for one
        posterior, or the likelihood is that of the output error.
    """
    timer = Timer()
    if model.config.tables.mechanism.auto:
        model = model.completed(progress=progress)[0]
    vary, settings = list(model.config.tables.pooling.vary), model.settings(seed)
    _check(model, vary)
    choice = model.starting_point(progress=progress).choice
    noise, priors = model.with_noise(choice)
    targets, posteriors, discrepancies = [], [], []
    explained: list[Explanation] = []
    for k, observation in enumerate(model.observations):
        progress(Progress(f"recording {observation.name}"))
        target = make_target(model.chain, [observation], priors, "shared", noise)
        with model.config.named():
            single = fit(target, settings.model_copy(update={"seed": settings.seed + k}))
        if single.posterior.diagnostics.status == "unusable":
            raise BadInput(
                f"recording {observation.name!r}",
                "its own posterior cannot be sampled",
                "fit it alone first, 'bayesfric fit' says why",
            )
        targets.append(single.target)
        posteriors.append(single.posterior)
        explained.append(model.alone(k).explain(progress=progress))
        discrepancies.append(discrepancy(single.target, single.posterior, explained[-1].missing))
    names = [o.name for o in model.observations]
    progress(Progress("all recordings together"))
    joint = JointTarget(targets, names, vary, posteriors, settings.seed)
    posterior = sample(joint, joint.start, settings)
    units = {p.name: p.unit for p in model.chain.parameters}
    draws = joint.widened(posterior, discrepancies)
    jointly = varying_parts(posterior, draws, names, vary, LEVEL)
    findings = tuple(
        replace(finding, recording=name)
        for name, explanation, errors in zip(names, explained, discrepancies, strict=True)
        for finding in explanation.with_severity(widened=errors.is_plausible)
    )
    doubts = [finding for finding in findings if finding.severity == "doubt"]
    moved_by = {
        name: tuple(dict.fromkeys(finding.kind for finding in doubts if name in finding.moves))
        for name in units
    }
    status = posterior.diagnostics.status
    return Pooled(
        recordings=tuple(names),
        varying=tuple(
            PooledParameter(name, units[name], jointly[name], moved_by[name]) for name in vary
        ),
        shared=tuple(
            SharedParameter(name, units[name], interval(draws[:, j], LEVEL), moved_by[name])
            for j, name in enumerate(posterior.names)
            if name in units
        ),
        level=LEVEL,
        status=status,
        outcome=outcome_of(
            converged=status == "reliable",
            doubted=bool(doubts),
            lacking=bool(findings) and any(errors.is_plausible for errors in discrepancies),
            tested=not any(e.reason for e in explained),
        ),
        findings=findings,
        problems=posterior.diagnostics.problems,
        warnings=check(model).warnings,
        seconds=timer.seconds,
        cpu_seconds=timer.cpu_seconds,
    )


def _check(model: Model, vary: Sequence[str], *, largest: int = 12) -> None:
    """Refuse what cannot be pooled, such as more recordings than the ``largest`` posterior."""
    names = model.chain.names
    if not vary:
        problem = "names no parameter that varies"
        raise BadInput(
            "pooling.vary", problem, 'write for example { "motor.viscous" = "recording" }'
        )
    for name in vary:
        if name not in names:
            raise BadInput(
                f"pooling.vary.{name}", "the mechanism has no such parameter", nearest(name, names)
            )
        if model.priors[name].fixed:
            raise BadInput(f"pooling.vary.{name}", "is fixed", "give it a prior")
    if all(name in vary for name in names if not model.priors[name].fixed):
        raise BadInput(
            "pooling.vary",
            "names every parameter, and nothing is shared",
            "fit each recording alone, and 'bayesfric compare' the runs",
        )
    if model.config.tables.likelihood.method != "input-error":
        problem = "recordings are pooled by their torque"
        raise BadInput("likelihood.method", problem, 'take "input-error"')
    count = len(model.observations)
    if count < 2:
        raise BadInput("recordings", "one recording is not a population", "add another")
    if count > largest:
        raise BadInput(
            "recordings",
            f"{count} are too many for one posterior, {largest} at most",
            "fit each alone, and 'bayesfric compare' the runs",
        )
