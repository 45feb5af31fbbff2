"""The answer of a run: verdict, numbers, messages, next recording; and its text for a terminal.

Terminal, page and notebook print the same lines and the same digits.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bayesfric.mechanism.quantities import quantity_of
from bayesfric.report.messages import messages_of
from bayesfric.report.numbers import TEXT, finer, text_rounded
from bayesfric.report.summary.parts import friction_cells, off_rows
from bayesfric.report.summary.record import Message, Readable, Summary, of_noise
from bayesfric.report.words import filled
from bayesfric.results.reported import ORDER, Outcome, Reported

# Rows of the table, and findings, that are shown at most.
ROWS, FINDINGS = 16, 3
WIDTH = 100  # columns


class PrintedRow(NamedTuple):
    """One reported number as text."""

    name: str
    value: str  # value and sd are empty where only one end is known
    sd: str
    interval: str  # or the end that is known
    unit: str
    status: str


@dataclass(frozen=True)
class Brief:
    """The short answer of a run."""

    recorded: str
    outcome: Outcome
    verdict: str
    taken: tuple[str, ...]  # what terms = "auto" has added, a line each
    level: str
    lines: tuple[PrintedRow, ...]
    left_out: int  # numbers
    unidentified: tuple[str, ...]  # names
    why: str  # they are
    lost: tuple[str, ...]  # names of what has not converged
    findings: tuple[str, ...]  # the worst first, a line each
    others: int  # findings that are left out
    following: str  # next recording to make; may be empty


def brief(summary: Readable, messages: Sequence[Message] | None = None) -> Brief:
    """Put the short answer of a summary together; its ``messages`` are made where left out."""
    read = Summary.read(summary)
    derived = [name for name, row in read.derived.items() if not row.gauge_free]
    rows = {
        name: read.rows[name].reported
        for name in (*read.gauge_free, *read.parameters, *derived)
        # in tables only: the noise, and efficiencies, which alphas are already
        if not (of_noise(name) or quantity_of(name).startswith("efficiency"))
    }
    shown = [
        name
        for name, row in rows.items()
        if row.status != "unidentified"
        and (
            name in read.joint or not _is_rescaled(row, [rows[n] for n in read.joint if n in rows])
        )
    ]
    shown.sort(key=lambda name: ORDER.index(rows[name].status))
    directions = read.identifiability.null_directions
    scaled = any(len(direction.parameters) > 1 for direction in directions)
    lost = tuple(name for name, row in rows.items() if not read.rows[name].converged)
    messages = messages_of(read) if messages is None else messages
    findings = list(dict.fromkeys(message.brief for message in messages if message.brief))
    return Brief(
        recorded=_recorded(read),
        outcome=read.verdict.outcome,
        verdict=filled("verdict.txt.j2", summary=read, verdict=read.verdict),
        taken=tuple(f"Added: {row.text}" for row in read.taken),
        level=f"{100.0 * read.level:g} % interval",
        lines=tuple(
            printed_row(name, rows[name], read.rows[name].unit, read.level) for name in shown[:ROWS]
        ),
        left_out=max(len(shown) - ROWS, 0),
        unidentified=tuple(n for n in read.joint if n in rows and n not in {*shown, *lost}),
        why="only their ratios affect the torque" if scaled else "the motion hides them",
        lost=lost,
        findings=tuple(findings[:FINDINGS]),
        others=max(len(findings) - FINDINGS, 0),
        following=_next(read),
    )


def _recorded(summary: Summary) -> str:
    """Give names or number of recordings, seconds, rate, and the quantity that is explained."""
    recordings = summary.fit.recordings
    sampled = [
        (row.n_samples, row.sampling_rate)
        for row in recordings.values()
        if row.n_samples and row.sampling_rate
    ]
    if not sampled:
        return ", ".join(recordings)
    rates = [rate for _, rate in sampled]
    hertz = " to ".join(dict.fromkeys(f"{rate:.4g}" for rate in (min(rates), max(rates))))
    many = len(recordings)
    names = ", ".join(recordings) if many < 3 else f"{many} recordings"
    seconds = f"{sum(n / rate for n, rate in sampled):.4g} s{' in all' if many > 1 else ''}"
    return f"{names}: {seconds} at {hertz} Hz, {summary.fit.quantity}"


def _is_rescaled(row: Reported, others: Iterable[Reported]) -> bool:
    """Whether it is one of the others in another unit, as gravity's torque is its moment."""

    def ratios(row: Reported) -> list[float]:
        value = row.value or math.nan
        return [row.sd / abs(value), *sorted(end / value for end in row.interval)]

    return any(np.allclose(ratios(other), ratios(row), rtol=1e-9) for other in others)


def printed_row(name: str, row: Reported, unit: str, level: float) -> PrintedRow:
    """Write a number: value and interval, or the end that is known."""
    status = "needs the prior" if row.status == "prior" else row.status
    if row.bound is not None:
        side = "at most" if row.at_most else "at least"
        chance = f"({50.0 * (1.0 + level):g} %)"  # of an interval's one end
        return PrintedRow(name, "", "", f"{side} {row.bound:.3g} {chance}", unit, status)
    if not row.sd:
        return PrintedRow(name, f"{row.value:.5g}", "", "", unit, status)
    low, high = row.interval
    digits_of = finer(row.value, low, high, row.sd)
    value, sd = (text_rounded(x, digits_of) for x in (row.value, row.sd))
    return PrintedRow(name, value, sd, TEXT.interval(low, high, digits_of), unit, status)


def _next(summary: Summary) -> str:
    """Give the recording that would determine what is open."""
    if summary.verdict.outcome != "not converged":
        for direction in summary.identifiability.directions:
            for remedy in direction.remedies:
                if remedy.kind == "known mass":
                    return remedy.text
    return ""


class PrintedSummary(Summary):
    """Every number of a run; Python and a notebook show it as the terminal does."""

    def __repr__(self) -> str:
        """Print it as the terminal does."""
        return "\n".join(fit_text(self))

    __str__ = __repr__


def fit_text(summary: Readable, *, verbose: bool = False) -> Iterator[str]:
    """Print a summary, line by line; ``verbose`` with how it was made."""
    read = Summary.read(summary)
    messages = messages_of(read)
    answer = brief(read, messages)
    table = [("", "value", "sd", answer.level, "", "status"), *answer.lines]
    for line in filled("brief.txt.j2", b=answer, table=aligned(table)).splitlines():
        # rows of the table keep their spaces
        yield from wrapped(line, indent=2) if len(line) > WIDTH else [line]
    if verbose:
        friction: list[tuple[str, ...]] = []
        if (curve := read.friction) is not None:
            level = f"{100.0 * curve.level:g} % interval"
            head = (f"speed, {curve.speed_unit}", f"load, {curve.unit}", "value", level, "status")
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
