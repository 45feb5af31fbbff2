"""Several recordings of one joint of which some parameters differ: one posterior of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.progress import Progress, Shown, Spent
from bayesfric.diagnostics.explanation import Explanation
from bayesfric.diagnostics.finding import Finding
from bayesfric.fit.check_report import check
from bayesfric.inference.discrepancy import discrepancy
from bayesfric.inference.fitting import fit, make_target
from bayesfric.inference.posterior import Status
from bayesfric.inference.sampling.sampling import sample
from bayesfric.population.joint_runs import JointTarget, varying_parts
from bayesfric.population.population import Interval, Varying, interval
from bayesfric.problem.problem import Problem, starting_point
from bayesfric.results.verdict import Outcome, verdict

LEVEL = 0.9
# Runs that a joint posterior has room for.
_MOST = 12


@dataclass(frozen=True)
class PooledParameter:
    """One that differs from recording to recording."""

    name: str
    unit: str
    jointly: Varying
    findings: tuple[str, ...]  # kinds of doubts that move it in a recording


@dataclass(frozen=True)
class SharedParameter:
    """One that all recordings have, by the joint posterior."""

    name: str
    unit: str
    value: Interval
    findings: tuple[str, ...]


@dataclass(frozen=True)
class Pooled:
    """What recordings say together; intervals hold ``level``."""

    recordings: tuple[str, ...]
    varying: tuple[PooledParameter, ...]
    shared: tuple[SharedParameter, ...]
    level: float
    status: Status
    outcome: Outcome
    findings: tuple[Finding, ...]  # what else explains each recording's torque
    problems: tuple[str, ...]
    warnings: tuple[str, ...]  # of :func:`bayesfric.check`
    seconds: float  # of all that was sampled, by the clock
    cpu_seconds: float

    def as_json(self) -> dict[str, Any]:
        """Give strings, numbers, lists and dicts."""
        return asdict(self)


def pooled(problem: Problem, seed: int | None, progress: Shown) -> Pooled:
    """Fit every recording alone, then all together, as a model's configuration says.

    ``seed`` replaces the configuration's.

    BadInput for fewer than two recordings, too many for one posterior, names that the joint does
    not have or that are known, and an output-error likelihood.
    """
    spent = Spent()
    tables = problem.config.tables
    settings, vary = tables.sampling, list(tables.pooling.vary)
    if seed is not None:
        settings = settings.model_copy(update={"seed": seed})
    _check(problem, vary)
    choice = starting_point(problem, progress=progress).choice
    noise, priors = problem.with_noise(choice)
    targets, alone, rooms = [], [], []
    explained: list[Explanation] = []
    for k, observation in enumerate(problem.observations):
        progress(Progress(f"recording {observation.name}"))
        target = make_target(problem.chain, [observation], priors, "shared", noise)
        with problem.config.named():
            found = fit(target, settings.model_copy(update={"seed": settings.seed + k}))
        if found.posterior.diagnostics.status == "unusable":
            raise BadInput(
                f"recording {observation.name!r}",
                "its own posterior cannot be sampled",
                "fit it alone first, 'bayesfric fit' says why",
            )
        targets.append(found.target)
        alone.append(found.posterior)
        explained.append(problem.alone(k).explain(progress=progress))
        rooms.append(discrepancy(found.target, found.posterior, explained[-1].missing))
    names = [o.name for o in problem.observations]
    progress(Progress("all recordings together"))
    together = JointTarget(targets, names, vary, alone, settings.seed)
    posterior = sample(together, together.start, settings)  # type: ignore[arg-type]
    units = {p.name: p.unit for p in problem.chain.parameters}
    flat = together.widened(posterior, rooms)
    jointly = varying_parts(posterior, flat, names, vary, LEVEL)
    findings = tuple(
        replace(one, recording=name)
        for name, asked, own in zip(names, explained, rooms, strict=True)
        for one in asked.with_severity(widened=own.is_plausible)
    )
    doubts = [one for one in findings if one.severity == "doubt"]
    moved = {
        name: tuple(dict.fromkeys(one.kind for one in doubts if name in one.moves))
        for name in units
    }
    status = posterior.diagnostics.status
    return Pooled(
        recordings=tuple(names),
        varying=tuple(
            PooledParameter(name, units[name], jointly[name], moved[name]) for name in vary
        ),
        shared=tuple(
            SharedParameter(name, units[name], interval(flat[:, j], LEVEL), moved[name])
            for j, name in enumerate(posterior.names)
            if name in units
        ),
        level=LEVEL,
        status=status,
        outcome=verdict(
            converged=status == "reliable",
            doubts=len(doubts),
            doubtful=sum(map(bool, moved.values())),
            asked=None if any(one.reason for one in explained) else len(explained[0].kinds),
            explained=None,
            lacking=bool(findings) and any(one.is_plausible for one in rooms),
        ).outcome,
        findings=findings,
        problems=posterior.diagnostics.problems,
        warnings=check(problem).warnings,
        seconds=spent.seconds,
        cpu_seconds=spent.cpu_seconds,
    )


def _check(problem: Problem, vary: Sequence[str]) -> None:
    names = problem.chain.names
    if not vary:
        what = "names no parameter that varies"
        raise BadInput("pooling.vary", what, 'write for example { "motor.viscous" = "recording" }')
    for name in vary:
        if name not in names:
            raise BadInput(
                f"pooling.vary.{name}", "the mechanism has no such parameter", nearest(name, names)
            )
        if problem.priors[name].fixed:
            raise BadInput(f"pooling.vary.{name}", "is fixed", "give it a prior")
    if all(name in vary for name in names if not problem.priors[name].fixed):
        raise BadInput(
            "pooling.vary",
            "names every parameter, and nothing is shared",
            "fit each recording alone, and 'bayesfric compare' the runs",
        )
    if problem.config.tables.likelihood.method != "input-error":
        what = "recordings are pooled by their torque"
        raise BadInput("likelihood.method", what, 'take "input-error"')
    count = len(problem.observations)
    if count < 2:
        raise BadInput("recordings", "one alone is no population", "add another")
    if count > _MOST:
        raise BadInput(
            "recordings",
            f"{count} are too many for one posterior, {_MOST} at most",
            "fit each alone, and 'bayesfric compare' the runs",
        )
