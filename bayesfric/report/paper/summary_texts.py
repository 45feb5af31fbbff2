"""The files of a run directory that follow from its ``summary.json`` alone."""

from __future__ import annotations

from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.comparison.table import comparison_csv, comparison_markdown
from bayesfric.report.paper.tables import (
    methods_latex,
    parameter_table,
    parameters_csv,
    parameters_latex,
    parameters_markdown,
)
from bayesfric.report.summary.record import Readable
from bayesfric.report.summary.summary import summary_table


def summary_texts(summary: Readable, run: str) -> dict[str, str]:
    """Lay a run's numbers out as its tables.

    Parameters
    ----------
    summary
        What ``summary.json`` holds.
    run
        Name of the run.

    Returns
    -------
    dict
        Contents by file name inside the run directory.

    Raises
    ------
    BadInput
        Where the summary lacks something.
    """
    table = parameter_table(summary, run)
    methods = comparison({run: summary})
    return {
        "summary.csv": summary_table(summary),
        "methods.csv": comparison_csv(methods),
        "methods.md": comparison_markdown(methods),
        "tables/parameters.tex": parameters_latex(table),
        "tables/parameters.md": parameters_markdown(table),
        "tables/parameters.csv": parameters_csv(table),
        "tables/methods.tex": methods_latex(methods),
    }
