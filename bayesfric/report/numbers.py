r"""How numbers are written, as plain text, in LaTeX (siunitx 3) and in HTML.

An uncertainty has two digits, and sets the last digit of its value and interval; of a skewed
posterior the nearer end of its interval does (:func:`finer`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import ROUND_HALF_EVEN, Decimal

from markupsafe import Markup, escape

# Digits of an uncertainty; a third says nothing.
_DIGITS = 2
# Of the distance to the farther end of an interval; finer than that a nearer one sets no digits.
_FINEST = 1e-3
# Beyond these powers of ten a number is written with an exponent.
_PLAIN = (-3, 4)


def last_digit(uncertainty: float) -> int:
    """Power of ten of the last digit to print, by an uncertainty."""
    if not (math.isfinite(uncertainty) and uncertainty > 0.0):
        raise ValueError(f"{uncertainty} is no uncertainty")
    place = math.floor(math.log10(uncertainty)) - (_DIGITS - 1)
    # 0.0996 becomes 0.10: one digit less, or there would be three
    if round(uncertainty / 10.0**place) >= 10**_DIGITS:
        place += 1
    return place


def finer(middle: float, low: float, high: float, sd: float) -> float:
    """Give what to round by: the sd, or if less the distance to the nearer end of the interval.

    A long tail makes the sd larger than the distance to the end on the other side.
    """
    near, far = sorted((abs(middle - low), abs(high - middle)))
    return min(sd, max(near, _FINEST * far)) or sd


def _aligned(
    sd: float, values: Sequence[float], others: Sequence[float] = ()
) -> tuple[list[Decimal], int]:
    """Round ``values`` and ``others`` to the last digit that an sd sets.

    Over a shared power of ten, set by ``values``, which is returned too.
    """
    last = last_digit(sd)
    largest = max(map(abs, values))
    at = max(math.floor(math.log10(largest)), last) if largest else last
    # digits that are not known must not be written as zeros
    exponent = 0 if last <= 0 and _PLAIN[0] <= at < _PLAIN[1] else at
    unit = Decimal(1).scaleb(last)
    rounded = [Decimal(repr(x)).quantize(unit, ROUND_HALF_EVEN) for x in (*values, *others)]
    # 0.0 has no sign
    return [(x if x else abs(x)).scaleb(-exponent) for x in rounded], exponent


def _with_ends(
    value: float, low: float, high: float, sd: float
) -> tuple[Decimal, Decimal, Decimal, int]:
    """Digits of a value and of its distances up and down, and the exponent."""
    (middle, _, up, down), exponent = _aligned(sd, (value, sd), (high, low))
    return middle, up - middle, middle - down, exponent


# Media write an exact `number`; a `value` with its sd, or for a skewed posterior with its distances
# to the `ends` of an interval; and an `interval`: an uncertainty sets the last digit of all.
# `limits` are the signs of an upper and a lower limit, `none` is for no number, and `sds` is
# whether tables have sds in addition to intervals.


class _Text:
    limits, none, sds = ("≤ ", "≥ "), "–", False

    def number(self, value: float, digits: int = 4) -> str:
        return f"{value:.{digits}g}"

    def value(self, value: float, sd: float) -> str:
        return f"{text_rounded(value, sd)} ± {text_rounded(sd, sd)}"

    def ends(self, value: float, low: float, high: float, sd: float) -> str:  # noqa: ARG002
        return text_rounded(value, sd)

    def interval(self, low: float, high: float, sd: float) -> str:
        return f"[{text_rounded(low, sd)}, {text_rounded(high, sd)}]"


def text_rounded(value: float, sd: float | None) -> str:
    """Print a value to the last digit that a standard deviation sets, exponent and all."""
    if not sd:
        return f"{value:.5g}"
    (digits,), exponent = _aligned(sd, (value,))
    return f"{digits:f}{_power(exponent)}" if digits else "0"


def p_text(p_value: float) -> str:
    """Write a p-value; one too small for a floating-point number is not zero."""
    return f"p = {p_value:.2g}" if p_value > 0.0 else "p < 1e-300"


def spaced(x: float) -> str:
    """Write a whole number with narrow spaces between thousands."""
    return f"{x:,.0f}".replace(",", "\u202f")


def _power(exponent: int) -> str:
    return f"e{exponent}" if exponent else ""


class _Latex:
    limits, none, sds = (r"$\leq$ ", r"$\geq$ "), "---", False

    def number(self, value: float, digits: int = 4) -> str:
        return rf"\num{{{value:.{min(digits, 4)}g}}}"

    def value(self, value: float, sd: float) -> str:
        (middle, error), exponent = _aligned(sd, (value, sd))
        # the uncertainty in parentheses counts last digits
        digits = "".join(map(str, error.as_tuple().digits))
        return rf"\num{{{middle:f}({digits}){_power(exponent)}}}"

    def ends(self, value: float, low: float, high: float, sd: float) -> str:
        middle, above, below, exponent = _with_ends(value, low, high, sd)
        text = rf"\num{{{middle:f}}}^{{+\num{{{above:f}}}}}_{{-\num{{{below:f}}}}}"
        return f"${text}$" if not exponent else rf"$({text})\times 10^{{{exponent}}}$"

    def interval(self, low: float, high: float, sd: float) -> str:
        ends, exponent = _aligned(sd, (low, high))
        # \num groups digits as in the value
        text = ", ".join(rf"\num{{{end:f}}}" for end in ends)
        return f"$[{text}]$" if not exponent else rf"$[{text}]\times 10^{{{exponent}}}$"


class _Html:
    limits: tuple[str, str] = (Markup("≤\u00a0"), Markup("≥\u00a0"))
    none: str = Markup("–")
    sds = True

    def number(self, value: float, digits: int = 4) -> Markup:
        return html_number(f"{value:.{digits}g}")

    def value(self, value: float, sd: float) -> Markup:
        pair, exponent = _aligned(sd, (value, sd))
        return _scaled(Markup("{} ± {}").format(*map(_signed, pair)), exponent)

    def ends(self, value: float, low: float, high: float, sd: float) -> Markup:
        middle, above, below, exponent = _with_ends(value, low, high, sd)
        ends = Markup('{} <span class="ends"><sup>+{}</sup><sub>\u2212{}</sub></span>')
        return _scaled(ends.format(*map(_signed, (middle, above, below))), exponent)

    def interval(self, low: float, high: float, sd: float) -> Markup:
        pair, exponent = _aligned(sd, (low, high))
        text = Markup("[{}, {}]").format(*map(_signed, pair))
        return _scaled(text, exponent, brackets=False)


Medium = _Text | _Latex | _Html
TEXT, LATEX, HTML = _Text(), _Latex(), _Html()


def html_number(text: str) -> Markup:
    """Write a number such as ``-1.2e-05`` with a minus sign and a power of ten."""
    digits, _, power = text.partition("e")
    return _scaled(escape(_signed(Decimal(digits))), int(power or 0), brackets=False)


def html_unit(unit: str) -> Markup:
    """Keep a unit on one line; a dash where there is none."""
    return escape(unit.replace(" ", "\u00a0") or "–")


def html_p(p_value: float) -> Markup:
    """Write the sign and the number of a p-value."""
    _, sign, number = p_text(p_value).split()
    return Markup("{} {}").format(sign, html_number(number))


def _signed(number: Decimal) -> str:
    return f"{number:f}".replace("-", "\u2212")


def _scaled(text: Markup, exponent: int, *, brackets: bool = True) -> Markup:
    if not exponent:
        return text
    power = Markup("\u00a0×\u00a010<sup>{}</sup>").format(_signed(Decimal(exponent)))
    return (Markup("({})").format(text) if brackets else text) + power
