r"""A methods paragraph about what a run really did, with what it cites.

The same sentences as plain text and as LaTeX; every number is read from the fit and its
summary, and nothing is cited that was not used.
"""

from __future__ import annotations

import platform
import re
from dataclasses import dataclass, replace
from importlib.metadata import version

import bayesfric
from bayesfric.inference.fit import Fit
from bayesfric.inference.noise import SCALES
from bayesfric.mechanism.parameter import effort_words
from bayesfric.report.comparison.cell import TOGETHER
from bayesfric.report.paper import latex
from bayesfric.report.paper.bibliography import ENTRIES, bibliography
from bayesfric.report.paper.tables import counts, parameter_table
from bayesfric.report.summary.noise import correlation_warning
from bayesfric.report.summary.record import Readable, Summary
from bayesfric.report.text_templates import filled

_CITED = re.compile(r"\s*\[@([\w;@]+)\]")
_VERSIONS = ("numpy", "scipy", "emcee", "arviz", "numba")


@dataclass(frozen=True)
class MethodsText:
    r"""A paragraph in three forms.

    Attributes
    ----------
    plain
        Text with citations such as (Foreman-Mackey et al. 2013).
    latex
        The same with ``\cite``.
    bibtex
        What it cites.
    keys
        BibTeX keys in the order of first use.
    """

    plain: str
    latex: str
    bibtex: str
    keys: tuple[str, ...]


def methods_text(fit: Fit, summary: Readable) -> MethodsText:
    """Write what was done in a run.

    Parameters
    ----------
    fit
        A finished fit.
    summary
        From :func:`bayesfric.report.summary.summary.summarise`.
    """
    marked = effort_words(_sentences(fit, Summary.read(summary)), fit.chain.motor_motion)
    keys = tuple(
        dict.fromkeys(key for found in _CITED.findall(marked) for key in found.split(";@"))
    )

    def words(match: re.Match[str]) -> str:
        return " (" + "; ".join(ENTRIES[key].short for key in match[1].split(";@")) + ")"

    parts = []
    last = 0
    for match in _CITED.finditer(marked):
        parts += [latex.escaped(marked[last : match.start()])]
        parts += [rf"~\cite{{{match[1].replace(';@', ',')}}}"]
        last = match.end()
    parts.append(latex.escaped(marked[last:]))
    typeset = _typeset("".join(parts))
    return MethodsText(_CITED.sub(words, marked) + "\n", typeset + "\n", bibliography(keys), keys)


def _typeset(text: str) -> str:
    """Keep numbers and their units on one line, and set what has a symbol as one."""
    text = re.sub(r"(\d) (\\%|(?:Hz|rad/s|m/s|ms|s|kg|m|N)\b)", r"\1\\,\2", text)
    text = text.replace("\\,N m", r"\,N\,m").replace("R-hat", r"$\widehat{R}$")
    return re.sub(r"\bp (=|<) (\d\.?\d*)(?:e([+-]\d+))?", _p_value, text)


def _p_value(found: re.Match[str]) -> str:
    power = rf"\times 10^{{{int(found[3])}}}" if found[3] else ""
    return f"$p {found[1]} {found[2]}{power}$"


def _sentences(fit: Fit, summary: Summary) -> str:
    """Fill the template; a line of it is a sentence, an empty line ends a paragraph."""
    seen = fit.observations
    loaded = [o.inputs for o in seen if o.inputs.added_mass]

    def each(key: str) -> str:
        values = sorted({float(o.settings[key]) for o in seen})
        ends = values[:1] if len(values) == 1 else [values[0], values[-1]]
        return " to ".join(f"{value:.4g}" for value in ends)

    def total(key: str) -> int:
        return sum(int(o.settings[key]) for o in seen)

    joint = parameter_table(summary).joint
    text = filled(
        "methods.txt.j2",
        fit=fit,
        chain=fit.chain,
        noise=fit.target.noise,
        remarks=dict.fromkeys(SCALES[kind].remark for kind in fit.target.noise.quantities),
        summary=summary,
        each=each,
        total=total,
        masses=list(dict.fromkeys(replace(i, recording="") for i in loaded)),
        carried=len(loaded),
        joint=joint,
        by=counts([row for row in joint if row.cell.converged]),
        together=TOGETHER,
        correlated=correlation_warning(summary),
        python=platform.python_version(),
        bayesfric=bayesfric.__version__,
        versions={name: version(name) for name in _VERSIONS},
    )
    paragraphs = (" ".join(part.split()) for part in re.split(r"\n\s*\n", text))
    return "\n\n".join(part for part in paragraphs if part)
