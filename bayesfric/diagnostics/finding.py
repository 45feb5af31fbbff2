"""One thing that may be wrong with a recording or a model: the record that every check gives.

``summary.json``, report and command line take it from here; its wording is looked up by ``kind``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Severity = Literal["note", "doubt"]


@dataclass(frozen=True)
class Finding:
    """One thing that the recordings show and that recordings of a right model do not."""

    kind: str  # What it is, a key of the words
    # doubt where it moves a reported number by more than half its interval, else note
    severity: Severity
    statistic: float  # How far beyond what its replicates show, as a standard normal
    p: float  # How often replicates show as much of anything
    # Which of its kind it is, such as a speed or a frequency; empty where there is one
    shape: str = ""
    recording: str = ""  # In which it is; empty for all
    span: tuple[float, float] | None = None  # Seconds in which it is, where it is not all along
    share: float = 0.0  # Root mean square of its torque over that of all torque
    rivals: tuple[str, ...] = ()  # Kinds that this motion does not tell it from
    # By name of a parameter, by how many of its standard deviations its value is off; the most
    # first
    moves: Mapping[str, float] = field(default_factory=dict)
    setting: str = ""  # Line of a configuration that would put it in; empty where none does
    # Whether the sign that it was found with is possible for what setting says
    physical: bool = True

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of what it moves, the most first."""
        return tuple(self.moves)

    @property
    def hint(self) -> str:
        """What to write, where it may be what ``setting`` says."""
        return self.setting if self.physical else ""

    @property
    def put_in(self) -> bool:
        """Whether a model may be completed by it: by a delay only where nothing rivals it."""
        return bool(self.hint) and not (self.kind in ("delay", "target_delay") and self.rivals)

    def as_dict(self) -> dict[str, Any]:
        """Give it as ``summary.json`` has it, most important keys first."""
        told: dict[str, Any] = {"kind": self.kind, "severity": self.severity}
        told |= {"parameters": list(self.parameters)}
        told |= {"p": self.p, "hint": self.hint, "statistic": self.statistic, "shape": self.shape}
        told |= {"share": self.share, "rivals": list(self.rivals), "moves": dict(self.moves)}
        told |= {"physical": self.physical, "recording": self.recording}
        return told | {"span": None if self.span is None else list(self.span)}
