"""Where templates of text and of pages are filled: a value that is missing is an error in all."""

from __future__ import annotations

from jinja2 import Environment, PackageLoader, StrictUndefined


def environment(package: str, folder: str = "templates", *, escaped: bool = False) -> Environment:
    """Give the environment of a package's templates; ``escaped`` for those that make HTML."""
    return Environment(
        loader=PackageLoader(package, folder),
        autoescape=escaped,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
