"""The answer of a run: messages, verdict, numbers, next recording; and its text for a terminal.

Terminal, page and notebook print the same lines and the same digits.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bayesfric.mechanism.quantities import quantity_of
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.numbers import TEXT, finer, p_text, text_rounded
from bayesfric.report.summary.doubts import references_off
from bayesfric.report.summary.parts import friction_cells, off_rows
from bayesfric.report.summary.record import Message, Readable, Summary, of_noise
from bayesfric.report.words import filled, line_of
from bayesfric.results.reported import ORDER, Reported
from bayesfric.results.roll_out import FEWEST, tells_nothing

# Rows of the table, and findings, that are shown at most.
ROWS, FINDINGS = 16, 3
WIDTH = 100  # columns

# -- messages


def roll_out_messages(rollout: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Say by kind in which recordings motions leave their bands, or bands are too wide."""
    rows = rollout["recordings"]
    wide = [name for name, row in rows.items() if tells_nothing(row["blind"], row["over"])]
    inside = {name: row["position"]["inside"] for name, row in rows.items() if name not in wide}
    messages: dict[str, dict[str, Any]] = {}
    if inside and (share := sum(inside.values()) / len(inside)) < FEWEST:
        narrow = [name for name, share in inside.items() if share < FEWEST]
        messages["roll-out"] = {"level": rollout["level"], "inside": share, "narrow": narrow}
    if wide:
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
    notes: list[dict[str, Any]] = []
    if summary.sampler.status != "unusable":  # else there is no posterior to judge the model by
        if off := references_off(summary):
            messages.append(Message.model_validate({"kind": "references", "off": off}))
        messages += [row.of_kind("put in", severity="doubt") for row in summary.taken]
        notes += [{**values, "kind": kind} for kind, values in _of_model(summary, contested)]
    notes += [{"kind": "warning", "remark": text} for text in _gathered(summary)]
    if (emf := summary.fit.back_emf) is not None:
        notes.append({"kind": "back-EMF", "remark": emf["meaning"]})
    if summary.may_be_simulated:
        notes.append({"kind": "simulated", "remark": line_of("simulated")})
    messages += [Message.model_validate({**note, "severity": "note"}) for note in notes]
    return tuple(messages)


def _of_model(
    summary: Summary, contested: Sequence[str]
) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Kind and values of what may be wrong with model and noise."""
    for finding in sorted(summary.findings, key=lambda row: -row.details["share"]):
        if finding.severity == "note":  # else it is a doubt
            yield "missing", finding.of_kind("missing").model_dump(exclude={"kind", "remark"})
    if rests := [f"{rest['recording']} at {rest['start']:.3g} s" for rest in summary.fit.rests]:
        yield "rests", {"rests": rests}
    test = summary.noise.innovation_whiteness
    if test is not None and not test["white"]:
        # where the order was chosen, auto itself found that no autoregression helps
        order = summary.noise.order_chosen_from or summary.noise.order
        p = p_text(test["p_value"])
        yield "not white", {"p": p, "fix": "" if order else 'noise.model = "auto"'}
    pooled = summary.validation["pooled"] if summary.validation else {"verdict": "covered"}
    if pooled["verdict"] not in ("covered", "undecided"):
        yield "held out", pooled
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


# -- the short answer


def brief(summary: Readable, messages: Sequence[Message] | None = None) -> dict[str, Any]:
    """Put the short answer of a summary together; its ``messages`` are made where left out."""
    read = Summary.read(summary)
    derived = [name for name, row in read.derived.items() if not row.gauge_free]
    rows = {
        name: read.rows[name].reported
        for name in (*read.gauge_free, *read.parameters, *derived)
        # in tables only: the noise, and efficiencies, which alphas are already
        if not (of_noise(name) or quantity_of(name).startswith("efficiency"))
    }
    parameters = [row for name, row in rows.items() if name in read.joint]
    shown = [
        name
        for name, row in rows.items()
        if row.status != "unidentified"
        and (name in read.joint or not _is_rescaled(row, parameters))
    ]
    shown.sort(key=lambda name: ORDER.index(rows[name].status))
    directions = read.identifiability.null_directions
    scaled = any(len(direction["parameters"]) > 1 for direction in directions)
    lost = [name for name in rows if not read.rows[name].converged]
    messages = messages_of(read) if messages is None else messages
    findings = list(dict.fromkeys(message.brief for message in messages if message.brief))
    remedies = [r for direction in read.identifiability.directions for r in direction.remedies]
    # the recording that would determine what is open
    following = next((r["text"] for r in remedies if r["kind"] == "known mass"), "")
    return {
        "recorded": _recorded(read),
        "outcome": read.verdict.outcome,
        "verdict": filled("verdict.txt.j2", summary=read, verdict=read.verdict),
        "taken": [f"Added: {row.text}" for row in read.taken],  # by terms = "auto"
        "level": f"{100.0 * read.level:g} % interval",
        "lines": [
            printed_row(name, rows[name], read.rows[name].unit, read.level) for name in shown[:ROWS]
        ],
        "left_out": max(len(shown) - ROWS, 0),
        "unidentified": [n for n in read.joint if n in rows and n not in {*shown, *lost}],
        "why": "only their ratios affect the torque" if scaled else "the motion hides them",
        "lost": lost,  # what has not converged
        "findings": findings[:FINDINGS],  # the worst first
        "others": max(len(findings) - FINDINGS, 0),
        "following": following if read.verdict.outcome != "not converged" else "",
    }


def _recorded(summary: Summary) -> str:
    """Give names or number of recordings, seconds, rate, and the quantity that is explained."""
    recordings = summary.fit.recordings
    sampled = [
        (row["n_samples"], row["sampling_rate"])
        for row in recordings.values()
        if row.get("n_samples") and row.get("sampling_rate")
    ]
    names = ", ".join(recordings) if len(recordings) < 3 else f"{len(recordings)} recordings"
    if points := sum(row["n_samples"] for row in recordings.values() if row.get("steady")):
        names += f": {points} points at constant speed{', and others' if sampled else ''}"
    if not sampled:
        return names
    rates = sorted(rate for _, rate in sampled)
    hertz = " to ".join(dict.fromkeys(f"{rate:.4g}" for rate in (rates[0], rates[-1])))
    seconds = f"{sum(n / rate for n, rate in sampled):.4g} s{' in all' * (len(recordings) > 1)}"
    return f"{names}: {seconds} at {hertz} Hz, {summary.fit.quantity}"


def _is_rescaled(row: Reported, others: Iterable[Reported]) -> bool:
    """Whether it is one of the others in another unit, as gravity's torque is its moment."""

    def ratios(row: Reported) -> list[float]:
        value = row.value or math.nan
        return [row.sd / abs(value), *sorted(end / value for end in row.interval)]

    return any(np.allclose(ratios(other), ratios(row), rtol=1e-9) for other in others)


def printed_row(name: str, row: Reported, unit: str, level: float) -> tuple[str, ...]:
    """Write name, value, sd, interval, unit and status; the end alone of what has only one."""
    status = "needs the prior" if row.status == "prior" else row.status
    if row.bound is not None:
        side = "at most" if row.at_most else "at least"
        chance = f"({50.0 * (1.0 + level):g} %)"  # of an interval's one end
        return name, "", "", f"{side} {row.bound:.3g} {chance}", unit, status
    if not row.sd:
        return name, f"{row.value:.5g}", "", "", unit, status
    low, high = row.interval
    digits_of = finer(row.value, low, high, row.sd)
    value, sd = (text_rounded(x, digits_of) for x in (row.value, row.sd))
    return name, value, sd, TEXT.interval(low, high, digits_of), unit, status


class PrintedSummary(Summary):
    """Every number of a run; Python and a notebook show it as the terminal does."""

    def __repr__(self) -> str:
        return "\n".join(fit_text(self))

    __str__ = __repr__


def fit_text(summary: Readable, *, verbose: bool = False) -> Iterator[str]:
    """Print a summary, line by line; ``verbose`` with how it was made."""
    read = Summary.read(summary)
    messages = messages_of(read)
    answer = brief(read, messages)
    table = [("", "value", "sd", answer["level"], "", "status"), *answer["lines"]]
    for line in filled("brief.txt.j2", b=answer, table=aligned(table)).splitlines():
        # rows of the table keep their spaces
        yield from wrapped(line, indent=2) if len(line) > WIDTH else [line]
    if verbose:
        friction: list[tuple[str, ...]] = []
        if (curve := read.friction) is not None:
            level = f"{100.0 * curve['level']:g} % interval"
            head = (
                f"speed, {curve['speed_unit']}",
                f"load, {curve['unit']}",
                "value",
                level,
                "status",
            )
            friction = [head, *friction_cells(curve, TEXT)]
        yield from filled(
            "fit.txt.j2",
            summary=read,
            messages=messages,
            rows={n: r for n, r in read.rows.items() if not r.of_motion},
            noise=read.noise,
            validation=read.validation,
            check=read.self_check,
            off=off_rows(read),
            friction=list(aligned(friction)),
        ).splitlines()


def aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Align a table: numbers, the second and third column, to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = [
            text.rjust(width) if k in (1, 2) else text.ljust(width)
            for k, (text, width) in enumerate(zip(row, widths, strict=True))
        ]
        yield "  ".join(cells).rstrip()


def wrapped(text: str, indent: int = 0) -> list[str]:
    """Break a text into lines."""
    return textwrap.wrap(text, WIDTH, subsequent_indent=" " * indent, break_long_words=False)


def shortened(text: str) -> str:
    """Cut a text to a line."""
    return text if len(text) <= WIDTH else text[: WIDTH - 1].rstrip() + "…"
