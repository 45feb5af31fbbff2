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


def read_provenance(run: Path) -> Provenance | None:
    """Read the root attributes of a run's ``posterior.nc``, and no draws; ``None`` without them."""
    try:
        with h5py.File(run / "posterior.nc") as file:
            told = {key: str(file.attrs[key]) for key in ("versions", "recordings", "seed")}
        return Provenance(_table(told["versions"]), _table(told["recordings"]), told["seed"])
    except (OSError, KeyError, ValueError):
        return None


def _table(text: str) -> dict[str, str]:
    found = json.loads(text)
    if not isinstance(found, dict):
        raise ValueError("no table")
    return {str(key): str(value) for key, value in found.items()}
