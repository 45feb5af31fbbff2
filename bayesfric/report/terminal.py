"""A run's result as a terminal shows it: the answer in twenty lines, the rest on request."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence

from bayesfric.report.alerts import Alert, alerts_of
from bayesfric.report.numbers import TEXT, finer
from bayesfric.report.paper.tables import parameter_table
from bayesfric.report.summary.caveats import constant_sentence
from bayesfric.report.summary.noise import noise_lines
from bayesfric.report.summary.record import Readable, Summary, of_noise
from bayesfric.report.summary.self_check import self_check_lines
from bayesfric.report.summary.validation import validation_lines
from bayesfric.report.text_templates import filled
from bayesfric.report.words import line_of
from bayesfric.results.reported import ORDER, Reported

# Columns of a line; rows of the table, names in a line, and findings that are shown at most.
WIDTH, ROWS, FINDINGS = 100, 16, 3
_SIGNS = {"good": "Good.", "unchecked": "Not checked.", "doubtful": "Doubtful."}
# What stands beside a number that is not simply identified.
_BESIDE = {"identified": "", "limit": "", "prior": "with the prior", "doubtful": "doubtful"}


def brief(summary: Readable) -> Iterator[str]:
    """Give verdict, numbers, findings and next step; arguments as of :func:`fit_text`."""
    read = Summary.read(summary)
    found = list(_findings(alerts_of(read)))
    yield from _read(read)
    yield from wrapped(_verdict(read))
    for one in read.taken:
        yield shortened(f"Put in: {line_of(one.kind, one.model_dump())}")
    yield ""
    yield from _numbers(read)
    if found:
        yield ""
    yield from (shortened(f"! {line}") for line in found[:FINDINGS])
    if len(found) > FINDINGS:
        yield f"  and {len(found) - FINDINGS} more: --verbose, or the report"
    if step := _next(read):
        yield shortened(f"Next: {step}")


def fit_text(summary: Readable, *, verbose: bool = False) -> Iterator[str]:
    """Word a summary for a person, line by line; ``verbose`` with all that stands behind it."""
    yield from brief(summary)
    if verbose:
        read = Summary.read(summary)
        yield from filled(
            "fit.txt.j2",
            summary=read,
            alerts=alerts_of(read),
            rows={n: r for n, r in read.rows.items() if r.reported and not r.of_motion},
            noise=list(noise_lines(read.noise, allowed=read.widened)),
            held_out=list(validation_lines(read.validation)) if read.validation else [],
            self_check=list(self_check_lines(read)),
            constant=constant_sentence(read),
        ).splitlines()


def _read(summary: Summary) -> Iterator[str]:
    recordings = summary.fit.recordings
    lasts = [
        one.n_samples / one.sampling_rate
        for one in recordings.values()
        if one.n_samples and one.sampling_rate
    ]
    rates = sorted(
        {round(one.sampling_rate, 6) for one in recordings.values() if one.sampling_rate}
    )
    if not lasts:
        return
    names = ", ".join(recordings) if len(recordings) < 3 else f"{len(recordings)} recordings"
    hertz = " to ".join(f"{rate:.4g}" for rate in dict.fromkeys((rates[0], rates[-1])))
    together = " in all" if len(recordings) > 1 else ""
    yield shortened(f"{names}: {sum(lasts):.4g} s{together} at {hertz} Hz, {summary.fit.quantity}")


def _verdict(summary: Summary) -> str:
    found = summary.verdict
    if found.outcome == "not converged":
        lost = summary.sampler.status == "unusable"
        return f"Not converged: {'no number is a posterior' if lost else 'numbers may still move'}."
    text = _SIGNS[found.outcome]
    if found.explained is not None:
        text += f" The model explains {_share(found.explained)} % of the {summary.fit.quantity}"
        if summary.fit.residual_rms is not None:
            text += f" ({summary.fit.residual_rms:.3g} {summary.fit.unit} rms left)"
    if found.outcome == "good" and found.asked:
        notes = sum(one.severity == "note" for one in summary.findings)
        more = "none of {} candidates explains more" if not notes else "what it lacks moves nothing"
        text += "; " + more.format(found.asked)
    elif found.outcome == "unchecked":
        text += "; too little was recorded to ask what it lacks"
    elif found.doubtful:
        several = found.doubtful > 1
        text += f"; {found.doubtful} number{'s are' if several else ' is'} doubtful"
    return text + "."


def _share(explained: float) -> str:
    """Write a share with as many nines as it has, and one digit."""
    left = 100.0 * (1.0 - explained)
    digits = 1
    while digits < 4 and left < 0.5 * 10.0**-digits:
        digits += 1
    return f"{100.0 * explained:.{digits}f}"


def _numbers(summary: Summary) -> Iterator[str]:
    rows = {
        row.name: row.row.reported
        for row in parameter_table(summary).rows
        if row.row is not None and row.row.reported is not None and not of_noise(row.name)
    }
    units = {name: summary.rows[name].unit for name in rows}
    shown = {name: one for name, one in rows.items() if one.status != "unidentified"}
    ranked = sorted(shown, key=lambda name: ORDER.index(shown[name].status))
    level = f"{100.0 * summary.level:g} % interval"
    cells = [("", "value", "±", level, "", "")]
    cells += [(name, *_written(shown[name], units[name])) for name in ranked[:ROWS]]
    if len(cells) > 1:
        yield from aligned(cells)
    if len(ranked) > ROWS:
        yield f"and {len(ranked) - ROWS} more: --verbose, or the report"
    open_ = [name for name in summary.joint if name in rows and name not in shown]
    if open_:
        scaled = any(len(one.parameters) > 1 for one in summary.identifiability.null_directions)
        why = "one factor on all of them changes no torque" if scaled else "the motion hides them"
        yield from wrapped(f"Unidentified ({why}): {', '.join(open_)}", indent=2)


def _written(one: Reported, unit: str) -> tuple[str, str, str, str, str]:
    """Write value, sd, interval, unit and status."""
    beside = _BESIDE.get(one.status, one.status)
    if one.bound is not None:
        side = "at most" if one.at_most else "at least"
        return "", "", f"{side} {one.bound:.3g}", unit, beside
    low, high = one.interval
    if not one.sd:
        return f"{one.value:.5g}", "", "", unit, beside
    fine = finer(one.value, low, high, one.sd)
    ends = TEXT.interval(low, high, fine)
    value, sd = (TEXT.ends(x, low, high, fine) for x in (one.value, one.sd))
    return value, sd, ends, unit, beside


def _findings(alerts: Sequence[Alert]) -> Iterator[str]:
    yield from dict.fromkeys(one.line for one in alerts if one.line)


def _next(summary: Summary) -> str:
    """Give the recording that would tell what is open."""
    if summary.verdict.outcome == "not converged":
        return ""
    for direction in summary.identifiability.directions or ():
        for remedy in direction.remedies:
            if remedy.text.startswith("another recording"):
                return remedy.text
    return ""


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
