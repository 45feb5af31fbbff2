"""What is said by kind: ``words.toml``, in one line each."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from bayesfric.templates import percent, placed, two


@dataclass(frozen=True)
class Words:
    """Of one kind: what it is, and what to do about it; either may be empty."""

    what: str
    do: str


@cache
def words() -> Mapping[str, Words]:
    """Read the table."""
    text = (files("bayesfric.report") / "words.toml").read_text(encoding="utf-8")
    return {kind: Words(**entry) for kind, entry in tomllib.loads(text).items()}


def words_of(kind: str) -> Words:
    """Give what is said of a kind; one that only another version knows by its name."""
    return words().get(kind, Words(kind, ""))


def line_of(kind: str, values: Mapping[str, Any] | None = None) -> str:
    """Say one thing in a line: what it is, the share of the torque (rms), what to do."""
    told = dict(values or {})
    kind = str(told.get("what", kind)) if kind == "missing" else kind
    known = words_of(kind)
    what, do = (part.format_map(_Shown(told)) for part in (known.what, known.do))
    if "hint" not in told:
        return f"{what}: {do}" if do else what
    share = f"{percent(told['share'])} % rms"
    if told.get("span"):
        low, high = told["span"]
        return f"{what} ({share}): exclude = [[{low:.1f}, {high:.1f}]] of {told['recording']}"
    if not told.get("physical", True):
        return f"{what} of the wrong sign ({share}): something that is on no list"
    what += f" ({share})"
    if told["hint"]:
        table, line = placed(told["hint"])
        do = f"{line} in [{table}]"
    return f"{what}: {do}" if do else what


class _Shown(dict[str, Any]):
    """Values as a line shows them; what is not told is left out."""

    def __getitem__(self, key: str) -> str:
        value = self.get(key, "")
        if key == "share":
            return percent(value)
        if isinstance(value, float):
            return two(value)
        if isinstance(value, (Mapping, list, tuple)):
            some = [f"{x:.4g}" if isinstance(x, float) else str(x) for x in value]
            return ", ".join(some[:3]) + (f" and {len(some) - 3} more" if len(some) > 3 else "")
        return str(value)
