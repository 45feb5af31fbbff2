"""What is measured, its quality and its problems: all there is to say before a fit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayesfric.diagnostics.before_a_fit import (
    against_prior,
    doubts_before,
    few_outputs,
    little_explained,
)
from bayesfric.inference.noise import SCALES
from bayesfric.problem.problem import Problem
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import Observation
from bayesfric.report.numbers import TEXT
from bayesfric.report.summary.summary import estimate_summary
from bayesfric.report.terminal import aligned, shortened, wrapped
from bayesfric.report.words import doubt_text, line_of

# Recordings, and doubts, that are named one by one.
_MANY = 5


@dataclass(frozen=True)
class CheckReport:
    """What was read, and what looks wrong."""

    found: Mapping[str, Any]

    def as_json(self) -> dict[str, Any]:
        """Give what ``bayesfric check --json`` prints."""
        return dict(self.found)

    def text(self, *, verbose: bool = False) -> str:
        """Say it for people; ``verbose`` with every step and prior."""
        return "\n".join(_lines(self.found, verbose))

    @property
    def warnings(self) -> tuple[str, ...]:
        """What looks wrong, a sentence each: of every recording, then of all together."""
        rows = self.found["recordings"]
        said = [f"{one['name']}: {text}" for one in rows for text in one["warnings"]]
        return (*said, *map(doubt_text, self.found["doubts"]))


def check(model: Problem | Path | str) -> CheckReport:
    """Say what is measured, its quality and its problems, before anything is fitted.

    Parameters
    ----------
    model
        A model, or the file of a configuration.

    Raises
    ------
    BadInput
        For anything that cannot be used.
    """
    model = model if isinstance(model, Problem) else Problem.from_config(model)
    return CheckReport(_found(model))


def _found(model: Problem) -> dict[str, Any]:
    explained, auto = model.explain(), model.config.tables.mechanism.auto
    # what a fit begins to put in is no doubt; what is left then, it asks anew
    taken = explained.applicable if auto else ()
    (totals,) = model.estimates(["least-squares"])
    findings = [one.as_dict() for one in explained.findings if one not in taken]
    (point,) = model.estimates(["input-error"])
    doubts = [
        *against_prior(model.contradicted(dict(point.point))),
        *little_explained(model.chain, model.observations),
        *doubts_before(totals, model.observations),
        *(one | {"kind": "missing", "what": one["kind"]} for one in findings),
        *few_outputs(model.observations, len(model.chain.names)),
    ]
    if model.chain.unseen_inertia:
        doubts.append({"kind": "unseen-inertia", "names": list(model.chain.unseen_inertia)})
    unsettled = {f"noise.{scale.name}" for scale in SCALES.values() if scale.chosen}
    return {
        "config": str(model.config.path),
        "mechanism": {
            "preset": model.chain.made_from,
            "ratio": model.chain.ratio,
            "elements": [element.name for element in model.chain.elements],
        },
        "recordings": [
            {
                "name": recording.name,
                "held_out": part,
                "file": recording.path and str(recording.path),
                "sha256": recording.sha256,
                "duration": float(recording.time[-1] - recording.time[0]),
                "added_mass": recording.inputs.added_mass,
                "radius": recording.inputs.radius,
                "settings": observation.settings,
                "steps": list(observation.steps),
                "warnings": list(observation.warnings),
            }
            for recording, observation, part in _parts(model)
        ],
        "priors": {
            name: {"prior": prior.text, "default": prior.default}
            for name, prior in model.priors.items()
            # whether the noise remembers, the residuals of an estimate will say
            if not (prior.default and name in unsettled)
        },
        "doubts": doubts,
        "taken": [one.as_dict() for one in taken],
        "findings": findings,
        "least_squares": estimate_summary(totals),
    }


def _parts(model: Problem) -> Iterator[tuple[Measurement, Observation, str | None]]:
    """Everything read, with which part of a recording is held out where one is."""
    for recording, observation in zip(model.recordings, model.observations, strict=True):
        yield recording, observation, None
    for one in model.held_out:
        yield one.recording, one.observation, one.part


def _lines(found: Mapping[str, Any], verbose: bool) -> Iterator[str]:
    recordings, most = found["recordings"], None if verbose else _MANY
    for one in recordings[:most]:
        told = one["settings"]
        rate = f" at {told['sampling_rate']:.4g} Hz" if told.get("sampling_rate") else ""
        band = f", compared up to {told['band']:.3g} Hz" if told.get("band") else ""
        held = f", {one['held_out']} held out" if one["held_out"] else ""
        yield shortened(f"{one['name']}: {one['duration']:.4g} s{rate}{band}{held}")
        if verbose:
            yield from _steps(one)
    if verbose:
        yield from ("", "Priors")
        for name, prior in found["priors"].items():
            yield f"  {name:<28} {prior['prior']}{'  (default)' if prior['default'] else ''}"
    elif len(recordings) > _MANY:
        yield f"and {len(recordings) - _MANY} more"
    totals = found["least_squares"]
    cells = [("", "least squares", "±", "", "")]
    for name, v in totals["parameters"].items():
        if v["sd"] is None:
            cells.append((name, "not determined", "", "", v["unit"]))
        else:
            sd = max(v["sd"], v["sd_robust"] or 0.0)
            cells.append(
                (name, TEXT.ends(v["value"], 0, 0, sd), TEXT.ends(sd, 0, 0, sd), "", v["unit"])
            )
    yield ""
    yield from aligned(cells)
    if (rms := totals["residual_rms"]) is not None:
        yield f"{rms:.3g} {totals['residual_unit']} rms left"
    yield ""
    if verbose:
        yield from (line_of("put in", one) for one in found["taken"])
        yield from (f"WARNING: {doubt_text(doubt)}" for doubt in found["doubts"])
    else:
        yield from _doubts(found)


def _steps(recording: Mapping[str, Any]) -> Iterator[str]:
    yield f"  {recording['file']}"
    if recording["added_mass"]:
        at = f" at {recording['radius']:g} m" if recording["radius"] else ""
        yield f"  added mass: {recording['added_mass']:g} kg{at}"
    yield from (f"  {step}" for step in recording["steps"])
    yield from (f"  WARNING: {warning}" for warning in recording["warnings"])


def _doubts(found: Mapping[str, Any]) -> Iterator[str]:
    lines = [line_of(doubt["kind"], doubt) for doubt in found["doubts"]]
    said = Counter(text.split(";")[0] for one in found["recordings"] for text in one["warnings"])
    lines += [text if n == 1 else f"{text} ({n} recordings)" for text, n in said.items()]
    for one in found["taken"]:
        yield from wrapped(f"fit will put in: {line_of(one['kind'], one)}", indent=2)
    for line in lines[:_MANY]:
        yield from wrapped(f"! {line}", indent=2)
    if len(lines) > _MANY:
        yield f"  and {len(lines) - _MANY} more: --verbose"
    if not lines and not found["taken"]:
        yield "Nothing stands out."
