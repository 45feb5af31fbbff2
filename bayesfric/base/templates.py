"""Where templates of text and of pages are filled: a value that is missing is an error in all."""

from __future__ import annotations

from jinja2 import Environment, PackageLoader, StrictUndefined


def environment(package: str, folder: str = "templates", *, escaped: bool = False) -> Environment:
    """Give the environment of a package's templates; ``escaped`` for those that make HTML."""
    made = Environment(
        loader=PackageLoader(package, folder),
        autoescape=escaped,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {"placed": placed, "percent": percent, "two": two}
    return made


def percent(share: float) -> str:
    """Write a share as per cent, without the sign: two digits, and never ``1e+02``."""
    return two(100.0 * share)


def two(x: float) -> str:
    """Write two digits, more of what is a hundred or larger: never ``1e+02``."""
    return f"{x:.2g}" if abs(x) < 99.5 else f"{x:.0f}"


def placed(setting: str) -> tuple[str, str]:
    """Part a dotted setting, ``a.b.key = value``, into its table and the line to write there.

    As one line it would go into whatever table a file has open.
    """
    table = setting.partition(" = ")[0].rpartition(".")[0]
    return table, setting.removeprefix(f"{table}.")
