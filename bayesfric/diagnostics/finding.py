"""A finding: an effect that the recordings show and the model lacks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Severity = Literal["note", "doubt"]


@dataclass(frozen=True)
class Finding:
    """An effect in the recordings that replicates of a right model do not show."""

    kind: str  # key of ``words.toml``
    severity: Severity  # doubt if it moves a reported number by more than half its interval
    statistic: float  # standard normal score among the replicates
    p: float  # share of replicates with as large a statistic of any candidate
    shape: str = ""  # such as a speed or a frequency; empty if the kind has one shape
    recording: str = ""  # empty for all
    span: tuple[float, float] | None = None  # s; None for the whole recording
    share: float = 0.0  # rms of its torque over the rms of all torque
    rivals: tuple[str, ...] = ()  # kinds that are collinear with it on this motion
    # shift of each parameter in its standard deviations, the largest first
    moves: Mapping[str, float] = field(default_factory=dict)
    setting: str = ""  # line of a configuration that adds the term; empty if there is none
    physical: bool = True  # whether the estimated sign is possible for that term

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that it moves, the largest shift first."""
        return tuple(self.moves)

    @property
    def hint(self) -> str:
        """The setting, if the sign allows it."""
        return self.setting if self.physical else ""

    @property
    def applicable(self) -> bool:
        """Whether the setting may be applied automatically; a delay only without rivals."""
        return bool(self.hint) and not (self.kind in ("delay", "target_delay") and self.rivals)

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of ``summary.json``."""
        return {
            "kind": self.kind,
            "severity": self.severity,
            "parameters": list(self.parameters),
            "p": self.p,
            "hint": self.hint,
            "statistic": self.statistic,
            "shape": self.shape,
            "share": self.share,
            "rivals": list(self.rivals),
            "moves": dict(self.moves),
            "physical": self.physical,
            "recording": self.recording,
            "span": None if self.span is None else list(self.span),
        }
