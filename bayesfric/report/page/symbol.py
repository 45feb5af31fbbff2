r"""The paper's symbols in HTML: ``J_{t}^{\mathrm{drive}}`` with real sub- and superscripts."""

from __future__ import annotations

import re
from collections.abc import Iterator

from markupsafe import Markup, escape

from bayesfric.report.figures.style import mathtext

_GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "epsilon": "ε", "eta": "η",
    "theta": "θ", "kappa": "κ", "lambda": "λ", "mu": "μ", "nu": "ν", "phi": "φ", "pi": "π",
    "rho": "ρ", "sigma": "σ", "tau": "τ", "chi": "χ", "psi": "ψ", "omega": "ω",
    "Delta": "Δ", "Gamma": "Γ", "Lambda": "Λ", "Omega": "Ω", "Phi": "Φ", "Sigma": "Σ",
    "Theta": "Θ", "dot": "", "cdot": "·", "times": "×",
    "sin": "\u2009sin\u2009", "cos": "\u2009cos\u2009",
}  # fmt: skip
_UPRIGHT = ("mathrm", "text", "mathit", "operatorname")
_TOKEN = re.compile(r"\\([A-Za-z]+|.)|([{}_^])|([^\\{}_^]+)", re.DOTALL)


def html_symbol(symbol: str, name: str) -> Markup:
    """Set a quantity's LaTeX symbol for a page; its name as code where that cannot be.

    Only ``i``, ``sub``, ``sup`` and escaped text, whatever the symbol holds.
    """
    # as figures set it: words in subscripts upright, underscores of names kept
    shown = mathtext(symbol, name) if symbol else ""
    if shown.startswith("$"):
        tokens = list(_tokens(shown[1:-1]))
        try:
            set_, rest = _group(tokens, upright=False)
        except (IndexError, KeyError):
            set_, rest = Markup(), tokens
        if set_ and not rest:
            return Markup('<span class="sym">{}</span>').format(set_)
    return Markup("<code>{}</code>").format(name)


def _tokens(text: str) -> Iterator[str]:
    for command, mark, plain in _TOKEN.findall(text):
        if command:
            yield "\\" + command
        elif mark:
            yield mark
        else:
            yield from plain


def _group(tokens: list[str], *, upright: bool) -> tuple[Markup, list[str]]:
    """Set everything up to a closing brace; return what comes behind it."""
    parts: list[Markup] = []
    while tokens and tokens[0] != "}":
        part, tokens = _one(tokens, upright=upright)
        parts.append(part)
    return _joined(parts), tokens


def _one(tokens: list[str], *, upright: bool) -> tuple[Markup, list[str]]:
    first, rest = tokens[0], tokens[1:]
    if first in ("_", "^"):
        tag = "sub" if first == "_" else "sup"
        inner, rest = _one(rest, upright=upright)
        return Markup(f"<{tag}>{{}}</{tag}>").format(inner), rest
    if first == "{":
        inner, rest = _group(rest, upright=upright)
        return inner, rest[1:]
    if first.startswith("\\"):
        command = first[1:]
        if command in _UPRIGHT:
            return _one(rest, upright=True)
        if command in (",", ";", ":", " ", "!"):
            return Markup("\u2009" if command != "!" else ""), rest
        return (escape(command) if len(command) == 1 else escape(_GREEK[command])), rest
    if first == " ":  # of no meaning in LaTeX's mathematics
        return Markup(), rest
    if first.isalpha() and not upright:
        return Markup("<i>{}</i>").format(first), rest
    return escape("\u2212" if first == "-" else first), rest


def _joined(parts: list[Markup]) -> Markup:
    return Markup(str(Markup("").join(parts)).replace("</i><i>", ""))
