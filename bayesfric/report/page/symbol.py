r"""The paper's symbols in HTML: ``J_{t}^{\mathrm{drive}}`` with real sub- and superscripts."""

from __future__ import annotations

import re
from collections import deque
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
        tokens = deque(_tokens(shown[1:-1]))
        try:
            set_ = _group(tokens, upright=False)
        except (IndexError, KeyError):
            set_ = Markup()
        if set_ and not tokens:
            return Markup('<span class="sym">{}</span>').format(set_)
    return Markup("<code>{}</code>").format(name)


def _tokens(text: str) -> Iterator[str]:
    for command, mark, plain in _TOKEN.findall(text):
        if command:
            yield "\\" + command
        else:
            yield from mark or plain


def _group(tokens: deque[str], *, upright: bool) -> Markup:
    """Set everything up to a closing brace, which is left."""
    parts = Markup()
    while tokens and tokens[0] != "}":
        parts += _one(tokens, upright=upright)
    return Markup(parts.replace("</i><i>", ""))


def _one(tokens: deque[str], *, upright: bool) -> Markup:
    first = tokens.popleft()
    if first in ("_", "^"):
        tag = "sub" if first == "_" else "sup"
        return Markup(f"<{tag}>{{}}</{tag}>").format(_one(tokens, upright=upright))
    if first == "{":
        inner = _group(tokens, upright=upright)
        tokens.popleft()
        return inner
    if first.startswith("\\"):
        command = first[1:]
        if command in _UPRIGHT:
            return _one(tokens, upright=True)
        if command in (",", ";", ":", " ", "!"):
            return Markup("\u2009" if command != "!" else "")
        return escape(command) if len(command) == 1 else escape(_GREEK[command])
    if first == " ":  # of no meaning in LaTeX's mathematics
        return Markup()
    if first.isalpha() and not upright:
        return Markup("<i>{}</i>").format(first)
    return escape("\u2212" if first == "-" else first)
