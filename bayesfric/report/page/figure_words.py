"""Figures of a page: title, caption, and the numbers they show in words for who cannot see them.

A number that the data leave open is named as such, without its interval.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from markupsafe import Markup

from bayesfric.report.comparison.cell import TOGETHER
from bayesfric.report.comparison.comparison import Comparison
from bayesfric.report.figures.captions import FIXED
from bayesfric.report.figures.overlay import Curve, Overlay
from bayesfric.report.numbers import p_text
from bayesfric.report.page.values import interval_html, value_html, verdict_words
from bayesfric.report.paper.tables import ParameterRow, ParameterTable
from bayesfric.report.summary.record import Summary
from bayesfric.report.text_templates import white_words

_CAPTION = re.compile(r"^\*\*(\w+)\*\*: (.+)$", re.MULTILINE)
_RAISED = str.maketrans("0123456789-\u2212", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁻")


@dataclass(frozen=True)
class Told:
    """What words may draw on."""

    facts: Summary
    table: ParameterTable
    methods: Comparison


@dataclass(frozen=True)
class FigureWords:
    """Title, caption and text alternative of one figure."""

    title: str
    caption: str
    alternative: str


def written_captions(markdown: str) -> dict[str, str]:
    """Read the captions of ``text/captions.md`` back, by figure."""
    return dict(_CAPTION.findall(markdown))


def figure_words(stem: str, told: Told, captions: Mapping[str, str]) -> FigureWords:
    """Word one figure of a run.

    Parameters
    ----------
    stem
        Its file's name.
    told
        Of the run.
    captions
        From :func:`written_captions`; they come first.
    """
    title, alternative = STEMS_IN_WORDS.get(stem, (stem, lambda _: ""))
    # older runs wrote only some captions down
    caption = captions.get(stem, FIXED.get(stem, ""))
    return FigureWords(title, caption, f"{title}. {alternative(told)}".strip())


def in_words(row: ParameterRow) -> str:
    """Say one number without markup, with its verdict."""
    name = f"{row.name}"
    if row.cell.status == "undetermined":
        return f"{name}: {verdict_words(row)}"
    value = text_of(value_html(row))
    ends = text_of(interval_html(row)) if row.cell.status == "determined" else ""
    unit = f" {row.unit}" if row.unit else ""
    said = f"{name}: {value}{f', interval {ends}' if ends and ends != '–' else ''}{unit}"
    return f"{said}, determined by {verdict_words(row)}" if row.row is not None else said


def text_of(markup: Markup) -> str:
    """Take the markup off; a raised number stays raised."""
    raised = re.sub(
        r"×\u00a010<sup>([^<]*)</sup>", lambda m: "×\u00a010" + m[1].translate(_RAISED), markup
    )
    return Markup(re.sub(r"<[^>]*>", "", raised)).unescape()


def _parameters(told: Told, groups: tuple[str, ...]) -> str:
    return "; ".join(in_words(r) for r in told.table.rows if r.group in groups) + "."


def _corner(told: Told) -> str:
    return _parameters(told, ("free", "parameter"))


def _prior_posterior(told: Told) -> str:
    parts = []
    for row in told.table.rows:
        facts = told.facts.parameters.get(row.name)
        if facts is None or not facts.prior_sd or not facts.sd:
            continue
        ratio = f"posterior 1:{facts.prior_sd / facts.sd:.3g} as wide as its prior"
        parts.append(f"{row.name}: {ratio}, determined by {verdict_words(row)}")
    return "; ".join(parts).replace("determined by not determined", "not determined") + "."


def _prediction(told: Told) -> str:
    fit = told.facts.fit
    said = f"Measured {fit.quantity} with predictive mean and 90 % band, and residuals below"
    if fit.residual_rms is not None:
        said += f"; residual rms {fit.residual_rms:.4g} {fit.unit}"
    each = [
        f"{name}: {row.outputs} outputs, rms {row.residual_rms:.4g} {fit.unit}"
        for name, row in fit.recordings.items()
        if row.outputs is not None and row.residual_rms is not None
    ]
    return ". ".join([said, *each]) + "."


def _residual(told: Told) -> str:
    noise = told.facts.noise
    parts = [_prediction(told)]
    if noise.residual_lag1 is not None:
        parts.append(f"Lag-1 autocorrelation of the residuals: {noise.residual_lag1:.2f}.")
    test = noise.innovation_whiteness
    if test is not None and test.p_value is not None:
        parts.append(f"Innovations {white_words(test.white)} ({p_text(test.p_value)}).")
    return " ".join(parts)


def _validation(told: Told) -> str:
    found = told.facts.validation
    if found is None:
        return ""
    parts = []
    for name, row in {**found.parts, "all together": found.pooled}.items():
        shares = ", ".join(
            f"{100 * c.share:.1f} % in {100 * float(level):g} % intervals"
            for level, c in row.coverage.items()
        )
        parts.append(f"{name}: {row.verdict}, {row.outputs} outputs, {shares}")
    return "; ".join(parts) + "."


def _ridge(told: Told) -> str:
    meanings = [one.meaning for one in told.facts.identifiability.null_directions]
    if not meanings:
        return "The data hold the scale between gearbox and leg; no null direction is left."
    open_ = [
        r.name for r in told.table.rows if r.cell.status == "undetermined" and r.cell.converged
    ]
    if not open_:
        return f"Null directions: {'; '.join(meanings)}."
    return (
        f"Null directions: {'; '.join(meanings)}. Not determined by the data: {', '.join(open_)}."
    )


def _trace(told: Told) -> str:
    each = [
        f"{name}: R-hat {row.rhat:.4f}, {row.ess:.0f} independent draws"
        for name, row in told.facts.parameters.items()
        if row.rhat is not None and row.ess is not None
    ]
    return f"Status {told.facts.sampler.status}. " + "; ".join(each) + "."


def _friction(told: Told) -> str:
    words = ("coulomb", "viscous", "load_", "quadratic", "stribeck", ".load")
    rows = [r for r in told.table.rows if any(w in r.name for w in words) and r.group != "derived"]
    return "Losses that the curves follow from: " + "; ".join(map(in_words, rows)) + "."


def _efficiency(told: Told) -> str:
    rows = [r for r in told.table.rows if "efficiency" in r.name or ".alpha_" in r.name]
    return ("; ".join(map(in_words, rows)) or "See the table of derived quantities") + "."


def _methods(told: Told) -> str:
    return forest_words(told.methods)


def forest_words(found: Comparison) -> str:
    """Say what a forest figure shows: every quantity by every column, open ones as open."""
    parts = []
    for row in found.rows:
        cells = []
        for label, cell in row.cells.items():
            if cell.status == "undetermined":
                cells.append(f"{label} {'not determined' if cell.converged else cell.remark}")
            elif cell.status == "limit":
                cells.append(f"{label} {cell.remark}")
            else:
                sd = f" ± {cell.sd:.2g}" if cell.sd else ""
                cells.append(f"{label} {cell.value:.5g}{sd}")
        parts.append(f"{row.name}{f' in {row.unit}' if row.unit else ''}: {', '.join(cells)}")
    return "; ".join(parts) + "."


def forest_figure_words(found: Comparison) -> FigureWords:
    """Word the forest figure of a comparison."""
    title = "Every quantity by every run and method"
    return FigureWords(title, FIXED["forest"], f"Forest plot. {forest_words(found)}")


def overlay_words(shown: Overlay) -> FigureWords:
    """Word the overlaid posteriors of a comparison; what is open has no numbers."""
    title = "Posteriors of the runs, overlaid"
    caption = FIXED["overlay"]
    if shown.without_draws:
        names = ", ".join(shown.without_draws)
        caption += f" In the table only, for no draws of them are kept: {names}."
    for run, why in shown.left_out.items():
        caption += f" Not shown: {run}, which {why}."
    said = []
    for panel in shown.panels:
        unit = f" in {panel.row.unit}" if panel.row.unit else ""
        each = ", ".join(map(_curve, panel.curves))
        agree = {None: "", True: "; they agree", False: "; they differ"}[panel.agree]
        said.append(f"{panel.row.name}{unit}: {each}{agree}")
    return FigureWords(title, caption, f"{title}. {'. '.join(said)}.")


def _curve(curve: Curve) -> str:
    if curve.told == "open":
        return f"{curve.run} not determined by the data"
    if curve.cell.status == "limit":
        return f"{curve.run} {curve.cell.remark}, as far as the data tell"
    middle = curve.row.middle
    low, high = curve.row.interval
    by = "the data" if curve.told == "data" else TOGETHER
    share = f"{100 * curve.row.level:g} %"
    return f"{curve.run} {middle:.4g}, {share} from {low:.4g} to {high:.4g}, determined by {by}"


STEMS_IN_WORDS: dict[str, tuple[str, Callable[[Told], str]]] = {
    "methods": ("Estimates and posterior side by side", _methods),
    "ridge": ("The ridge: what can be scaled together without changing any torque", _ridge),
    "prediction": ("Measured and predicted", _prediction),
    "residual": ("What is left unexplained", _residual),
    "validation": ("What was held out, predicted", _validation),
    "friction": ("Friction of the joint", _friction),
    "efficiency": ("Efficiency against load", _efficiency),
    "prior_posterior": ("Prior and posterior", _prior_posterior),
    "corner": ("Marginal and pairwise posteriors", _corner),
    "trace": ("How the ensembles ran", _trace),
}
