"""Numbers, units and words as LaTeX with siunitx writes them."""

from __future__ import annotations

import math
import re
from decimal import ROUND_HALF_EVEN, Decimal

from bayesfric.report.figures.style import mathtext

# Two digits of an uncertainty; a third tells nothing.
_DIGITS = 2
# Beyond these powers of ten a number is written with an exponent.
_PLAIN = (-3, 4)
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


def last_digit(uncertainty: float) -> int:
    """Power of ten of the last digit to print beside an uncertainty."""
    if not (math.isfinite(uncertainty) and uncertainty > 0.0):
        raise ValueError(f"{uncertainty} is no uncertainty")
    place = math.floor(math.log10(uncertainty)) - (_DIGITS - 1)
    # 0.0996 becomes 0.10: one digit less, or there would be three
    if round(uncertainty / 10.0**place) >= 10**_DIGITS:
        place += 1
    return place


def rounded(value: float, last: int) -> Decimal:
    """Round to a power of ten exactly as printed."""
    found = Decimal(repr(value)).quantize(Decimal(1).scaleb(last), rounding=ROUND_HALF_EVEN)
    # no -0.0
    return abs(found) if found.is_zero() else found


def shared_exponent(value: float, last: int) -> int:
    """Power of ten to take out of a number and everything printed beside it."""
    at = math.floor(math.log10(abs(value))) if value else last
    at = max(at, last)
    # digits that are not known must not be written as zeros
    return 0 if _PLAIN[0] <= at < _PLAIN[1] and last <= 0 else at


def digits(value: float, last: int, exponent: int) -> str:
    """Write a number's digits up to the last one, ``exponent`` taken out."""
    return f"{rounded(value, last).scaleb(-exponent):f}"


def number(value: float, last: int | None = None) -> str:
    r"""Write ``\num{...}``; to four digits where no last one is given."""
    if last is None:
        last = math.floor(math.log10(abs(value))) - 3 if value else 0
        # an exact number loses the zeros behind it
        short = f"{float(f'{value:.4g}'):.4g}"
        return rf"\num{{{short}}}"
    exponent = shared_exponent(value, last)
    return rf"\num{{{digits(value, last, exponent)}{_power(exponent)}}}"


def with_sd(value: float, sd: float) -> str:
    r"""Write ``\num{4.618(36)e-4}``: the uncertainty in units of the last digits."""
    last = last_digit(sd)
    exponent = shared_exponent(value, last)
    own = int(rounded(sd, last).scaleb(-last))
    # the uncertainty in parentheses counts last digits; above the point it is written out
    shown = digits(value, last, exponent)
    said = own if "." in shown or last == exponent else digits(sd, last, exponent)
    return rf"\num{{{shown}({said}){_power(exponent)}}}"


def with_ends(value: float, low: float, high: float, sd: float) -> str:
    """Write a value with its distances to both ends of an interval, for a skewed posterior."""
    last = last_digit(sd)
    exponent = shared_exponent(value, last)
    up, down = (
        rounded(high, last) - rounded(value, last),
        rounded(value, last) - rounded(low, last),
    )
    middle = rf"\num{{{digits(value, last, exponent)}}}"
    above, below = (f"{x.scaleb(-exponent):f}" for x in (up, down))
    ends = rf"^{{+\num{{{above}}}}}_{{-\num{{{below}}}}}"
    if not exponent:
        return f"${middle}{ends}$"
    return rf"$({middle}{ends})\times 10^{{{exponent}}}$"


def interval(low: float, high: float, sd: float) -> str:
    """Write both ends to the digit that the sd sets."""
    last = last_digit(sd)
    exponent = shared_exponent(max(abs(low), abs(high)), last)
    # \num groups digits as it does in the value beside it
    ends = ", ".join(rf"\num{{{digits(end, last, exponent)}}}" for end in (low, high))
    return f"$[{ends}]$" if not exponent else rf"$[{ends}]\times 10^{{{exponent}}}$"


def _power(exponent: int) -> str:
    return f"e{exponent}" if exponent else ""
