"""Templates of text and of pages; a missing value is an error."""

from __future__ import annotations

import math

from jinja2 import Environment, PackageLoader, StrictUndefined


def environment(package: str, folder: str = "templates", *, escaped: bool = False) -> Environment:
    """Load a package's templates; ``escaped`` for those that make HTML."""
    templates = Environment(
        loader=PackageLoader(package, folder),
        autoescape=escaped,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    functions = (capital, factor, percent, placed, two)
    templates.filters |= {function.__name__: function for function in functions}
    return templates


def percent(share: float) -> str:
    """Write a share as per cent, without the sign: two digits, and never ``1e+02``."""
    return two(100.0 * share)


def two(x: float) -> str:
    """Write two digits, more of what is a hundred or larger: never ``1e+02``."""
    return f"{x:.2g}" if abs(x) < 99.5 else f"{x:.0f}"


def capital(words: object) -> str:
    """Begin a sentence; names of parameters stay as they are written."""
    text = str(words)
    first = text.split(" ", 1)[0].rstrip(",")
    return text if "." in first or "_" in first else text[:1].upper() + text[1:]


def factor(log_sd: float) -> str:
    """Write a change of a logarithm as a factor."""
    if log_sd > math.log(1000.0):
        return "more than 1000"
    return f"{math.exp(log_sd):.2g}" if log_sd > -math.log(1000.0) else "less than 0.001"


def placed(setting: str) -> tuple[str, str]:
    """Split a dotted setting, ``a.b.key = value``, into its table and the line to write there."""
    table = setting.partition(" = ")[0].rpartition(".")[0]
    return table, setting.removeprefix(f"{table}.")
