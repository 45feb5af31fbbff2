"""What a user is meant to see when a command ends early: bad input, in one line, or a stop."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

# A name from a damaged file may be a megabyte long; nobody reads that in one line.
_LONGEST = 800
_LONGEST_WORD = 100


class BadInput(Exception):
    """Input that cannot be used, told in one line.

    ``where`` is the file, column, row or key at fault, as the user wrote it, ``what`` is wrong with
    it, and ``mend`` says what to do about it. The command line prints ``str(error)`` and exits with
    code 2; a library caller gets the three parts as attributes.
    """

    def __init__(self, where: str, what: str, mend: str) -> None:
        self.where = _one_line(where)
        self.what = _one_line(what)
        self.mend = _one_line(mend)
        super().__init__(f"{self.where}: {self.what}; {self.mend}")

    def __reduce__(self) -> tuple[type[BadInput], tuple[str, str, str]]:
        # an exception is made again from its message alone, in another process too
        return type(self), (self.where, self.what, self.mend)


class Unfit(ValueError):
    """An option's value that does not fit, for a model's validator to raise.

    ``wanted`` is what is expected, as ``"a mass like '2 kg'"``, and ``what`` is there, as
    ``"got '2 m'"``.
    """

    def __init__(self, wanted: str, what: str) -> None:
        self.wanted, self.what = wanted, what
        super().__init__(f"expected {wanted}, {what}")


class Interrupted(Exception):
    """Ctrl-C or SIGTERM stopped a command that can be gone on with; its text says what is kept.

    No KeyboardInterrupt: on that typer ends the process by itself, and says nothing.
    """


def nearest(word: str, known: Iterable[str]) -> str:
    """Word a mend for a misspelt name: the nearest known one, or all of them."""
    choices = list(known)
    # comparing takes time with the square of the length
    close = difflib.get_close_matches(word[:_LONGEST_WORD], choices, n=1, cutoff=0.6)
    if close:
        return f"did you mean {close[0]!r}?"
    return f"use one of {', '.join(choices)}" if choices else "leave it out"


def _one_line(text: str) -> str:
    """Join lines, and escape what a terminal would obey or could not show."""
    text = " ".join(str(text).split())
    if len(text) > _LONGEST:
        text = f"{text[: _LONGEST // 2]} … {text[-_LONGEST // 2 :]}"
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
