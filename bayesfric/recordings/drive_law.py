"""How a drive makes the motor's torque: of a command alone, or of the joint's motion too."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesfric.recordings.arrays import Array, Flags, Index
from bayesfric.recordings.timebase import Grid


@dataclass(frozen=True, eq=False)
class Law:
    """The motor's torque at any motion of the joint; arrays have the shape (n,).

    ``scale clip(command - kp q - kd qd, limit) - back_emf qd``, and none where the drive is off:
    a winding without current.
    """

    command: Array  # torque, or kp times the position aimed at, in what the drive limits
    scale: Array  # motor torque for one of that
    kp: float = 0.0  # command for a position of the joint; so is the next for its speed
    kd: float = 0.0
    limit: float = np.inf  # of the command, either way
    back_emf: float = 0.0  # motor torque for a speed of the joint
    off: Flags | None = None  # where the drive gives nothing, if anywhere
    held: bool = False  # whether a command stands until the next; else it goes straight

    @property
    def follows(self) -> bool:
        """Whether the torque hangs on the motion."""
        return bool(self.kp or self.kd or self.back_emf)

    @property
    def closed(self) -> bool:
        """Whether the drive goes for a position."""
        return bool(self.kp)

    def drives(self, q: Array, qd: Array) -> Array:
        """Torque before the back-EMF, ``(n,)``."""
        aimed = self.command - self.kp * q - self.kd * qd
        return np.asarray(self.scale * np.clip(aimed, -self.limit, self.limit))

    def limited(self, q: Array, qd: Array) -> Flags:
        """Where the command is at its limit, ``(n,)``."""
        return np.asarray(np.abs(self.command - self.kp * q - self.kd * qd) >= self.limit)

    def on(self, grid: Grid) -> Law:
        """Bring it from a file's stamps onto a uniform time base."""
        return replace(self, command=grid.linear(self.command), scale=grid.linear(self.scale))

    def part(self, samples: Index | slice) -> Law:
        """Give that of some of the samples."""
        off = None if self.off is None else self.off[samples]
        return replace(self, command=self.command[samples], scale=self.scale[samples], off=off)
