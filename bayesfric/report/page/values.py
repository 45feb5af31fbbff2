"""Numbers and verdicts as a page shows them: never a bare open interval."""

from __future__ import annotations

from markupsafe import Markup

from bayesfric.report.comparison.cell import Cell, settled_by
from bayesfric.report.numbers import HTML, finer
from bayesfric.report.paper.tables import ParameterRow


def verdict_words(row: ParameterRow) -> str:
    """Say what determined a number, in words that stand in its line."""
    told, settled = row.row, row.by == "together" and not row.cell.doubted
    if told is None or row.cell.doubted or not (settled or (row.by == "limit" and told.given_by)):
        return row.verdict
    return settled_by(told) + ("" if settled else ", on one side only")


def verdict_kind(row: ParameterRow) -> str:
    """Sort verdicts from ``data`` to ``open``."""
    return "weak" if row.by == "together" else row.by


def value_html(row: ParameterRow) -> Markup:
    """Write a number with its standard deviation, or what may be said of it instead."""
    if row.by == "open":
        words = "not determined" if row.cell.converged else "not converged"
        return Markup('<span class="open">{}</span>').format(words)
    return Markup(row.shown(HTML)[0])


def interval_html(row: ParameterRow) -> Markup:
    """Write an interval; of an open number in words that say so."""
    if not row.cell.converged:
        return Markup('<span class="open">none: the ensembles disagree, or stand still</span>')
    if row.by == "open" and row.row is not None:
        return Markup('<span class="open">prior and bounds leave {} to {}</span>').format(
            *(HTML.number(end, 3) for end in row.row.interval)
        )
    return Markup(row.shown(HTML)[1])


def were_right_html(row: ParameterRow) -> Markup | None:
    """Write the interval that takes the model for right, where that is not the one shown."""
    told = row.row
    if told is None or not told.widened or row.cell.status != "determined":
        return None
    low, high = told.interval
    fine = finer(told.middle, low, high, told.sd)
    return Markup(row.with_doubt(HTML.interval(low, high, fine))) if told.sd else None


def cell_html(cell: Cell | None) -> Markup:
    """Write one cell of a comparison; an open one in words only."""
    if cell is None:
        return Markup('<span class="quiet">–</span>')
    shown = {
        "plain": '{}<sup class="mark">†</sup>',
        "open": '<span class="open">{}</span>',
        "quiet": '<span class="quiet">{}</span>',
    }
    lines = [Markup(shown.get(kind, "{}")).format(text) for kind, text in cell.parts(HTML)]
    return Markup("<br>").join(lines)
