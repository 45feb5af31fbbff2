"""Read the LaTeX that the tables write back into numbers."""

import re
from decimal import Decimal


def num(text):
    r"""Value and uncertainty of ``\num{1.23(45)e-6}``, and the weight of its last digit."""
    match = re.fullmatch(r"\\num\{(-?[\d.]+)(?:\(([\d.]+)\))?(?:e(-?\d+))?\}", text)
    assert match, text
    shown, uncertainty, exponent = match.groups()
    power = Decimal(10) ** int(exponent or 0)
    decimals = len(shown.partition(".")[2])
    last = Decimal(1).scaleb(-decimals) * power
    value = Decimal(shown) * power
    if uncertainty is None:
        return float(value), None, float(last)
    if "." in uncertainty or not decimals:
        return float(value), float(Decimal(uncertainty) * power), float(last)
    return float(value), float(int(uncertainty) * last), float(last)


def ends(text):
    text = re.sub(r"\\num\{(-?[\d.]+)\}", r"\1", text)
    match = re.fullmatch(r"\$\[(-?[\d.]+), (-?[\d.]+)\](?:\\times 10\^\{(-?\d+)\})?\$", text)
    assert match, text
    power = 10.0 ** int(match[3] or 0)
    decimals = len(match[1].partition(".")[2])
    return float(match[1]) * power, float(match[2]) * power, power * 10.0**-decimals


def skewed(text):
    text = re.sub(r"\\num\{(-?[\d.]+)\}", r"\1", text)
    match = re.fullmatch(
        r"\$\(?(-?[\d.]+)\^\{\+([\d.]+)\}_\{-([\d.]+)\}\)?(?:\\times 10\^\{(-?\d+)\})?\$", text
    )
    assert match, text
    power = 10.0 ** int(match[4] or 0)
    decimals = len(match[1].partition(".")[2])
    return (*(float(match[k]) * power for k in (1, 2, 3)), power * 10.0**-decimals)


def lines(table):
    """Cells of every line of a LaTeX table."""
    body = table.partition(r"\midrule")[2].partition(r"\bottomrule")[0]
    return [
        [cell.strip() for cell in line.removesuffix(r" \\").split(" & ")]
        for line in body.splitlines()
        if line.endswith(r" \\") and not line.startswith(r"\multicolumn")
    ]
