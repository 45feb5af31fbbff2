"""Where a run came from: versions, seed and SHA-256, out of the head of ``posterior.nc``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import h5py


@dataclass(frozen=True)
class Provenance:
    """What is needed to repeat a run."""

    # of Python and the libraries, by name
    versions: Mapping[str, str] = field(default_factory=dict)
    # SHA-256 of every recording, by its name
    recordings: Mapping[str, str] = field(default_factory=dict)
    seed: str = ""  # as text; empty where it is not known
    # first and last second that was fitted of a recording, by its name; older files do not tell
    spans: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def known(self) -> bool:
        """Whether any recording can be told from others."""
        return any(self.recordings.values())

    def saw_of(self, other: Provenance) -> bool:
        """Whether both fitted a part of one recording, by SHA-256 and seconds."""
        whole = (-float("inf"), float("inf"))
        return any(
            own == theirs != "" and max(a[0], b[0]) <= min(a[1], b[1])
            for mine, own in self.recordings.items()
            for name, theirs in other.recordings.items()
            for a, b in [(self.spans.get(mine, whole), other.spans.get(name, whole))]
        )


def read_provenance(run: Path) -> Provenance | None:
    """Read the root attributes of a run's ``posterior.nc``, and no draws; ``None`` without them."""
    try:
        with h5py.File(run / "posterior.nc") as file:
            told = {key: str(file.attrs[key]) for key in ("versions", "recordings", "seed")}
            spans = _spans(file.attrs.get("spans", "{}"))
        told_of = _table(told["versions"]), _table(told["recordings"])
        return Provenance(*told_of, told["seed"], spans)
    except (OSError, KeyError, ValueError, TypeError):
        return None


def _spans(text: object) -> dict[str, tuple[float, float]]:
    found = json.loads(str(text))
    return {str(name): (float(start), float(stop)) for name, (start, stop) in found.items()}


def _table(text: str) -> dict[str, str]:
    found = json.loads(text)
    if not isinstance(found, dict):
        raise ValueError("no table")
    return {str(key): str(value) for key, value in found.items()}
