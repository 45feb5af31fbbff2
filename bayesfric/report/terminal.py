"""The answer of a run as data: verdict, numbers, what is wrong, what next; and on a terminal.

Terminal, page and notebook print the same lines and the same digits.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesfric.mechanism.parameter import quantity_of
from bayesfric.report.alerts import Alert, alerts_of
from bayesfric.report.numbers import TEXT, finer, text_rounded
from bayesfric.report.paper.tables import parameter_table
from bayesfric.report.summary.conclusions import put_reported
from bayesfric.report.summary.friction_part import friction_cells
from bayesfric.report.summary.record import Friction, Readable, Summary, of_noise
from bayesfric.report.summary.self_check_part import off_rows
from bayesfric.report.words import filled, line_of
from bayesfric.results.reported import ORDER, Reported
from bayesfric.results.verdict import Outcome

# Rows of the table, and findings, that are shown at most.
ROWS, FINDINGS = 16, 3
# What stands beside a number in place of its status.
_BESIDE: Mapping[str, str] = {"prior": "needs the prior"}


@dataclass(frozen=True)
class Line:
    """One number, as it is printed."""

    name: str
    value: str  # value, sd: empty where only one end is known
    sd: str
    interval: str  # or the end that is known
    unit: str
    beside: str  # its status


@dataclass(frozen=True)
class Brief:
    """What a run answers."""

    read: str  # what was recorded
    outcome: Outcome
    verdict: str
    taken: tuple[str, ...]  # what terms = "auto" has put in, a line each
    level: str
    lines: tuple[Line, ...]
    more: int  # numbers that are left out
    unidentified: tuple[str, ...]  # names
    why: str  # they are
    lost: tuple[str, ...]  # names of what has not converged
    findings: tuple[str, ...]  # the worst first, a line each
    others: int  # findings that are left out
    following: str  # the recording that would tell more; may be empty


def brief(summary: Readable, alerts: Sequence[Alert] | None = None) -> Brief:
    """Put the answer of a summary together; ``alerts`` are its own, where they were made."""
    table = parameter_table(summary)
    read = table.summary
    rows = {
        row.name: row.row.reported
        for row in table.rows
        if row.row is not None and row.row.reported is not None and not _in_tables(row.name)
    }
    shown = [name for name, one in rows.items() if one.status != "unidentified"]
    shown = [name for name in shown if name in read.joint or not _told_by(rows, name, read.joint)]
    shown.sort(key=lambda name: ORDER.index(rows[name].status))
    scaled = any(len(one.parameters) > 1 for one in read.identifiability.null_directions)
    lost = tuple(name for name, one in rows.items() if not one.how.converged)
    told = alerts_of(read) if alerts is None else alerts
    found = list(dict.fromkeys(one.line for one in told if one.line))
    return Brief(
        read=_recorded(read),
        outcome=read.verdict.outcome,
        verdict=filled("verdict.txt.j2", summary=read, found=read.verdict),
        taken=tuple(f"Added: {line_of(one.kind, one.model_dump())}" for one in read.taken),
        level=f"{100.0 * read.level:g} % interval",
        lines=tuple(
            line_of_number(name, rows[name], read.rows[name].unit, read.level)
            for name in shown[:ROWS]
        ),
        more=max(len(shown) - ROWS, 0),
        unidentified=tuple(n for n in read.joint if n in rows and n not in {*shown, *lost}),
        why="together they can be scaled, which changes no torque"
        if scaled
        else "the motion hides them",
        lost=lost,
        findings=tuple(found[:FINDINGS]),
        others=max(len(found) - FINDINGS, 0),
        following=_next(read),
    )


def _recorded(summary: Summary) -> str:
    """Say what was recorded: names or how many, seconds, rate, and what is explained."""
    recordings = summary.fit.recordings
    known = [
        (one.n_samples, one.sampling_rate)
        for one in recordings.values()
        if one.n_samples and one.sampling_rate
    ]
    names = ", ".join(recordings)
    if not known:
        return names
    seconds = sum(n / rate for n, rate in known)
    rates = sorted(rate for _, rate in known)
    hertz = " to ".join(dict.fromkeys(f"{rate:.4g}" for rate in (rates[0], rates[-1])))
    names = names if len(recordings) < 3 else f"{len(recordings)} recordings"
    every = " in all" if len(recordings) > 1 else ""
    return f"{names}: {seconds:.4g} s{every} at {hertz} Hz, {summary.fit.quantity}"


def _in_tables(name: str) -> bool:
    """Whether the tables have it alone: the noise's, and efficiencies, which alphas are already."""
    return of_noise(name) or quantity_of(name).startswith("efficiency")


def _told_by(rows: Mapping[str, Reported], name: str, joint: Iterable[str]) -> bool:
    """Whether a parameter is the same number in another unit, as gravity's torque is its moment."""
    mine = _shares(rows[name])
    return any(np.allclose(_shares(rows[own]), mine, rtol=1e-9) for own in joint if own in rows)


def _shares(one: Reported) -> list[float]:
    value = one.value or math.nan
    return [one.sd / abs(value), *sorted(end / value for end in one.interval)]


def line_of_number(name: str, one: Reported, unit: str, level: float) -> Line:
    """Word a number as it is printed: value and interval, or the end that is known."""
    beside = _BESIDE.get(one.status, one.status)
    if one.bound is not None:
        side = "at most" if one.at_most else "at least"
        sure = f"({50.0 * (1.0 + level):g} %)"  # an interval's one end
        return Line(name, "", "", f"{side} {one.bound:.3g} {sure}", unit, beside)
    if not one.sd:
        return Line(name, f"{one.value:.5g}", "", "", unit, beside)
    low, high = one.interval
    fine = finer(one.value, low, high, one.sd)
    value, sd = (text_rounded(x, fine) for x in (one.value, one.sd))
    return Line(name, value, sd, TEXT.interval(low, high, fine), unit, beside)


def _next(summary: Summary) -> str:
    """Give the recording that would tell what is open."""
    if summary.verdict.outcome != "not converged":
        for direction in summary.identifiability.directions:
            for remedy in direction.remedies:
                if remedy.kind == "known mass":
                    return remedy.text
    return ""


WIDTH = 100  # columns


class PrintedSummary(Summary):
    """Every number of a run; Python and a notebook show it as the terminal does."""

    def __repr__(self) -> str:
        """Print it as the terminal does."""
        return "\n".join(fit_text(self))

    __str__ = __repr__


def fit_text(summary: Readable, *, verbose: bool = False) -> Iterator[str]:
    """Word a summary for a person, line by line; ``verbose`` with all that stands behind it."""
    read = put_reported(Summary.read(summary))
    alerts = alerts_of(read)
    yield from _brief(brief(read, alerts))
    if verbose:
        yield from filled(
            "fit.txt.j2",
            summary=read,
            alerts=alerts,
            rows={n: r for n, r in read.rows.items() if r.reported and not r.of_motion},
            noise=read.noise,
            found=read.validation,
            check=read.self_check,
            off=off_rows(read),
            friction=aligned(_friction(read.friction)) if read.friction else (),
        ).splitlines()


def _friction(friction: Friction) -> list[tuple[str, ...]]:
    """Lay the rows of friction out, with their head."""
    level, load = f"{100.0 * friction.level:g} % interval", f"load, {friction.unit}"
    head = (f"speed, {friction.speed_unit}", load, "value", level, "status")
    return [(f"  {speed}", *cells) for speed, *cells in (head, *friction_cells(friction, TEXT))]


def _brief(told: Brief) -> Iterator[str]:
    head = ("", "value", "sd", told.level, "", "status")
    lines = [(x.name, x.value, x.sd, x.interval, x.unit, x.beside) for x in told.lines]
    for line in filled("brief.txt.j2", b=told, table=aligned([head, *lines])).splitlines():
        # rows of the table keep their spaces
        yield from wrapped(line, indent=2) if len(line) > WIDTH else [line]


def aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Lay rows out: the first column and those behind the numbers to the left, numbers right."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
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
