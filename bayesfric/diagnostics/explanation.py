"""What else explains the torque, as findings: kind, shifts of parameters, and setting."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

from bayesfric.diagnostics.candidates import BY_NAME, Kind
from bayesfric.diagnostics.motion import TURNS
from bayesfric.diagnostics.regression import Finding, Replicate, regression_of
from bayesfric.diagnostics.replicates import ReplicateError, subsample
from bayesfric.diagnostics.statistics import LONGEST, Columns, least_outputs
from bayesfric.estimates.input_error import few_threads
from bayesfric.estimates.point_estimate import HALF as MOVES
from bayesfric.inference.discrepancy import Missing
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import CHOICES, CYCLES, LOAD_CHOICES
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.signals import Signals
from bayesfric.recordings.source import Processing

if TYPE_CHECKING:
    import pandas as pd


import numpy as np
from pydantic import Field

from bayesfric.base.options import Options
from bayesfric.inference.closed_loop import ClosedLoopLikelihood
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.posterior import Posterior
from bayesfric.inference.target import Target, units_of
from bayesfric.recordings.arrays import Array

Reason = Literal["few", "still"]


@dataclass(frozen=True)
class Explanation:
    """Missing effects in the torque of recordings."""

    findings: tuple[Finding, ...] = ()  # significant effects in the order of selection
    kinds: tuple[str, ...] = ()  # of candidates that were tested
    # kinds that are collinear with the model on this motion
    indistinguishable: tuple[str, ...] = ()
    replicates: tuple[Replicate, ...] = field(default=(), repr=False)  # null distribution
    # largest statistic of all candidates as a standard normal, before any is included, and its
    # critical value
    largest: float = 0.0
    limit: float = 0.0
    cpu_seconds: float = 0.0  # of the regression and its replicates
    # why it was not evaluated: too few outputs, or most replicates stand still
    reason: Reason | None = None
    # share of the samples that was evaluated; below one for long recordings
    share: float = 1.0
    # all candidates, for model discrepancy
    missing: Missing | None = field(default=None, repr=False)

    @property
    def applicable(self) -> tuple[Finding, ...]:
        """Findings whose setting may be applied; none if the recording is faulty."""
        faulty = bool(self.findings) and of_recording(self.findings[0].kind)
        return tuple(finding for finding in self.findings if finding.applicable and not faulty)

    def with_severity(self, *, widened: bool) -> tuple[Finding, ...]:
        """Return findings; marginalised ones are notes if intervals are ``widened`` for them.

        A fault of the recording stays a doubt: no term could be marginalised.
        """
        marginalised = self.missing.kinds if self.missing and widened else {}
        return tuple(
            replace(finding, severity="note")
            if finding.kind in marginalised and not of_recording(finding.kind)
            else finding
            for finding in self.findings
        )

    @property
    def frame(self) -> pd.DataFrame:
        """A row for each finding."""
        import pandas as pd

        return pd.DataFrame([finding.as_dict() for finding in self.findings])

    def as_json(self) -> dict[str, Any]:
        """Return everything as JSON data."""
        names = "largest", "limit", "cpu_seconds", "reason", "share"
        return {
            "findings": [finding.as_dict() for finding in self.findings],
            "kinds": list(self.kinds),
            "untold": list(self.indistinguishable),
            "twins": len(self.replicates),
            **{name: getattr(self, name) for name in names},
        }


def too_few_outputs(chain: Joint, observations: Sequence[Signals]) -> Reason | None:
    """Return the reason why recordings cannot be evaluated, if there is one beforehand."""
    few = sum(o.measured.size for o in observations) < len(chain.names) + least_outputs(
        observations
    )
    return "few" if few else None


def explain(
    chain: Joint,
    recordings: Sequence[Measurement],
    observations: Sequence[Signals],
    processing: Processing,
    point: Mapping[str, float],
    known: Sequence[str],
    seed: int,
) -> Explanation:
    """Find what else explains the torque of recordings."""
    begun, values = time.process_time(), chain.vector(point)
    samples = sum(r.time.size for r in recordings)
    try:
        with few_threads(observations):
            if samples > LONGEST:
                limits = [LONGEST * r.time.size // (2 * samples) for r in recordings]
                pairs = zip(recordings, observations, limits, strict=True)
                subsamples = [subsample(chain, values, r, o, processing, n) for r, o, n in pairs]
                recordings, observations = zip(*subsamples, strict=True)
            share = sum(r.time.size for r in recordings) / samples
            regression, simulated = regression_of(
                chain, recordings, observations, processing, values, known, seed
            )
            effects = regression.effects()
    except ReplicateError:
        return Explanation(reason="still")
    return Explanation(
        # the full recordings have smaller standard deviations than subsamples
        tuple(finding_of(chain, e, share**-0.5) for e in effects if e.significant),
        regression.kinds,
        regression.indistinguishable,
        simulated,
        effects[0].largest,
        effects[0].limit,
        time.process_time() - begun,
        share=share,
        missing=regression.missing(observations),
    )


def of_recording(name: str) -> bool:
    """Whether a kind of finding is a fault of the recorded torque."""
    return name in BY_NAME and BY_NAME[name].of_recording


def finding_of(chain: Joint, effect: Finding, sharper: float = 1.0) -> Finding:
    """Complete a fitted effect, its shifts in standard deviations ``sharper`` times as many.

    An effect with an impossible sign is named after a rival that may have it, if there is one.
    """
    kind, rivals, shape = BY_NAME.get(effect.kind), effect.rivals, effect.shape
    negative = kind is not None and kind.positive and bool((effect.coefficients < 0.0).any())
    if kind is not None and negative and kind.other:
        kind, negative = replace(kind, choice=kind.other), False
    others = [BY_NAME[name] for name in rivals if name in BY_NAME]
    others = [other for other in others if not (other.positive or other.of_recording)]
    if negative and others:
        kind, shape, negative = others[0], "", False
        rivals = (effect.kind, *(name for name in rivals if name != kind.name))
    moves = {name: sharper * x for name, x in effect.moves.items()}
    moves = {name: x for name, x in moves.items() if abs(x) > MOVES}
    return replace(
        effect,
        kind=effect.kind if kind is None else kind.name,
        severity="doubt" if moves or (kind and kind.of_recording) else "note",
        shape=shape,
        rivals=rivals,
        moves=dict(sorted(moves.items(), key=lambda item: -abs(item[1]))),
        setting="" if kind is None else setting_of(chain, kind, shape),
        physical=not negative,
    )


def _carries(chain: Joint) -> bool:
    """Whether the element with load-dependent friction, or the last one, carries a load."""
    lossy = [k for k, e in enumerate(chain.elements) if e.load_loss != "none"]
    behind = chain.elements[(lossy[0] if lossy else len(chain.elements) - 1) + 1 :]
    return bool(chain.load.choices) or any(e.has("inertia") for e in behind)


def setting_of(chain: Joint, kind: Kind, shape: str) -> str:
    """Return the line of a configuration that adds a candidate to a joint, or an empty string."""
    option, value = kind.option, "true" if kind.choice is True else f'"{kind.choice}"'
    if option in ("offset", "delay"):
        return "" if getattr(chain, option) else f"mechanism.{option} = true"
    if option in LOAD_CHOICES and option not in CHOICES:
        if option in chain.load.choices:
            return ""
        if option == "gravity_angle" and "first_moment" not in chain.load.choices:
            return "mechanism.load = { first_moment = true, gravity_angle = true }"
        return f"mechanism.load.{option} = true"
    elements = chain.elements
    if option in CYCLES:
        cycles, side = TURNS.get(shape, (1, "joint"))
        reach = chain.ratio if side == "motor" else 1.0
        elements = tuple(e for e in elements if chain.reaches[e.name] == reach)
        value = f"[{cycles}]"
    elif option.startswith("load_"):
        if not _carries(chain):
            return ""  # that needs another line, which moves the inertia behind it
        # of two in series only the product is identifiable
        lossy = [e for e in elements if e.load_loss != "none"]
        elements = tuple(lossy or elements[-1:])
        if not lossy and option != "load_loss":  # the option shapes a load-dependent friction
            option, value = "load_loss", '"one"'
    elif option not in CHOICES:
        return ""
    for element in elements:
        if element.choices.get(option) != kind.choice:
            return f"mechanism.elements.{element.name}.{option} = {value}"
    return ""


CheckReason = Literal["likelihood", "rest", "sampling", "still", "few"]


class CalibrationCheckOptions(Options):
    """The ``[self_check]`` table."""

    recordings: int | None = Field(
        None,
        ge=0,
        examples=[0],
        description="0 to skip it; else simulated replicates of the recordings are fitted",
    )


@dataclass(frozen=True, eq=False)
class CalibrationCheck:
    """True parameters of replicates without torque noise, and the fits to them."""

    truth: Array  # (n, d) sampled parameters
    # (n, d) a short step from the truth towards the estimate, and (n,) its share of the full step:
    # full steps along unidentified directions have any length
    near_truth: Array
    steps: Array
    unexplained: Array  # (n,) mean square of the residual over the noise variance
    seconds: float
    cpu_seconds: float
    # Why it was not made: a likelihood of the position, samples at standstill, failed sampling,
    # replicates that stand still, or too few outputs
    reason: CheckReason | None = None
    share: float = 1.0  # of the recordings' samples; below one for subsamples


def calibration_check(
    target: Target,
    posterior: Posterior,
    observations: Sequence[Signals],
    explained: Explanation,
) -> CalibrationCheck:
    """Estimate the bias by filters, encoder and differentiation, by a parametric bootstrap.

    The mean of estimate less truth over the replicates is the bias (Efron and Tibshirani, "An
    Introduction to the Bootstrap", 1993). Each fit is one Gauss-Newton step from the truth, as the
    torque is nearly linear in the parameters; replicates have no torque noise, so few suffice.
    """
    begun, worked = time.perf_counter(), time.process_time()
    reason: CheckReason | None = explained.reason
    if not isinstance(target.likelihood, TorqueLikelihood | ClosedLoopLikelihood):
        reason = "likelihood"
    elif any(o.rest is not None for o in observations):
        reason = "rest"
    elif posterior.diagnostics.status == "unusable":
        reason = "sampling"
    replicates = () if reason else explained.replicates
    columns = [target.likelihood.chain.names.index(name) for name in target.free]
    truth = np.tile(posterior.median, (len(replicates), 1))
    for row, (values, _) in zip(truth, replicates, strict=True):  # the noise stays the posterior's
        row[: len(columns)] = values[columns]
    near_truth, (steps, unexplained) = truth.copy(), np.ones((2, len(truth)))
    for k, (_, replicate) in enumerate(replicates):
        fit = _fit(target, truth[k], replicate, columns, explained.share)
        near_truth[k], steps[k], unexplained[k] = fit
    seconds = time.perf_counter() - begun, time.process_time() - worked
    return CalibrationCheck(
        truth, near_truth, steps, unexplained, *seconds, reason, explained.share
    )


def _fit(
    target: Target, truth: Array, replicate: Columns, columns: Sequence[int], share: float
) -> tuple[Array, float, float]:
    """Take one Gauss-Newton step from the true parameters ``(d,)`` of a replicate.

    The prior is centred on the truth, as its pull is no bias; for a subsample its information is
    scaled by ``share``.
    """
    k, likelihood = len(target.free), target.likelihood
    units, scales = units_of(target, truth), target.noise.scales(truth[None, k:])[0]
    white = np.column_stack([replicate.base[:, columns] * units.units, replicate.residual])
    if isinstance(likelihood, TorqueLikelihood):  # prediction errors are white
        parts = zip(replicate.layout.split(white), replicate.layout.runs, scales, strict=True)
        standard = likelihood.noise.standard
        white = np.concatenate([standard(x.T, runs, scale)[0].T for x, runs, scale in parts])
    jacobian, error = white[:, :-1], white[:, -1]
    sds = np.array([prior.sd() for prior in target.priors[:k]])
    precision = np.where(np.isfinite(sds), (units.units / sds) ** 2, 0.0)
    information = jacobian.T @ jacobian + share * np.diag(precision)
    step = np.asarray(np.linalg.lstsq(information, jacobian.T @ error)[0], dtype=np.float64)
    # quantities are assumed to be linear along a thousandth of the parameters' units
    step_share = 1e-3 / max(float(np.abs(step).max(initial=0.0)), 1e-3)
    near_truth = np.concatenate([units.moved(truth[:k], step_share * step), truth[k:]])
    residual = error - jacobian @ step
    return near_truth, step_share, float(np.mean(residual**2))
