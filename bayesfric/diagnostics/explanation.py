"""What else explains the torque, as findings: what it is, what it moves, and what puts it in.

Between the regression that ranks candidates and the report: its steps become findings, with the
line of a configuration that adds the term where there is one.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

from bayesfric.diagnostics.along import TURNS
from bayesfric.diagnostics.candidates import BY_NAME, Kind
from bayesfric.diagnostics.finding import Finding
from bayesfric.diagnostics.policy import (
    LEAST_OUTPUTS,
    LONGEST,
    MOVES,
)
from bayesfric.diagnostics.regression import Regression, Step, Replicate
from bayesfric.diagnostics.replicates import ReplicateError, excerpt
from bayesfric.estimates.descent import few_threads
from bayesfric.inference.missing import Missing
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import CHOICES, CYCLES, LOAD_CHOICES
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import Observation
from bayesfric.recordings.processing import Processing

if TYPE_CHECKING:
    import pandas as pd

Reason = Literal["few", "still"]


@dataclass(frozen=True)
class Explanation:
    """What else explains the torque of recordings."""

    findings: tuple[Finding, ...] = ()  # Of what is no chance, in the order of the ranking
    kinds: tuple[str, ...] = ()  # Of candidates that were asked
    untold: tuple[str, ...] = ()  # Kinds that this motion does not tell from what the model has
    replicates: tuple[Replicate, ...] = field(
        default=(), repr=False
    )  # Simulated recordings that judge
    # Of all candidates' statistics, a standard normal's, before any is taken in; and what 95 % of
    # the replicates stay below, or what as many independent normals do, the larger of the two
    largest: float = 0.0
    limit: float = 0.0
    cpu_seconds: float = 0.0  # Spent on the regression and its replicates
    # Why it was not asked: there are too few outputs, or most replicates stand still; else None
    reason: Reason | None = None
    # Of the samples that were asked, the share of all; below one for long recordings
    share: float = 1.0
    # All candidates, to be marginalised as model discrepancy
    missing: Missing | None = field(default=None, repr=False)

    @property
    def asked(self) -> bool:
        """Whether there is an answer."""
        return self.reason is None

    @property
    def put_in(self) -> tuple[Finding, ...]:
        """Findings that a model may be completed by; none where the recording is at fault first."""
        faulty = bool(self.findings) and of_recording(self.findings[0].kind)
        return () if faulty else tuple(one for one in self.findings if one.put_in)

    def noted(self, *, widened: bool) -> tuple[Finding, ...]:
        """Give findings; of what is marginalised a note, where intervals are ``widened`` for it.

        A fault of the recording stays a doubt: it is no term whose size could be averaged over.
        """
        room = self.missing.kinds if self.missing and widened else {}
        return tuple(
            replace(one, severity="note")
            if one.kind in room and not of_recording(one.kind)
            else one
            for one in self.findings
        )

    @property
    def frame(self) -> pd.DataFrame:
        """A row for each finding."""
        import pandas as pd

        return pd.DataFrame([one.as_dict() for one in self.findings])

    def as_json(self) -> dict[str, Any]:
        """Give all of it as JSON holds it."""
        told = {
            "kinds": list(self.kinds),
            "untold": list(self.untold),
            "twins": len(self.replicates),
        }
        told |= {"largest": self.largest, "limit": self.limit}
        told |= {"cpu_seconds": self.cpu_seconds, "reason": self.reason, "share": self.share}
        return {"findings": [one.as_dict() for one in self.findings], **told}


def unasked(chain: Joint, observations: Sequence[Observation]) -> Reason | None:
    """Say why recordings cannot be asked, as far as that is known before anything is computed."""
    few = sum(o.measured.size for o in observations) < len(chain.names) + LEAST_OUTPUTS
    return "few" if few else None


def explain(
    chain: Joint,
    recordings: Sequence[Measurement],
    observations: Sequence[Observation],
    processing: Processing,
    point: Mapping[str, float],
    known: Sequence[str],
    seed: int,
) -> Explanation:
    """Ask recordings what else explains their torque."""
    begun, values = time.process_time(), chain.vector(point)
    whole = sum(r.time.size for r in recordings)
    try:
        with few_threads(observations):
            if whole > LONGEST:
                most = [LONGEST * r.time.size // (2 * whole) for r in recordings]
                each = zip(recordings, observations, most, strict=True)
                made = [excerpt(chain, values, r, o, processing, n) for r, o, n in each]
                recordings, observations = zip(*made, strict=True)
            share = sum(r.time.size for r in recordings) / whole
            asked = Regression(chain, recordings, observations, processing, values, known, seed)
            # what moves a number by so many sds of an excerpt's is more of the whole's
            steps = [_sharpened(step, share**-0.5) for step in asked.steps()]
    except ReplicateError:
        return Explanation(reason="still")
    return Explanation(
        tuple(finding(chain, step) for step in steps if step.sure),
        asked.kinds,
        asked.untold,
        asked.simulated,
        steps[0].largest,
        steps[0].limit,
        time.process_time() - begun,
        share=share,
        missing=asked.missing(),
    )


def of_recording(name: str) -> bool:
    """Whether a finding is a fault of the recorded torque, by its kind."""
    return name in BY_NAME and BY_NAME[name].of_recording


def _sharpened(step: Step, factor: float) -> Step:
    """Count what a step moves in standard deviations that are smaller by a factor."""
    return replace(step, moves={name: factor * x for name, x in step.moves.items()})


def finding(chain: Joint, step: Step) -> Finding:
    """Say one step of the ranking as a finding.

    What has a sign that it cannot have stands for what this motion hardly tells it from, where that
    may have any; else it has no name.
    """
    kind, rivals, shape = BY_NAME.get(step.kind), step.alike, step.shape
    negative = kind is not None and kind.positive and bool((step.coefficients < 0.0).any())
    if kind is not None and negative and kind.other:
        kind, negative = replace(kind, choice=kind.other), False
    others = [BY_NAME[name] for name in rivals if name in BY_NAME and not BY_NAME[name].positive]
    others = [other for other in others if not other.of_recording]
    if negative and others:
        kind, shape, negative = others[0], "", False
        rivals = (step.kind, *(name for name in rivals if name != kind.name))
    far = {name: x for name, x in step.moves.items() if abs(x) > MOVES}
    return Finding(
        kind=step.kind if kind is None else kind.name,
        severity="doubt" if far or (kind and kind.of_recording) else "note",
        statistic=step.z,
        p=step.p,
        shape=shape,
        share=step.share,
        rivals=rivals,
        moves=dict(sorted(far.items(), key=lambda one: -abs(one[1]))),
        setting="" if kind is None else setting_of(chain, kind, shape),
        physical=not negative,
        recording=step.recording,
        span=step.span,
    )


def _carries(chain: Joint) -> bool:
    """Whether the element that loses by the load, or would, has anything behind it."""
    lossy = [k for k, e in enumerate(chain.elements) if e.load_loss != "none"]
    behind = chain.elements[(lossy[0] if lossy else len(chain.elements) - 1) + 1 :]
    return bool(chain.load.choices) or any(e.has("inertia") for e in behind)


def setting_of(chain: Joint, kind: Kind, shape: str) -> str:
    """Give the line of a configuration that puts a candidate into a joint; empty if none does."""
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
            return ""  # a line more would be needed, which moves the inertia behind it
        # of two, one behind the other, no motion tells more than their product
        lossy = [e for e in elements if e.load_loss != "none"]
        elements = tuple(lossy or elements[-1:])
        if not lossy and option != "load_loss":  # which shapes one
            option, value = "load_loss", '"one"'
    elif option not in CHOICES:
        return ""
    for element in elements:
        if element.choices.get(option) != kind.choice:
            return f"mechanism.elements.{element.name}.{option} = {value}"
    return ""
