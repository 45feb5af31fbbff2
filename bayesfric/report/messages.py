"""The messages of a run, most severe first: page and terminal print the same."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.numbers import p_text
from bayesfric.report.summary.doubts import references_off
from bayesfric.report.summary.record import Message, Readable, Summary
from bayesfric.report.words import line_of
from bayesfric.results.roll_out import FEWEST, RollOutPart


def roll_out_messages(rollout: RollOutPart) -> dict[str, dict[str, Any]]:
    """Say by kind in which recordings motions leave their bands, or bands are too wide."""
    judged = {name: row for name, row in rollout.recordings.items() if not row.wide}
    inside = [row.position.inside for row in judged.values()]
    messages: dict[str, dict[str, Any]] = {}
    if inside and (share := sum(inside) / len(inside)) < FEWEST:
        narrow = [name for name, row in judged.items() if row.narrow]
        messages["roll-out"] = {"level": rollout.level, "inside": share, "narrow": narrow}
    if wide := [name for name, row in rollout.recordings.items() if row.wide]:
        messages["wide bands"] = {"wide": wide}
    return messages


def messages_of(read: Readable, contested: Sequence[str] | None = None) -> tuple[Message, ...]:
    """Gather what a run warns of.

    ``contested`` are numbers of which other methods give other values, where that is known.
    """
    summary = Summary.read(read)
    if contested is None:
        contested = comparison({"run": summary}).contested
    messages = [Message(kind="sampler", remark=text) for text in summary.sampler.problems]
    messages += summary.doubts
    if summary.sampler.status != "unusable":  # else there is no posterior to judge the model by
        if off := references_off(summary):
            messages.append(_message("references", {"off": off}))
        messages += [
            _message("put in", row.message("put in", severity="doubt")) for row in summary.taken
        ]
        notes = _of_model(summary, contested)
        messages += [_message(kind, {**values, "severity": "note"}) for kind, values in notes]
    remarks = [("warning", text) for text in _gathered(summary)]
    if (emf := summary.fit.back_emf) is not None:
        remarks.append(("back-EMF", emf.meaning))
    if summary.may_be_simulated:
        remarks.append(("simulated", line_of("simulated")))
    messages += [Message(kind=kind, severity="note", remark=text) for kind, text in remarks]
    return tuple(messages)


def _message(kind: str, values: Mapping[str, Any]) -> Message:
    return Message.model_validate({"kind": kind, **values})


def _of_model(
    summary: Summary, contested: Sequence[str]
) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Kind and values of what may be wrong with model and noise."""
    for finding in sorted(summary.findings, key=lambda row: -row.share):
        if finding.severity == "note":  # else it is a doubt
            yield "missing", finding.message("missing")
    if summary.fit.rests:
        yield (
            "rests",
            {"rests": [f"{rest.recording} at {rest.start:.3g} s" for rest in summary.fit.rests]},
        )
    test = summary.noise.innovation_whiteness
    if test is not None and not test.white:
        # where the order was chosen, auto itself found that no autoregression helps
        order = summary.noise.order_chosen_from or summary.noise.order
        p = "by their Ljung-Box test" if test.p_value is None else p_text(test.p_value)
        yield "not white", {"p": p, "fix": "" if order else 'noise.model = "auto"'}
    if summary.validation is not None and not summary.validation.pooled.fine:
        yield "held out", summary.validation.pooled.model_dump()
    if summary.rollout is not None:
        yield from roll_out_messages(summary.rollout).items()
    if contested:
        yield "methods", {"names": contested}


def _gathered(summary: Summary) -> Iterator[str]:
    """Warnings, one line for the same of several recordings."""
    recordings = summary.fit.recordings
    groups: dict[str, list[str]] = {}
    for text in summary.warnings:
        # "name: warning" of an observation; what differs in numbers is the same
        name, colon, rest = text.partition(": ")
        kind = re.sub(r"[\d.]+", "#", rest) if colon and name in recordings else text
        groups.setdefault(kind, []).append(text)
    for lines in groups.values():
        of = f" ({len(lines)} of {len(recordings)} recordings)"
        yield lines[0] if len(lines) == 1 else lines[0].partition(": ")[2] + of
