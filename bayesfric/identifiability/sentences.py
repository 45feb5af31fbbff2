"""What was found is a kind and its values; ``wording/`` words it, once."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from jinja2 import Environment

from bayesfric.base.templates import environment


@dataclass(frozen=True)
class Statement:
    """Something found."""

    topic: str  # table of wording/sentences.toml
    kind: str  # key there
    values: Mapping[str, Any]  # what its template is filled with

    def __str__(self) -> str:
        """Word it."""
        return str(_sentences()[self.topic, self.kind].render(self.values))


def stated(topic: str, kind: str, **values: Any) -> Statement:
    """Make a :class:`Statement`."""
    return Statement(topic, kind, values)


def page(name: str, **values: Any) -> list[str]:
    """Fill a template of ``wording/`` for a terminal, line by line."""
    return _environment().get_template(name).render(values).splitlines()


def plain(found: Any) -> Any:
    """Turn what was found into what JSON can hold: statements worded, infinities ``None``."""
    if isinstance(found, Statement):
        return str(found)
    if is_dataclass(found):
        return {f.name: plain(getattr(found, f.name)) for f in fields(found)}
    if isinstance(found, Mapping):
        return {name: plain(x) for name, x in found.items()}
    if isinstance(found, list | tuple):
        return [plain(x) for x in found]
    if isinstance(found, np.ndarray | np.generic):
        return plain(found.tolist())
    return None if isinstance(found, float) and not np.isfinite(found) else found


def factor(log_sd: float) -> str:
    """Word a change of a logarithm as a factor."""
    if log_sd > np.log(1000.0):
        return "more than 1000"
    return f"{np.exp(log_sd):.2g}" if log_sd > -np.log(1000.0) else "less than 0.001"


def capital(said: object) -> str:
    """Begin a sentence; names of parameters stay as they are written."""
    text = str(said)
    first = text.split(" ", 1)[0].rstrip(",")
    return text if "." in first or "_" in first else text[:1].upper() + text[1:]


def relative(sd: float, value: float) -> str:
    """Give a sd as a share of its value; as a number where it is larger than that."""
    if not np.isfinite(sd):
        return "none"
    return f"{100 * sd / abs(value):.2g} %" if sd < abs(value) else f"±{sd:.3g}"


@cache
def _environment() -> Environment:
    made = environment("bayesfric.identifiability", "wording")
    made.filters |= {
        "capital": capital,
        "factor": factor,
        "sd": relative,
    }
    made.globals["inf"] = np.inf
    return made


@cache
def _sentences() -> dict[tuple[str, str], Any]:
    text = files("bayesfric.identifiability").joinpath("wording/sentences.toml").read_text("utf-8")
    return {
        (topic, kind): _environment().from_string(template)
        for topic, kinds in tomllib.loads(text).items()
        for kind, template in kinds.items()
    }
