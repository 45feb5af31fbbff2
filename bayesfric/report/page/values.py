"""Numbers as a page shows them: digits set by the uncertainty, never a bare open interval."""

from __future__ import annotations

from markupsafe import Markup, escape

from bayesfric.report.comparison.cell import DOUBTFUL, NOT_CONVERGED, TOGETHER, Cell
from bayesfric.report.paper import latex
from bayesfric.report.paper.tables import ParameterRow
from bayesfric.report.summary.noise import p_parts

NOT_DETERMINED = "not determined by the data"
_VERDICTS = {
    "determined data": "data",
    "determined weak": TOGETHER,
    "determined prior": TOGETHER,
    "limit": "data, prior and bounds, on one side only",
    "undetermined": NOT_DETERMINED,
    "known": "taken as known",
}


def verdict_words(row: ParameterRow) -> str:
    """Say what determined a number, in words that stand in its line."""
    if not row.cell.converged:
        return NOT_CONVERGED
    status: str = row.cell.status
    if status == "determined" and row.row is not None:
        if row.row.doubted:
            return DOUBTFUL
        status += f" {row.row.verdict}"
    return _VERDICTS[status]


def verdict_kind(row: ParameterRow) -> str:
    """Sort verdicts from ``data`` to ``open``."""
    if row.cell.status == "determined" and row.row is not None:
        return "data" if row.row.verdict == "data" else "weak"
    return {"limit": "limit", "undetermined": "open"}.get(row.cell.status, "known")


def value_html(row: ParameterRow) -> Markup:
    """Write a number with its standard deviation, or what may be said of it instead."""
    if row.row is None:
        return plain(f"{row.cell.value:.5g}")
    if row.cell.status == "limit":
        sign = "≤" if row.row.at_bound == "lower" else "≥"
        return Markup("{}\u00a0{}").format(sign, plain(f"{row.cell.limit:.3g}"))
    if row.cell.status == "undetermined":
        words = "not determined" if row.cell.converged else "not converged"
        return Markup('<span class="open">{}</span>').format(words)
    if row.row.median is None or not row.row.sd:
        return plain(f"{row.row.mean:.5g}")
    middle, sd = row.row.median, row.row.sd
    if row.skewed:
        last = latex.last_digit(sd)
        exponent = latex.shared_exponent(middle, last)
        shown = _signed(latex.digits(middle, last, exponent))
        low, high = row.row.interval
        up = latex.rounded(high, last) - latex.rounded(middle, last)
        down = latex.rounded(middle, last) - latex.rounded(low, last)
        ends = Markup('<span class="ends"><sup>+{}</sup><sub>\u2212{}</sub></span>').format(
            f"{up.scaleb(-exponent):f}", f"{down.scaleb(-exponent):f}"
        )
        return _scaled(Markup("{} {}").format(shown, ends), exponent)
    return number_html(middle, sd)


def number_html(value: float, sd: float) -> Markup:
    """Write a value to the second digit of its standard deviation, and that with two."""
    last = latex.last_digit(sd)
    exponent = latex.shared_exponent(value, last)
    shown = _signed(latex.digits(value, last, exponent))
    return _scaled(Markup("{} ± {}").format(shown, latex.digits(sd, last, exponent)), exponent)


def interval_html(row: ParameterRow) -> Markup:
    """Write an interval; of an open number in words that say so."""
    if row.row is None or row.cell.status == "limit":
        return Markup("–")
    if not row.cell.converged:
        return Markup('<span class="open">none: the ensembles disagree, or stand still</span>')
    low, high = row.row.interval
    if row.cell.status == "undetermined":
        return Markup('<span class="open">prior and bounds leave {} to {}</span>').format(
            plain(f"{low:.3g}"), plain(f"{high:.3g}")
        )
    if not row.row.sd:
        return Markup("–")
    return ends_html(low, high, row.row.sd)


def ends_html(low: float, high: float, sd: float) -> Markup:
    """Write both ends of an interval to the digit that the standard deviation sets."""
    last = latex.last_digit(sd)
    exponent = latex.shared_exponent(max(abs(low), abs(high)), last)
    shown = [_signed(latex.digits(end, last, exponent)) for end in (low, high)]
    return _scaled(Markup("[{}, {}]").format(*shown), exponent, brackets=False)


def cell_html(cell: Cell | None) -> Markup:
    """Write one cell of a comparison; an open one in words only."""
    if cell is None:
        return Markup('<span class="quiet">–</span>')
    lines: list[Markup] = []
    if cell.status not in ("undetermined", "limit"):
        plain_sd = cell.status == "determined" and not cell.accounts and cell.sd
        mark = Markup('<sup class="mark">†</sup>') if plain_sd else Markup()
        shown = number_html(cell.value, cell.sd) if cell.sd else plain(f"{cell.value:.5g}")
        lines.append(shown + mark)
    if cell.interval is not None and cell.sd:
        lines.append(ends_html(*cell.interval, cell.sd))
    if cell.disagreement is not None:
        away = f"{round(cell.disagreement, 1) + 0.0:+.1f}"
        lines.append(Markup('<span class="quiet">{} sd away</span>').format(_signed(away)))
    if cell.remark:
        kind = "open" if cell.status == "undetermined" else "quiet"
        lines.append(Markup('<span class="{}">{}</span>').format(kind, cell.remark))
    return Markup("<br>").join(lines)


def plain(text: str) -> Markup:
    """Set a number such as ``-1.2e-05`` with a minus sign and a power of ten."""
    digits, _, power = text.partition("e")
    if not power:
        return escape(_signed(digits))
    return _scaled(escape(_signed(digits)), int(power), brackets=False)


def unit_html(unit: str) -> Markup:
    """Keep a unit on one line; a dash where there is none."""
    return escape(unit.replace(" ", "\u00a0") or "–")


def _signed(text: str) -> str:
    return text.replace("-", "\u2212")


def _scaled(shown: Markup, exponent: int, *, brackets: bool = True) -> Markup:
    if not exponent:
        return shown
    power = Markup("\u00a0×\u00a010<sup>{}</sup>").format(_signed(str(exponent)))
    return (Markup("({})").format(shown) if brackets else shown) + power


def p_html(p_value: float) -> Markup:
    """Write a p-value with its sign; one too small for a floating-point number is not zero."""
    sign, number = p_parts(p_value)
    return Markup("{} {}").format(sign, plain(number))
