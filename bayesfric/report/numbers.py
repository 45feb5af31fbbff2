r"""How numbers are written, as plain text, in LaTeX (siunitx 3) and in HTML.

An uncertainty has two digits, and sets the last digit of its value and interval; of a skewed
posterior the nearer end of its interval does (:func:`finer`).
"""

from __future__ import annotations

import math

from markupsafe import Markup


def last_digit(uncertainty: float) -> int:
    """Power of ten of the second digit of an uncertainty: a third says nothing."""
    place = math.floor(math.log10(uncertainty)) - 1
    # 0.0996 becomes 0.10: one digit less, or there would be three
    return place + (round(uncertainty / 10.0**place) >= 100)


def finer(middle: float, low: float, high: float, sd: float) -> float:
    """Give what to round by: the sd, or if less the distance to the nearer end of the interval.

    A long tail makes the sd larger than the distance to the end on the other side. A thousandth of
    the farther distance is the least.
    """
    near, far = sorted((abs(middle - low), abs(high - middle)))
    return min(sd, max(near, 1e-3 * far)) or sd


def _rounded(sd: float, *values: float, others: int = 0) -> tuple[list[str], list[float], int]:
    """Round to the last digit that an sd sets: digits, numbers, and their power of ten.

    The last ``others`` of the values have no say in the power of ten.
    """
    last = last_digit(sd)
    largest = max(map(abs, values[: len(values) - others]))
    at = max(math.floor(math.log10(largest)), last) if largest else last
    # an exponent beyond these powers; digits that are not known must not be written as zeros
    exponent = 0 if last <= 0 and -3 <= at < 4 else at
    decimals = exponent - last
    # 0.0 has no sign
    numbers = [round(x / 10.0**exponent, decimals) + 0.0 for x in values]
    return [f"{x:.{decimals}f}" for x in numbers], numbers, exponent


def _with_ends(value: float, low: float, high: float, sd: float) -> tuple[list[str], int]:
    """Digits of a value and of its distances up and down, and the exponent."""
    digits, (middle, _, up, down), exponent = _rounded(sd, value, sd, high, low, others=2)
    decimals = len(digits[0].partition(".")[2])
    ends = [f"{distance:.{decimals}f}" for distance in (up - middle, middle - down)]
    return [digits[0], *ends], exponent


def text_rounded(value: float, sd: float | None) -> str:
    """Print a value to the last digit that a standard deviation sets, exponent and all."""
    if not sd:
        return f"{value:.5g}"
    (digits,), (number,), exponent = _rounded(sd, value)
    return digits + (f"e{exponent}" if exponent else "") if number else "0"


def p_text(p_value: float | None) -> str:
    """Write a p-value; one too small for a floating-point number is not zero."""
    return f"p = {p_value:.2g}" if p_value else "p < 1e-300"


class Medium:
    """Numbers as plain text; a skewed posterior has the distances to the ends of its interval."""

    limits: tuple[str, str] = ("≤ ", "≥ ")  # signs of an upper and a lower limit
    none: str = "–"  # for no number
    sds = False  # whether tables have sds in addition to intervals

    def number(self, value: float, digits: int = 4) -> str:
        """Write an exact number."""
        return f"{value:.{digits}g}"

    def value(self, value: float, sd: float) -> str:
        """Write a value with its sd."""
        return f"{text_rounded(value, sd)} ± {text_rounded(sd, sd)}"

    def ends(self, value: float, low: float, high: float, sd: float) -> str:  # noqa: ARG002
        """Write a value with the distances to the ends of an interval, where there is room."""
        return text_rounded(value, sd)

    def interval(self, low: float, high: float, sd: float) -> str:
        """Write an interval."""
        return f"[{text_rounded(low, sd)}, {text_rounded(high, sd)}]"


class _Latex(Medium):
    limits, none = (r"$\leq$ ", r"$\geq$ "), "---"

    def number(self, value: float, digits: int = 4) -> str:
        return rf"\num{{{value:.{min(digits, 4)}g}}}"

    def value(self, value: float, sd: float) -> str:
        (middle, error), _, exponent = _rounded(sd, value, sd)
        # the uncertainty in parentheses counts last digits
        last = error.replace(".", "").lstrip("0")
        return rf"\num{{{middle}({last}){f'e{exponent}' if exponent else ''}}}"

    def ends(self, value: float, low: float, high: float, sd: float) -> str:
        (middle, up, down), exponent = _with_ends(value, low, high, sd)
        text = rf"\num{{{middle}}}^{{+\num{{{up}}}}}_{{-\num{{{down}}}}}"
        return f"${text}$" if not exponent else rf"$({text})\times 10^{{{exponent}}}$"

    def interval(self, low: float, high: float, sd: float) -> str:
        ends, _, exponent = _rounded(sd, low, high)
        # \num groups digits as in the value
        text = ", ".join(rf"\num{{{end}}}" for end in ends)
        return f"$[{text}]$" if not exponent else rf"$[{text}]\times 10^{{{exponent}}}$"


class _Html(Medium):
    limits, none, sds = (Markup("≤\u00a0"), Markup("≥\u00a0")), Markup("–"), True

    def number(self, value: float, digits: int = 4) -> Markup:
        text, _, power = f"{value:.{digits}g}".partition("e")
        return _scaled(text, int(power or 0))

    def value(self, value: float, sd: float) -> Markup:
        pair, _, exponent = _rounded(sd, value, sd)
        return _scaled(" ± ".join(pair), exponent, "({})")

    def ends(self, value: float, low: float, high: float, sd: float) -> Markup:
        (middle, up, down), exponent = _with_ends(value, low, high, sd)
        ends = f'<span class="ends"><sup>+{up}</sup><sub>-{down}</sub></span>'
        return _scaled(f"{middle} {ends}", exponent, "({})")

    def interval(self, low: float, high: float, sd: float) -> Markup:
        ends, _, exponent = _rounded(sd, low, high)
        return _scaled(f"[{', '.join(ends)}]", exponent)


def _scaled(text: str, exponent: int, brackets: str = "{}") -> Markup:
    """Write digits with minus signs and a power of ten as HTML."""
    if exponent:
        text = f"{brackets.format(text)}\u00a0×\u00a010<sup>{exponent}</sup>"
    return Markup(text.replace("-", "\u2212"))


TEXT, LATEX, HTML = Medium(), _Latex(), _Html()
