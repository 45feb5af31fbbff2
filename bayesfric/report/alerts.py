"""What a run warns of, found once: its page and the terminal say the same."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bayesfric.identifiability.sentences import stated
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.summary.record import Readable, Summary
from bayesfric.report.summary.reference_check import references_off
from bayesfric.report.summary.rollout import FEWEST, RollOutPart
from bayesfric.report.text_templates import sentence
from bayesfric.report.words import line_of, words

# Kinds of doubts, see bayesfric.report.summary.doubts; each has a macro that words it.
DOUBTS = (
    "unexplained",
    "feedback",
    "attenuated",
    "negative",
    "noise-bound",
    "acceleration",
    "missing",
    "velocity",
    "few",
    "unseen-inertia",
    "self-check",
    "prior",
)


@dataclass(frozen=True)
class Alert:
    """One thing to know before using a number."""

    kind: str  # what it is about, for programs
    text: str  # one sentence without its full stop
    section: str = ""  # of the page, which tells more; empty where none does
    first: bool = False  # whether it comes before all numbers
    line: str = ""  # the same in one line, with the thing to do; empty for what needs none


def doubt_text(doubt: Mapping[str, Any]) -> str:
    """Word one of ``summary["doubts"]``; one that only a newer version knows by its parameters."""
    if doubt["kind"] in DOUBTS:
        return sentence(doubt["kind"], doubt)
    if doubt["kind"] in words():
        return line_of(doubt["kind"], doubt)
    return f"{doubt['kind']}: {', '.join(doubt.get('parameters', ()))}"


def roll_out_doubt(found: RollOutPart) -> dict[str, Any] | None:
    """Say in which recordings the motion leaves its bands too often, if in all that tell it."""
    judged = {name: row for name, row in found.recordings.items() if not row.wide}
    inside = [row.position.inside for row in judged.values()]
    if not inside or (share := sum(inside) / len(inside)) >= FEWEST:
        return None
    rows = {name: row.position for name, row in judged.items() if row.narrow}
    fitted = all(row.part == "fitted" for row in judged.values())
    return {"fitted": fitted, "level": found.level, "inside": share, "narrow": rows}


def roll_out_wide(found: RollOutPart) -> dict[str, Any] | None:
    """Say of which recordings the bands are too wide to tell anything."""
    rows = {name: row for name, row in found.recordings.items() if row.wide}
    told = {"level": found.level, "unit": found.unit, "draws": found.draws, "wide": rows}
    return told if rows else None


def alerts_of(summary: Readable, where: str = "run") -> tuple[Alert, ...]:
    """Gather what a summary of the run ``where`` warns of."""
    read = Summary.read(summary, where)
    return alerts(read, comparison({where: read}).contested)


def alerts(summary: Summary, contested: Sequence[str]) -> tuple[Alert, ...]:
    """Gather what a run warns of, what makes its numbers unsafe first.

    ``contested`` are numbers of which other methods give other values.
    """
    problem = line_of("sampler")
    found = [
        Alert("sampler", text, "sampling", first=True, line=problem)
        for text in summary.sampler.problems
    ]
    for doubt in summary.doubts:
        dumped = doubt.model_dump()
        place = "model-error" if doubt.kind == "missing" else "noise"  # how it was asked
        line = line_of(doubt.kind, dumped)
        found.append(Alert(doubt.kind, doubt_text(dumped), place, first=True, line=line))
    if summary.sampler.status != "unusable" and (told := references_off(summary)) is not None:
        text = sentence("references", told)
        line = line_of("references")
        found.append(Alert("references", text, "parameters", first=True, line=line))
    if summary.sampler.status != "unusable":  # else there is no posterior to judge the model by
        for kind, values, section in _of_model(summary, contested):
            first = kind == "put in"
            line = "" if first else line_of(kind, values)
            found.append(Alert(kind, sentence(kind, values), section, first=first, line=line))
    found += (Alert("warning", text, line=text.split(";")[0]) for text in _gathered(summary))
    if (emf := summary.fit.back_emf) is not None:
        text = str(stated("voltage", "back_emf", **emf.model_dump()))
        found.append(Alert("back-EMF", text, "parameters"))
    if summary.may_be_simulated:
        found.append(Alert("simulated", sentence("simulated")))
    return tuple(found)


def _of_model(
    summary: Summary, contested: Sequence[str]
) -> Iterator[tuple[str, Mapping[str, Any], str]]:
    """Kind, values and section of what may be wrong with model and noise."""
    allowed = summary.widened
    for one in summary.taken:
        yield "put in", one.model_dump(), "model-error"
    for one in summary.findings:
        if one.severity == "note":  # else it is a doubt
            yield "missing", one.model_dump() | {"what": one.kind}, "model-error"
    if summary.fit.rests:
        yield "rests", {"rests": summary.fit.rests, "unit": summary.fit.unit}, "parameters"
    test = summary.noise.innovation_whiteness
    if test is not None and not test.white:
        # where the order was chosen, auto itself found that no memory helps
        asked = summary.noise.order_chosen_from or summary.noise.order
        more = {"mend": "" if asked else 'noise.model = "auto"', "allowed": allowed}
        yield "not white", test.model_dump() | more, "noise"
    if summary.validation is not None and not summary.validation.pooled.fine:
        yield "held out", summary.validation.pooled.model_dump(), "held-out"
    if summary.rollout is not None and (told := roll_out_doubt(summary.rollout)):
        yield "roll-out", told, "roll-out"
    if summary.rollout is not None and (told := roll_out_wide(summary.rollout)):
        yield "wide bands", told, "roll-out"
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
