"""Symbols, units and words as LaTeX with siunitx writes them."""

from __future__ import annotations

import re

from bayesfric.report.figures.style import mathtext

_ESCAPED = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
}
_TYPESET = {
    "²": r"\textsuperscript{2}",
    "µ": r"\textmu{}",
    "–": "--",
    "±": r"\ensuremath{\pm}",
    "≤": r"\ensuremath{\leq}",
    "≥": r"\ensuremath{\geq}",
    "°": r"\textdegree{}",
    "…": r"\dots{}",
    "†": r"\dag{}",
}


def escaped(text: str) -> str:
    """Write plain text so that LaTeX prints it as it is."""
    both = _ESCAPED | _TYPESET
    return "".join(both.get(c, c) for c in text)


def symbol(latex: str, name: str) -> str:
    """Set a quantity's symbol; its name in typewriter where it has none that can be set."""
    shown = mathtext(latex, name) if latex else ""
    return shown if shown.startswith("$") else rf"\texttt{{{escaped(name)}}}"


def unit(text: str) -> str:
    """Write a unit such as ``kg m²`` or ``N s/m`` for siunitx; ``1`` where there is none."""
    if not text:
        return "1"
    return rf"\unit{{{re.sub(' +', '.', text.strip()).replace('²', '^2')}}}"
