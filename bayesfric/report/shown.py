"""A summary whose text is that of the terminal."""

from __future__ import annotations

from bayesfric.report.summary import record


class Summary(record.Summary):
    """Every number of a run, with what must be said of it."""

    def __repr__(self) -> str:
        """Say it as the terminal does."""
        from bayesfric.report.terminal import fit_text

        return "\n".join(fit_text(self))

    __str__ = __repr__
