"""Write what the code says of itself: every key, and every finding and warning of a run.

``python studies/reference/reference.py`` writes ``keys.md`` and ``warnings.md`` beside itself.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from bayesfric.commands.keys import Key, Kind, key_tables
from bayesfric.diagnostics.candidates import BY_NAME
from bayesfric.mechanism.quantities import CYCLES
from bayesfric.report.words import words

FOLDER = Path(__file__).parent
_SHORT = {
    "true or false": "true/false",
    "whole number": "integer",
    "at least ": "≥",
    "more than ": ">",
    "at most ": "≤",
    "less than ": "<",
    "` or `": "`/`",
    " and ": ", ",
}
_FILES: dict[Kind, str] = {"configuration": "A configuration", "fleet": "FLEET.toml"}


def keys_text() -> str:
    """Every key, as Markdown; keys that are the same in several tables stand once."""
    lines = [
        "# Every key",
        "",
        "Also by `bayesfric init --all-keys` and `bayesfric init fleet --all-keys`. The second "
        "column has type, unit and default (=). What has none and is not required is chosen, or is "
        "not there. Text in place of a number brings its own unit: `'1 kHz'`.",
    ]
    for kind, title in _FILES.items():
        lines += ["", f"## {title}"]
        for places, keys in _together(kind):
            heading = ", ".join(f"`{place}`" if place[0] == "[" else place for place in places)
            lines += ["", f"### {heading}", ""]
            lines += _table(("key", "type", "meaning"), map(_row, keys))
    return "\n".join([*lines, ""])


def _together(kind: Kind) -> Iterator[tuple[tuple[str, ...], list[Key]]]:
    """Give the keys of a kind of file by all the tables in which they are the same."""
    places: dict[Key, tuple[str, ...]] = {}
    for table in key_tables(kind):
        for key in table.keys:
            places[key] = (*places.get(key, ()), *table.places)
    for at in dict.fromkeys(places.values()):
        yield at, [key for key, found in places.items() if found == at]


def _row(key: Key) -> tuple[str, str, str]:
    kind = key.type
    for long, short in _SHORT.items():
        kind = kind.replace(long, short)
    default = "required" if key.default == "required" else f"= `{key.default}`"
    told = (kind, key.unit, default if key.default else "")
    return f"`{key.name}`", ", ".join(part for part in told if part), key.meaning


def warnings_text() -> str:
    """Every kind of finding and warning, as Markdown."""
    lines = [
        "# Every finding and warning of a run",
        "",
        "From `bayesfric/report/words.toml`. `findings` in `summary.json` have the kinds of the "
        "first table; `doubts` have `missing` for a finding, else kinds of the second. What a run "
        "fills in stands in braces. What `check` says of a file, its units and its time stamps is "
        "not listed: those sentences say themselves what to do.",
        "",
        "## What else may explain the torque",
        "",
        "Where a key puts it in, that is the hint; a run names its table, and the cycles a turn.",
        "",
    ]
    told = [
        (f"`{kind}`", one.what, "; else ".join(x for x in (_key(kind), one.do) if x))
        for kind, one in words().items()
    ]
    # the first that is no candidate, and the first that is no warning
    many, other = (list(words()).index(kind) for kind in ("sampler", "unsure run"))
    head = ("kind", "what it is", "hint")
    lines += [*_table(head, told[:many]), "", "## What else makes numbers doubtful", ""]
    lines += [*_table(head, told[many:other]), "", "## What else a comparison or a run says", ""]
    return "\n".join([*lines, *_table(head, told[other:]), ""])


def _key(kind: str) -> str:
    """Say which key puts a candidate in; nothing where none does."""
    if kind not in BY_NAME or not (option := BY_NAME[kind].option):
        return ""
    value = "[…]" if option in CYCLES else json.dumps(BY_NAME[kind].choice)
    return f"`{option} = {value}`"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    cells = [[" ".join(cell.split()).replace("|", "\\|") for cell in row] for row in rows]
    lines = [f"|{'|'.join(row)}|" for row in [list(head), *cells]]
    return [lines[0], "|" + "---|" * len(head), *lines[1:]]


def texts() -> dict[str, str]:
    """Make what is written, by file name."""
    return {"keys.md": keys_text(), "warnings.md": warnings_text()}


if __name__ == "__main__":
    for name, text in texts().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
        print(f"{name}: {len(text.split())} words")
