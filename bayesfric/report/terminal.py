"""A run's result as a terminal shows it: the answer in twenty lines, the rest on request."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence

from bayesfric.report.alerts import alerts_of
from bayesfric.report.brief import Brief, brief
from bayesfric.report.summary.conclusions import put_reported
from bayesfric.report.summary.noise import noise_lines
from bayesfric.report.summary.record import Readable, Summary
from bayesfric.report.summary.self_check_part import self_check_lines
from bayesfric.report.summary.validation_part import validation_lines
from bayesfric.report.text_templates import filled

WIDTH = 100  # columns


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
            noise=list(noise_lines(read.noise)),
            held_out=list(validation_lines(read.validation)) if read.validation else [],
            self_check=list(self_check_lines(read)),
        ).splitlines()


def _brief(told: Brief) -> Iterator[str]:
    head = ("", "value", "sd", told.level, "", "")
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
