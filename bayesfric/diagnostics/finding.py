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
    """One thing that the recordings show and that recordings of a right model do not.

    Attributes
    ----------
    kind
        What it is, a key of the words.
    severity
        ``doubt`` where it moves a reported number by more than half its interval, else ``note``.
    shape
        Which of its kind it is, such as a speed or a frequency; empty where there is one.
    recording
        In which it is; empty for all.
    span
        Seconds in which it is, where it is not all along.
    statistic
        How far beyond what its twins show, as a standard normal.
    p
        How often twins show as much of anything.
    share
        Root mean square of its torque over that of all torque.
    rivals
        Kinds that this motion does not tell it from.
    moves
        By name of a parameter, by how many of its standard deviations its value is off; the most
        first.
    setting
        Line of a configuration that would put it in; empty where none does.
    physical
        Whether the sign that it was found with is possible for what ``setting`` says.
    """

    kind: str
    severity: Severity
    statistic: float
    p: float
    shape: str = ""
    recording: str = ""
    span: tuple[float, float] | None = None
    share: float = 0.0
    rivals: tuple[str, ...] = ()
    moves: Mapping[str, float] = field(default_factory=dict)
    setting: str = ""
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
