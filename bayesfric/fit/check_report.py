"""Report on recordings before a fit: what is measured, its quality and its problems."""

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
from bayesfric.diagnostics.regression import Finding
from bayesfric.fit.model import Model
from bayesfric.inference.noise import SCALES
from bayesfric.report.numbers import TEXT
from bayesfric.report.summary.summary import estimate_table
from bayesfric.report.terminal import aligned, shortened, wrapped
from bayesfric.report.words import doubt_text, line_of

# Largest number of recordings, and of doubts, that are listed.
_MANY = 5


@dataclass(frozen=True)
class CheckReport:
    """What was read, and its problems."""

    record: Mapping[str, Any]

    def as_json(self) -> dict[str, Any]:
        """Return what ``bayesfric check --json`` prints."""
        return dict(self.record)

    def text(self, *, verbose: bool = False) -> str:
        """Return the report as text; ``verbose`` with every step and prior."""
        return "\n".join(_lines(self.record, verbose))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of every recording, then of all together."""
        rows = self.record["recordings"]
        texts = [f"{row['name']}: {text}" for row in rows for text in row["warnings"]]
        return (*texts, *map(doubt_text, self.record["doubts"]))


def check(model: Model | Path | str) -> CheckReport:
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
    model = model if isinstance(model, Model) else Model.from_config(model)
    return CheckReport(_record(model))


def _record(model: Model) -> dict[str, Any]:
    included: tuple[Finding, ...] = ()
    if model.config.tables.mechanism.auto:
        model, included, explained = model.completed()
    else:
        explained = model.explain()
    (totals,) = model.estimates(["least-squares"])
    findings = [finding.as_dict() for finding in explained.findings]
    (estimate,) = model.estimates(["input-error"])
    doubts = [
        *against_prior(model.contradicted(dict(estimate.point))),
        *little_explained(model.chain, model.observations),
        *doubts_before(totals, model.observations),
        *(finding | {"kind": "missing", "what": finding["kind"]} for finding in findings),
        *few_outputs(model.observations, len(model.chain.names)),
    ]
    if model.chain.unseen_inertia:
        doubts.append({"kind": "unseen-inertia", "names": list(model.chain.unseen_inertia)})
    fitted = [None] * len(model.recordings)  # no part held out
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
            for recording, observation, part in [
                *zip(model.recordings, model.observations, fitted, strict=True),
                *((x.recording, x.observation, x.held_out) for x in model.held_out),
            ]
        ],
        "priors": {
            name: {"prior": prior.text, "default": prior.default}
            for name, prior in model.priors.items()
            # the residuals of an estimate determine the autocorrelation
            if not (prior.default and name in unsettled)
        },
        "doubts": doubts,
        "taken": [finding.as_dict() for finding in included],
        "findings": findings,
        "least_squares": estimate_table(totals).as_dict(),
    }


def _lines(record: Mapping[str, Any], verbose: bool) -> Iterator[str]:
    recordings, limit = record["recordings"], None if verbose else _MANY
    for recording in recordings[:limit]:
        settings = recording["settings"]
        rate = f" at {settings['sampling_rate']:.4g} Hz" if settings.get("sampling_rate") else ""
        band = f", compared up to {settings['band']:.3g} Hz" if settings.get("band") else ""
        held = f", {recording['held_out']} held out" if recording["held_out"] else ""
        size = f"{recording['duration']:.4g} s"
        if settings.get("steady"):
            size = f"{settings['n_samples']} points at constant speed"
        yield shortened(f"{recording['name']}: {size}{rate}{band}{held}")
        if verbose:
            yield from _steps(recording)
    if verbose:
        yield from ("", "Priors")
        for name, prior in record["priors"].items():
            yield f"  {name:<28} {prior['prior']}{'  (default)' if prior['default'] else ''}"
    elif len(recordings) > _MANY:
        yield f"and {len(recordings) - _MANY} more"
    totals = record["least_squares"]
    cells = [("", "least squares", "±", "", "")]
    for name, row in totals["parameters"].items():
        value, error = "not determined", ""
        if row["sd"] is not None:
            sd = max(row["sd"], row["sd_robust"] or 0.0)
            value, error = (TEXT.ends(number, 0, 0, sd) for number in (row["value"], sd))
        cells.append((name, value, error, "", row["unit"]))
    yield ""
    yield from aligned(cells)
    if (rms := totals["residual_rms"]) is not None:
        yield f"{rms:.3g} {totals['residual_unit']} rms left"
    yield ""
    if verbose:
        yield from (line_of("put in", row) for row in record["taken"])
        yield from (f"WARNING: {doubt_text(doubt)}" for doubt in record["doubts"])
    else:
        yield from _doubts(record)


def _steps(recording: Mapping[str, Any]) -> Iterator[str]:
    yield f"  {recording['file']}"
    if recording["added_mass"]:
        at = f" at {recording['radius']:g} m" if recording["radius"] else ""
        yield f"  added mass: {recording['added_mass']:g} kg{at}"
    yield from (f"  {step}" for step in recording["steps"])
    yield from (f"  WARNING: {warning}" for warning in recording["warnings"])


def _doubts(record: Mapping[str, Any]) -> Iterator[str]:
    lines = [line_of(doubt["kind"], doubt) for doubt in record["doubts"]]
    counts = Counter(text.split(";")[0] for row in record["recordings"] for text in row["warnings"])
    lines += [text if n == 1 else f"{text} ({n} recordings)" for text, n in counts.items()]
    for row in record["taken"]:
        yield from wrapped(f"fit will put in: {line_of(row['kind'], row)}", indent=2)
    for line in lines[:_MANY]:
        yield from wrapped(f"! {line}", indent=2)
    if len(lines) > _MANY:
        yield f"  and {len(lines) - _MANY} more: --verbose"
    if not lines and not record["taken"]:
        numbers = record["least_squares"]["parameters"].values()
        determined = all(row["sd"] is not None for row in numbers)
        yield "Nothing stands out." if determined else "Nothing else stands out."
