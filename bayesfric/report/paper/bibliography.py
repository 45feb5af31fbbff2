"""What a report may cite: ``references.bib``, read."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

import bayesfric

_ENTRY = re.compile(r"^% ([^\n]+)\n(@\w+\{(\w+),\n.*?^\}\n)", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Entry:
    """One reference: ``short`` as written in plain text, ``text`` its BibTeX."""

    short: str
    text: str


def _read() -> dict[str, Entry]:
    text = (files("bayesfric.report.paper") / "references.bib").read_text(encoding="utf-8")
    # this package's own entry names its version
    found = _ENTRY.findall(text.replace("VERSION", bayesfric.__version__))
    return {key: Entry(short, entry) for short, entry, key in found}


ENTRIES = _read()


def bibliography(keys: Sequence[str]) -> str:
    """Write the entries of the given keys as a BibTeX file, in that order."""
    return "\n".join(ENTRIES[key].text for key in keys)
