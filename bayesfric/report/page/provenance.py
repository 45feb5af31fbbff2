"""Where a run came from: versions, seed and SHA-256, out of the head of ``posterior.nc``."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from bayesfric.errors import BadInput
from bayesfric.opened import opened_hdf5, parse_json
from bayesfric.report.summary.rows import Pair, Part


class Provenance(Part):
    """What is needed to repeat a run."""

    # of Python and the libraries, by name
    versions: dict[str, str] = Field(default_factory=dict)
    # SHA-256 of every recording, by its name
    recordings: dict[str, str] = Field(default_factory=dict)
    seed: str = ""  # as text; empty where it is not known
    # first and last second that was fitted of a recording, by its name; older files do not tell
    spans: dict[str, Pair] = Field(default_factory=dict)

    @property
    def known(self) -> bool:
        """Whether any recording can be told from others."""
        return any(self.recordings.values())

    def saw_of(self, other: Provenance) -> bool:
        """Whether both fitted a part of one recording, by SHA-256 and seconds."""
        whole = [-float("inf"), float("inf")]
        return any(
            own == theirs != "" and max(a[0], b[0]) <= min(a[1], b[1])
            for mine, own in self.recordings.items()
            for name, theirs in other.recordings.items()
            for a, b in [(self.spans.get(mine, whole), other.spans.get(name, whole))]
        )


def read_provenance(run: Path) -> Provenance | None:
    """Read the root attributes of a run's ``posterior.nc``, and no draws; ``None`` without them."""
    try:
        with opened_hdf5(run / "posterior.nc") as file:
            told = {key: parse_json(key, file.attrs[key]) for key in ("versions", "recordings")}
            spans = parse_json("spans", file.attrs.get("spans", "{}"))
            return Provenance(**told, seed=str(file.attrs["seed"]), spans=spans)
    except (BadInput, ValueError, TypeError):
        return None
