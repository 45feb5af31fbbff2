"""A run's result as a terminal shows it."""

from __future__ import annotations

from collections.abc import Iterator

from bayesfric.report.alerts import alerts_of, first_step
from bayesfric.report.comparison.cell import posterior_cells, settled_by
from bayesfric.report.paper.tables import parameter_table
from bayesfric.report.summary.bounds import bound_mend
from bayesfric.report.summary.caveats import constant_sentence
from bayesfric.report.summary.noise import noise_lines
from bayesfric.report.summary.record import Readable, Summary
from bayesfric.report.summary.self_check import narrow, self_check_lines
from bayesfric.report.summary.validation import validation_lines
from bayesfric.report.text_templates import filled


def fit_text(summary: Readable) -> Iterator[str]:
    """Word a summary for a person, line by line."""
    read = Summary.read(summary)
    cells = posterior_cells(read)
    parts = {"What the motor feels, whatever the scale": read.felt, "Parameters": read.parameters}
    yield from filled(
        "fit.txt.j2",
        summary=read,
        alerts=alerts_of(read),
        first=first_step(read),
        parts=parts,
        cells=cells,
        told={row.name: row for row in parameter_table(read).rows},
        lost=[name for rows in parts.values() for name in rows if not cells[name].converged],
        mends={
            name: bound_mend(name, row) for rows in parts.values() for name, row in rows.items()
        },
        noise=list(noise_lines(read.noise, allowed=read.widened)),
        held_out=list(validation_lines(read.validation)) if read.validation else [],
        self_check=list(self_check_lines(read)),
        narrow=narrow(read),
        constant=constant_sentence(read),
        settled_by=settled_by,
    ).splitlines()
