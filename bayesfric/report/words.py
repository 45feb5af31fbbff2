"""Wording of every message by its kind (``words.toml``), and texts from templates."""

from __future__ import annotations

import csv
import io
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from string import Formatter
from typing import Any

from jinja2 import Environment

from bayesfric.base.progress import time_text
from bayesfric.base.templates import environment, percent, placed, two
from bayesfric.report.numbers import p_text
from bayesfric.results.roll_out import tells_nothing


@cache
def words() -> Mapping[str, Mapping[str, str]]:
    """Read the table: of each kind ``what`` it is, and what to ``do``.

    ``do_key`` is what to do instead where there is a value of that name, ``section`` that of the
    page that says more.
    """
    return tomllib.loads((files("bayesfric.report") / "words.toml").read_text(encoding="utf-8"))


def words_of(kind: str) -> Mapping[str, str]:
    """Give the words of a kind; of one from another version its name and parameters."""
    return words().get(kind, {"what": "{kind}", "do": "{parameters}"})


def line_of(kind: str, values: Mapping[str, Any] | None = None) -> str:
    """Word a message in a line without a full stop: what it is, and what to do.

    Of a finding the ``values`` give its share of the torque (rms), and the key that adds it.
    """
    values = {"kind": kind, **(values or {})}
    if kind == "put in":
        added = values.get("what", values["kind"])
        return f"added: {line_of(added, values | {'kind': added})}"
    known = words_of(_kind(kind, values))
    instead = (text for key, text in known.items() if key[:3] == "do_" and values.get(key[3:]))
    remedy = next(instead, known.get("do", ""))
    statement, remedy = (_FILL.vformat(text, (), values) for text in (known["what"], remedy))
    if "hint" in values:
        statement, remedy = _finding(statement, remedy, values)
    return f"{statement}: {remedy}" if remedy else statement


def doubt_text(doubt: Mapping[str, Any]) -> str:
    """Word one of ``summary["doubts"]``."""
    return line_of(doubt["kind"], doubt)


def clause(kind: str, values: Mapping[str, Any] | None = None) -> str:
    """Say what it is, without what to do, as behind "because"."""
    values = {"kind": kind, **(values or {})}
    statement = _FILL.vformat(words_of(_kind(kind, values))["what"], (), values)
    if kind == "missing":
        statement += f" {_share(values)}"
    return statement


def _share(values: Mapping[str, Any]) -> str:
    """Say a share of the torque's rms, of which no more than a tenth of a per cent matters."""
    small = values["share"] < 1e-3
    return f"({'below 0.1' if small else percent(values['share'])} % rms)"


def listed(parts: Sequence[str]) -> str:
    """Join words: ``a, b and c``."""
    parts = list(parts)
    return " and ".join(filter(None, [", ".join(parts[:-1]), *parts[-1:]]))


def _kind(kind: str, values: Mapping[str, Any]) -> str:
    """Give the kind of a finding, which a doubt has as ``what``."""
    return str(values.get("what", kind)) if kind == "missing" else kind


def _finding(statement: str, remedy: str, values: Mapping[str, Any]) -> tuple[str, str]:
    share = _share(values)
    if values.get("span"):
        low, high = values["span"]
        return (
            f"{statement} {share}",
            f"exclude = [[{low:.1f}, {high:.1f}]] of {values['recording']}",
        )
    if not values.get("physical", True):
        return f"{statement} of the wrong sign {share}", "something that is on no list"
    if values["hint"]:
        table, line = placed(values["hint"])
        remedy = f"{line} in [{table}]"
    return f"{statement} {share}", remedy


class _Fill(Formatter):
    """Fills a line; missing values are left out, a list is cut to three."""

    def get_value(self, key: int | str, _: Sequence[Any], values: Mapping[str, Any]) -> Any:
        value = values.get(str(key), "")
        return percent(value) if key == "share" else value

    def format_field(self, value: Any, spec: str) -> str:
        if spec and value != "":
            return f"{percent(value)} %" if spec == "%" else format(value, spec)
        if isinstance(value, Mapping):
            value = [f"{name} ({two(x)})" for name, x in value.items()]
        if isinstance(value, list | tuple):
            rest = f" and {len(value) - 3} more" if len(value) > 3 else ""
            return ", ".join(map(str, value[:3])) + rest
        return two(value) if isinstance(value, float) else str(value)


_FILL = _Fill()


def filled(template: str, **values: Any) -> str:
    """Fill a template of plain text."""
    return text_environment().get_template(template).render(**values)


def csv_text(lines: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> str:
    """Write a table as CSV, every number in full; nothing for what is no number."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(columns)
    for line in lines:
        cells = map(line.get, columns)
        table.writerow([None if cell != cell else cell for cell in cells])  # not a number
    return text.getvalue()


# Of templates of text and of pages.
FILTERS = {
    "p": p_text,
    "white": lambda white: "pass as white" if white else "do NOT pass as white",
    "listed": listed,
    "spent": time_text,
    "line": line_of,
    "too_wide": lambda row: tells_nothing(row["blind"], row["over"]),
    "what": lambda kind: words_of(kind)["what"],
}


@cache
def text_environment() -> Environment:
    """Load the templates that make plain text."""
    templates = environment("bayesfric.report")
    templates.filters |= FILTERS
    return templates
