"""What terminal, page and print say: ``words.toml`` by kind, and texts out of templates."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from string import Formatter
from typing import Any

from jinja2 import Environment

from bayesfric.base.progress import spent_text
from bayesfric.base.templates import environment, percent, placed, two
from bayesfric.report.numbers import p_text


@dataclass(frozen=True)
class Words:
    """Of one kind: what it is, and what to do about it; either may be empty.

    ``instead`` is what to do where a value of that name is told.
    """

    what: str
    do: str
    instead: Mapping[str, str]


@cache
def words() -> Mapping[str, Words]:
    """Read the table."""
    text = (files("bayesfric.report") / "words.toml").read_text(encoding="utf-8")
    return {
        kind: Words(
            entry.pop("what"),
            entry.pop("do", ""),
            {key.removeprefix("do_"): do for key, do in entry.items()},
        )
        for kind, entry in tomllib.loads(text).items()
    }


def words_of(kind: str) -> Words:
    """Give what is said of a kind; one that only another version knows by name and parameters."""
    return words().get(kind, Words("{kind}", "{parameters}", {}))


def line_of(kind: str, values: Mapping[str, Any] | None = None) -> str:
    """Say one thing in a line without a full stop: what it is, and what to do.

    Of a finding the ``values`` tell its share of the torque (rms), and the key that puts it in.
    """
    told = {"kind": kind, **(values or {})}
    if kind == "put in":
        return f"added: {line_of(told['kind'], told)}"
    known = words_of(_kind(kind, told))
    do = next((text for key, text in known.instead.items() if told.get(key)), known.do)
    what, do = (_FILL.vformat(text, (), told) for text in (known.what, do))
    if "hint" in told:
        what, do = _found(what, do, told)
    return f"{what}: {do}" if do else what


def doubt_text(doubt: Mapping[str, Any]) -> str:
    """Word one of ``summary["doubts"]``."""
    return line_of(doubt["kind"], doubt)


def clause(kind: str, values: Mapping[str, Any] | None = None) -> str:
    """Say what it is alone, as behind "because"."""
    told = {"kind": kind, **(values or {})}
    what = _FILL.vformat(words_of(_kind(kind, told)).what, (), told)
    if kind == "missing":
        what += f" ({percent(told['share'])} % rms)"
    return what


def listed(parts: Sequence[str]) -> str:
    """Join words: ``a, b and c``."""
    parts = list(parts)
    return " and ".join(filter(None, [", ".join(parts[:-1]), *parts[-1:]]))


def _kind(kind: str, values: Mapping[str, Any]) -> str:
    """Give a finding by its own kind, which a doubt has as ``what``."""
    return str(values.get("what", kind)) if kind == "missing" else kind


def _found(what: str, do: str, told: Mapping[str, Any]) -> tuple[str, str]:
    share = f"({percent(told['share'])} % rms)"
    if told.get("span"):
        low, high = told["span"]
        return f"{what} {share}", f"exclude = [[{low:.1f}, {high:.1f}]] of {told['recording']}"
    if not told.get("physical", True):
        return f"{what} of the wrong sign {share}", "something that is on no list"
    if told["hint"]:
        table, line = placed(told["hint"])
        do = f"{line} in [{table}]"
    return f"{what} {share}", do


class _Fill(Formatter):
    """Fills a line; what is not told is left out, a list is cut to three."""

    def get_value(self, key: int | str, _: Sequence[Any], told: Mapping[str, Any]) -> Any:
        value = told.get(str(key), "")
        return percent(value) if key == "share" else value

    def format_field(self, value: Any, spec: str) -> str:
        if spec and value != "":
            return f"{percent(value)} %" if spec == "%" else format(value, spec)
        if isinstance(value, Mapping):
            value = [f"{name} ({two(x)})" for name, x in value.items()]
        if isinstance(value, list | tuple):
            more = f" and {len(value) - 3} more" if len(value) > 3 else ""
            return ", ".join(map(str, value[:3])) + more
        return two(value) if isinstance(value, float) else str(value)


_FILL = _Fill()


def filled(template: str, **values: Any) -> str:
    """Fill a template of plain text; lines that only hold markup leave nothing."""
    return text_environment().get_template(template).render(**values)


def csv_text(lines: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> str:
    """Lay a table out as CSV, every number in full."""
    import pandas as pd  # takes half a second, which not every command has to wait

    return str(pd.DataFrame(list(lines), columns=list(columns)).to_csv(index=False))


# What templates of text and of pages have in common.
FILTERS = {
    "p": p_text,
    "white": lambda white: "pass as white" if white else "do NOT pass as white",
    "listed": listed,
    "spent": spent_text,
    "said": lambda kind: words_of(kind).what,
}


@cache
def text_environment() -> Environment:
    """Give the environment of templates that make plain text."""
    made = environment("bayesfric.report")
    made.filters |= FILTERS
    return made
