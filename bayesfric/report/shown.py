"""A summary that shows itself: as the terminal says it, and as a notebook's table."""

from __future__ import annotations

from bayesfric.report.summary import record


class Summary(record.Summary):
    """Every number of a run, with what must be said of it."""

    def __str__(self) -> str:
        """Say it as the terminal does."""
        from bayesfric.report.terminal import fit_text

        return "\n".join(fit_text(self))

    def _repr_html_(self) -> str:
        """Show the table with its verdicts in a notebook."""
        from bayesfric.report.page.rendering import notebook_table  # brings Matplotlib with it

        return notebook_table(self)
