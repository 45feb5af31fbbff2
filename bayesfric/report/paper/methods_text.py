r"""A methods paragraph about what a run really did, with what it cites.

The same sentences as plain text and as LaTeX; every number is read from the fit and its
summary, and nothing is cited that was not used.
"""

from __future__ import annotations

import platform
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from importlib.resources import files
from typing import NamedTuple

from bayesfric.inference.fitting import Fit
from bayesfric.inference.noise import SCALES
from bayesfric.mechanism.parameter import effort_words
from bayesfric.recordings.moving import too_slow
from bayesfric.recordings.observation import Observation
from bayesfric.report.comparison.cell import TOGETHER
from bayesfric.report.numbers import text_rounded
from bayesfric.report.paper import latex
from bayesfric.report.paper.equation import latex_equations, of_eq_13, plain_equations
from bayesfric.report.paper.tables import counts, parameter_table
from bayesfric.report.summary.noise import correlation_warning
from bayesfric.report.summary.record import Readable, Summary
from bayesfric.report.summary.self_check_part import biased, seldom_held_sentence
from bayesfric.report.text_templates import filled
from bayesfric.version import __version__

_ENTRY = re.compile(r"^% ([^\n]+)\n(@\w+\{(\w+),\n.*?^\}\n)", re.MULTILINE | re.DOTALL)


class Entry(NamedTuple):
    """One reference: ``short`` as written in plain text, ``text`` its BibTeX."""

    short: str
    text: str


# this package's own entry names its version
_BIB = (files("bayesfric.report.paper") / "references.bib").read_text(encoding="utf-8")
_BIB = _BIB.replace("VERSION", __version__)
ENTRIES = {key: Entry(short, entry) for short, entry, key in _ENTRY.findall(_BIB)}


def bibliography(keys: Sequence[str]) -> str:
    """Write the entries of the given keys as a BibTeX file, in that order."""
    return "\n".join(ENTRIES[key].text for key in keys)


_CITED = re.compile(r"\s*\[@([\w;@]+)\]")
_VERSIONS = ("numpy", "scipy", "emcee", "arviz", "numba")


@dataclass(frozen=True)
class MethodsText:
    """A paragraph in three forms."""

    plain: str  # text with citations such as (Foreman-Mackey et al. 2013)
    latex: str  # the same with `\cite`
    bibtex: str  # what it cites
    keys: tuple[str, ...]  # BibTeX keys in the order of first use


def methods_text(fit: Fit, summary: Readable) -> MethodsText:
    """Write what was done in a run."""
    summary = Summary.read(summary)
    marked = effort_words(_sentences(fit, summary), fit.chain.motor_motion)
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
    # of the tables, which have no names
    symbols = {n: row.symbol for n, row in {**summary.rows, **summary.fixed}.items()}
    typeset = latex.with_symbols(_typeset("".join(parts)), symbols)
    written = "\n".join(f"    {line}" for line in plain_equations(fit.chain))
    said = _with_equation(_CITED.sub(words, marked), f"\n\n{written}\n\n")
    typeset = _with_equation(typeset, f"\n{latex_equations(fit.chain)}\n")
    return MethodsText(said + "\n", f"{latex.PACKAGES}\n{typeset}\n", bibliography(keys), keys)


def _with_equation(text: str, equation: str) -> str:
    """Put the equation behind the paragraph that announces it, the first."""
    first, _, rest = text.partition("\n\n")
    return first + equation + rest


_FORM = r"$\psi\Theta_1 + \operatorname{sign}(\dot q)\,|\psi\Theta_2|$"


def _typeset(text: str) -> str:
    """Keep numbers and their units on one line, and set what has a symbol as one."""
    text = re.sub(r"(\d) (\\%|(?:Hz|dB|rad/s|m/s|ms|s|kg|m|N)\b)", r"\1\\,\2", text)
    text = text.replace(latex.escaped("psi Theta1 + sign(qd)|psi Theta2|"), _FORM)
    text = text.replace("\\,N m", r"\,N\,m").replace("R-hat", r"$\widehat{R}$")
    text = text.replace("(1 - 1/F)", "($1 - 1/F$)").replace("; q is the", "; $q$ is the")
    return _IN_MATH.sub(_in_math, text)


# A p-value with its sign, a number below zero, or one with a power of ten.
_IN_MATH = re.compile(
    r"(?:\bp (?:\\ensuremath\{)?(?P<sign>[=<>])\}? )?"
    r"(?<![\w.-])(?P<digits>-?\d+(?:\.\d+)?)(?:e(?P<power>[+-]\d+))?(?![\w-])"
)


def _in_math(found: re.Match[str]) -> str:
    if not (found["sign"] or found["power"] or found["digits"].startswith("-")):
        return found[0]
    p = f"p {found['sign']} " if found["sign"] else ""
    power = rf"\times 10^{{{int(found['power'])}}}" if found["power"] else ""
    return f"${p}{found['digits']}{power}$"


def _told(seen: Sequence[Observation], *keys: str) -> dict[tuple[str, ...], list[str]]:
    """Group names of recordings by settings that not all have."""
    found: dict[tuple[str, ...], list[str]] = {}
    for o in seen:
        if keys[0] in o.settings:
            # digits that a script wrote are no precision
            told = (
                re.sub(r"\d+\.\d{4,}", lambda m: f"{float(m[0]):.6g}", str(o.settings[key]))
                for key in keys
            )
            found.setdefault(tuple(told), []).append(o.name)
    return found


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

    def seconds_out(*by: str) -> float:
        return sum(one.length for o in seen for one in o.left_out if one.by in by)

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
        too_slow=too_slow,
        seconds_out=seconds_out,
        masses=list(dict.fromkeys(replace(i, recording="") for i in loaded)),
        carried=len(loaded),
        signals=_told(seen, "signal_unit", "signal_constant"),
        voltages=_told(seen, "motor_constant", "motor_resistance"),
        constants=[x for o in seen if (x := o.settings.get("torque_constant")) is not None],
        joint=joint,
        eq13=of_eq_13(fit.chain),
        by=counts([row for row in joint if row.cell.converged]),
        together=TOGETHER,
        correlated=correlation_warning(summary),
        biased=biased(summary),
        corrected=[n for n, row in summary.rows.items() if row.reported and row.reported.how.bias],
        seldom_held=seldom_held_sentence(summary, list(summary.rows)),
        rounded=text_rounded,
        python=platform.python_version(),
        bayesfric=__version__,
        versions={name: version(name) for name in _VERSIONS},
    )
    paragraphs = (" ".join(part.split()) for part in re.split(r"\n\s*\n", text))
    return "\n\n".join(part for part in paragraphs if part)
