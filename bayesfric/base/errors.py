"""Errors that the command line prints in one line: bad input, or an interruption."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class BadInput(Exception):
    """Input that cannot be used, in one line.

    Parameters
    ----------
    where
        The file, column, row or key at fault, as the user wrote it.
    problem
        What is wrong with it.
    hint
        What to do about it. The three are attributes, too.
    """

    def __init__(self, where: str, problem: str, hint: str) -> None:
        self.where = _one_line(where)
        self.problem = _one_line(problem)
        self.hint = _one_line(hint)
        super().__init__(f"{self.where}: {self.problem}; {self.hint}")

    def __reduce__(self) -> tuple[type[BadInput], tuple[str, str, str]]:
        # an exception is made again from its message alone, in another process too
        return type(self), (self.where, self.problem, self.hint)


class Unfit(ValueError):
    """Raised by a model's validator: ``wanted`` as ``"a mass"``, ``problem`` as ``"got '2 m'"``."""

    def __init__(self, wanted: str, problem: str) -> None:
        self.wanted, self.problem = wanted, problem
        super().__init__(f"expected {wanted}, {problem}")


class Interrupted(Exception):
    """Ctrl-C or SIGTERM stopped a command that can be resumed; its text says what is kept.

    Not a KeyboardInterrupt: on that typer ends the process without a message.
    """


def nearest(word: str, known: Iterable[str]) -> str:
    """Suggest what a misspelt name may be: the nearest known one, or all of them."""
    choices = list(known)
    # the time grows with the square of the length
    close = difflib.get_close_matches(word[:100], choices, n=1, cutoff=0.6)
    if close:
        return f"did you mean {close[0]!r}?"
    return f"use one of {', '.join(choices)}" if choices else "leave it out"


def _one_line(text: str) -> str:
    """Join lines, cut long names, and escape control characters."""
    text = " ".join(str(text).split())
    text = text if len(text) <= 800 else f"{text[:400]} … {text[-400:]}"
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
