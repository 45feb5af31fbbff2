"""Write what the code says of itself: every key, and every finding and warning of a run.

``python studies/reference/reference.py`` writes ``keys.md`` and ``warnings.md`` beside itself.
"""

from __future__ import annotations

import json
from pathlib import Path

from bayesfric.commands.keys import keys_text, table_text
from bayesfric.diagnostics.candidates import BY_NAME
from bayesfric.mechanism.quantities import CYCLES
from bayesfric.report.words import words

FOLDER = Path(__file__).parent


def keys() -> str:
    """Every key, as Markdown."""
    lines = [
        "# Every key",
        "",
        "Also by `bayesfric init --all-keys` and `bayesfric init fleet --all-keys`. The second "
        "column has type, unit and default (=). What has none and is not required is chosen, or is "
        "not there. Text in place of a number brings its own unit: `'1 kHz'`.",
        "",
    ]
    return "\n".join([*lines, keys_text("configuration"), keys_text("fleet")])


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
    lines += [*table_text(head, told[:many]), "", "## What else makes numbers doubtful", ""]
    lines += [
        *table_text(head, told[many:other]),
        "",
        "## What else a comparison or a run says",
        "",
    ]
    return "\n".join([*lines, *table_text(head, told[other:]), ""])


def _key(kind: str) -> str:
    """Say which key puts a candidate in; nothing where none does."""
    if kind not in BY_NAME or not (option := BY_NAME[kind].option):
        return ""
    value = "[…]" if option in CYCLES else json.dumps(BY_NAME[kind].choice)
    return f"`{option} = {value}`"


def texts() -> dict[str, str]:
    """Make what is written, by file name."""
    return {"keys.md": keys(), "warnings.md": warnings_text()}


if __name__ == "__main__":
    for name, text in texts().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
        print(f"{name}: {len(text.split())} words")
