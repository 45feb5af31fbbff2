"""Numbers of a run in words, for the text alternatives of its figures.

A number that the data leave open is named as such, without its interval.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from markupsafe import Markup

from bayesfric.report.page.values import interval_html, value_html, verdict_words
from bayesfric.report.paper.tables import ParameterRow

_RAISED = str.maketrans("0123456789-\u2212", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁻")


def rows_in_words(rows: Iterable[ParameterRow]) -> str:
    """Say numbers without markup, each with its verdict."""
    return "; ".join(map(_in_words, rows)) + "."


def _in_words(row: ParameterRow) -> str:
    if row.cell.status == "undetermined":
        return f"{row.name}: {verdict_words(row)}"
    value = text_of(value_html(row))
    ends = text_of(interval_html(row)) if row.cell.status == "determined" else ""
    unit = f" {row.unit}" if row.unit else ""
    said = f"{row.name}: {value}{f', interval {ends}' if ends and ends != '–' else ''}{unit}"
    return f"{said}, {judgement(row)}" if row.row is not None else said


def quantity_of(row: ParameterRow) -> str:
    """Give what a number is of its element, the part of its name behind the dot."""
    return row.name.rpartition(".")[2]


def judgement(row: ParameterRow) -> str:
    """Say what determined a number, or that nothing did."""
    doubted = row.row is not None and row.row.doubted
    open_ = doubted or row.cell.status == "undetermined"
    return verdict_words(row) if open_ else f"determined by {verdict_words(row)}"


def text_of(markup: Markup) -> str:
    """Take the markup off; a raised number stays raised."""
    raised = re.sub(
        r"×\u00a010<sup>([^<]*)</sup>", lambda m: "×\u00a010" + m[1].translate(_RAISED), markup
    )
    return Markup(re.sub(r"<[^>]*>", "", raised)).unescape()
