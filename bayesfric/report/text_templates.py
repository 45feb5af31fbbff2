"""Texts out of templates: what a run says is data until it is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from jinja2 import Environment

from bayesfric.progress import spent_text
from bayesfric.report.numbers import p_text
from bayesfric.report.words import listed, words_of
from bayesfric.templates import environment


def filled(template: str, **values: Any) -> str:
    """Fill a template of plain text; lines that only hold markup leave nothing."""
    return text_environment().get_template(template).render(**values)


def csv_text(lines: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> str:
    """Lay a table out as CSV, every number in full."""
    import pandas as pd  # takes half a second, which not every command has to wait

    return str(pd.DataFrame(list(lines), columns=list(columns)).to_csv(index=False))


def white_words(white: bool) -> str:
    """Say of innovations whether they are white noise by their test."""
    return "pass as white" if white else "do NOT pass as white"


# What templates of text and of pages have in common.
FILTERS = {
    "p": p_text,
    "white": white_words,
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
