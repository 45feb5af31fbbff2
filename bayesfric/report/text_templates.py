"""Sentences and texts out of templates: what a run says is data until it is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from jinja2 import Environment

from bayesfric.progress import spent_text
from bayesfric.report.numbers import p_text
from bayesfric.report.words import words_of
from bayesfric.templates import environment


def sentence(kind: str, values: Mapping[str, Any] | None = None) -> str:
    """Word one kind of warning or doubt, without a full stop.

    ``kind`` names its macro in ``templates/sentences.txt.j2``; spaces and hyphens stand for
    underscores.
    """
    macro = kind.replace(" ", "_").replace("-", "_")
    return str(getattr(_sentences(), macro)(values or {})).strip()


def reason(kind: str, values: Mapping[str, Any]) -> str:
    """Say in one clause why numbers are doubtful, for print; in general of kinds not known."""
    known = text_environment().get_template("reasons.txt.j2").module
    macro = getattr(known, kind.replace("-", "_"), None) or known.other  # type: ignore[attr-defined]
    return str(macro(values)).strip()


def filled(template: str, **values: Any) -> str:
    """Fill a template of plain text; lines that only hold markup leave nothing."""
    return text_environment().get_template(template).render(**values)


def listed(parts: Sequence[str]) -> str:
    """Join words: ``a, b and c``."""
    parts = list(parts)
    return " and ".join(filter(None, [", ".join(parts[:-1]), *parts[-1:]]))


def white_words(white: bool, allowed: bool = False) -> str:
    """Say of innovations whether they are white noise by their test.

    ``allowed`` tells whether intervals with room for the model's error are shown first.
    """
    narrow = "the narrower intervals, told as 'were the model right'," if allowed else "intervals"
    return "pass as white" if white else f"do NOT pass as white: {narrow} may be too narrow"


# What templates of text and of pages have in common.
FILTERS = {"p": p_text, "white": white_words, "listed": listed, "spent": spent_text}
FILTERS |= {"named": lambda kind: words_of(kind).what, "to_do": lambda kind: words_of(kind).do}


@cache
def text_environment() -> Environment:
    """Give the environment of templates that make plain text."""
    made = environment("bayesfric.report")
    made.filters |= FILTERS
    return made


@cache
def _sentences() -> Any:
    return text_environment().get_template("sentences.txt.j2").module
