"""The one error a user is meant to see: bad input, in one line."""

from __future__ import annotations


class BadInput(Exception):
    """Input that cannot be used, told in one line.

    Parameters
    ----------
    where
        The file, column, row or key at fault, as the user wrote it.
    what
        What is wrong with it.
    mend
        What to do about it.

    Notes
    -----
    The command line prints ``str(error)`` and exits with code 2; a library
    caller gets the three parts as attributes.
    """

    def __init__(self, where: str, what: str, mend: str) -> None:
        self.where = _one_line(where)
        self.what = _one_line(what)
        self.mend = _one_line(mend)
        super().__init__(f"{self.where}: {self.what}; {self.mend}")


def _one_line(text: str) -> str:
    return " ".join(str(text).split())
