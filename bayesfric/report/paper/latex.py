"""Symbols, units and text as LaTeX with siunitx."""

from __future__ import annotations

import re
import unicodedata
from importlib.resources import files

from bayesfric.base import __version__

_ESCAPED = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#",
    "%": r"\%", "_": r"\_", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}",
}  # fmt: skip
_TYPESET = {
    "²": r"\textsuperscript{2}", "³": r"\textsuperscript{3}", "µ": r"\textmu{}", "μ": r"\textmu{}",
    "°": r"\textdegree{}", "–": "--", "…": r"\dots{}", "†": r"\dag{}",
    "−": r"\ensuremath{-}", "×": r"\ensuremath{\times}", "·": r"\ensuremath{\cdot}",
    "±": r"\ensuremath{\pm}", "≤": r"\ensuremath{\leq}", "≥": r"\ensuremath{\geq}",
    # the standard fonts have other signs in their places
    "<": r"\ensuremath{<}", ">": r"\ensuremath{>}", "|": r"\textbar{}",
}  # fmt: skip


def escaped(text: str) -> str:
    """Write plain text so that LaTeX prints it as it is; ``?`` for what pdflatex cannot print."""
    characters = _ESCAPED | _TYPESET
    return "".join(characters.get(c) or _printable(c) for c in text)


def _printable(character: str) -> str:
    # letters of western and central Europe, such as in a recording's name, pdflatex knows
    if character < "\u017f" and (character.isascii() or character.isalpha()):
        return character
    plain = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    return "".join(_ESCAPED.get(c, c) for c in plain) or "?"


def references() -> str:
    """Give the BibTeX entries of the methods and of this package."""
    text = (files("bayesfric.report.paper") / "references.bib").read_text(encoding="utf-8")
    return text.replace("VERSION", __version__)


def symbol(latex: str, name: str) -> str:
    """Write a quantity's symbol, or its name in typewriter."""
    from bayesfric.report.figures.style import mathtext  # with Matplotlib

    shown = mathtext(latex, name) if latex else ""
    return shown if shown.startswith("$") else rf"\texttt{{{escaped(name)}}}"


def unit(text: str) -> str:
    """Write a unit such as ``kg m²`` or ``N s/m`` for siunitx; ``1`` where there is none."""
    if not text:
        return "1"
    return rf"\unit{{{re.sub(' +', '.', text.strip()).replace('²', '^2')}}}"
