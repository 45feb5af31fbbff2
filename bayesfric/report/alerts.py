"""What a run warns of, found once: its page and the terminal say the same."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bayesfric.identifiability.identification import SpeedTerm
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.numbers import p_text
from bayesfric.report.summary.doubts import references_off
from bayesfric.report.summary.record import Readable, Summary
from bayesfric.report.summary.rows import FEWEST, RollOutPart
from bayesfric.report.words import line_of


@dataclass(frozen=True)
class Alert:
    """One thing to know before using a number."""

    kind: str  # what it is about, for programs
    text: str  # one sentence without its full stop
    section: str = ""  # of the page, which tells more; empty where none does
    first: bool = False  # whether it comes before all numbers
    line: str = ""  # what the answer says of it; empty for what needs nothing


def roll_out_alerts(found: RollOutPart) -> dict[str, dict[str, Any]]:
    """Say by kind in which recordings motions leave their bands, or these tell nothing."""
    judged = {name: row for name, row in found.recordings.items() if not row.wide}
    inside = [row.position.inside for row in judged.values()]
    told: dict[str, dict[str, Any]] = {}
    if inside and (share := sum(inside) / len(inside)) < FEWEST:
        narrow = [name for name, row in judged.items() if row.narrow]
        told["roll-out"] = {"level": found.level, "inside": share, "narrow": narrow}
    if wide := [name for name, row in found.recordings.items() if row.wide]:
        told["wide bands"] = {"wide": wide}
    return told


def alerts_of(read: Readable, contested: Sequence[str] | None = None) -> tuple[Alert, ...]:
    """Gather what a run warns of, what makes its numbers unsafe first.

    ``contested`` are numbers of which other methods give other values, where that is known.
    """
    summary = Summary.read(read)
    if contested is None:
        contested = comparison({"run": summary}).contested
    found = [
        Alert("sampler", text, "sampling", first=True, line=line_of("sampler"))
        for text in summary.sampler.problems
    ]
    for doubt in summary.doubts:
        place = "model-error" if doubt.kind == "missing" else "noise"  # how it was asked
        found.append(_alert(doubt.kind, doubt.model_dump(), place, first=True))
    if summary.sampler.status != "unusable":  # else there is no posterior to judge the model by
        if off := references_off(summary):
            found.append(_alert("references", {"off": off}, "parameters", first=True))
        found += (_alert(*one) for one in _of_model(summary, contested))
    found += (Alert("warning", text, line=text.split(";")[0]) for text in _gathered(summary))
    if (emf := summary.fit.back_emf) is not None:
        told = emf.model_dump(exclude={"among"})
        found.append(Alert("back-EMF", SpeedTerm(**told).meaning, "parameters"))
    if summary.may_be_simulated:
        found.append(Alert("simulated", line_of("simulated")))
    return tuple(found)


def _alert(kind: str, values: Mapping[str, Any], section: str, first: bool = False) -> Alert:
    text, done = line_of(kind, values), kind == "put in"
    return Alert(kind, text, section, first=first or done, line="" if done else text)


def _of_model(
    summary: Summary, contested: Sequence[str]
) -> Iterator[tuple[str, Mapping[str, Any], str]]:
    """Kind, values and section of what may be wrong with model and noise."""
    for one in summary.taken:
        yield "put in", one.model_dump(), "model-error"
    for one in sorted(summary.findings, key=lambda one: -one.share):
        if one.severity == "note":  # else it is a doubt
            yield "missing", one.model_dump() | {"what": one.kind}, "model-error"
    if summary.fit.rests:
        yield "rests", {"rests": [one.place for one in summary.fit.rests]}, "parameters"
    test = summary.noise.innovation_whiteness
    if test is not None and not test.white:
        # where the order was chosen, auto itself found that no memory helps
        asked = summary.noise.order_chosen_from or summary.noise.order
        p = "by their Ljung-Box test" if test.p_value is None else p_text(test.p_value)
        yield "not white", {"p": p, "mend": "" if asked else 'noise.model = "auto"'}, "noise"
    if summary.validation is not None and not summary.validation.pooled.fine:
        yield "held out", summary.validation.pooled.model_dump(), "held-out"
    if summary.rollout is not None:
        for kind, told in roll_out_alerts(summary.rollout).items():
            yield kind, told, "roll-out"
    if contested:
        yield "methods", {"names": contested}, "methods"


def _gathered(summary: Summary) -> Iterator[str]:
    """Warnings, one line for what is told of several recordings alike."""
    recordings = summary.fit.recordings
    told: dict[str, list[str]] = {}
    for text in summary.warnings:
        # as summarise writes what an observation warns of; what differs in numbers is alike
        name, colon, rest = text.partition(": ")
        kind = re.sub(r"[\d.]+", "#", rest) if colon and name in recordings else text
        told.setdefault(kind, []).append(text)
    for lines in told.values():
        of = f" ({len(lines)} of {len(recordings)} recordings)"
        yield lines[0] if len(lines) == 1 else lines[0].partition(": ")[2] + of
