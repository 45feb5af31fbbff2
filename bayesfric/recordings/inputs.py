"""What a joint feels in a recording besides its motion."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Inputs:
    """Known of one recording; travels whole from the file to the kernels."""

    added_mass: float = 0.0  # known mass bolted to the load, kg
    radius: float = 0.0  # its distance from the axis, m; a sliding load takes the mass alone
    recording: str = ""  # its name, for what each has of its own, as an offset

    def load(self, motion: str) -> tuple[float, float]:
        """Inertia and first moment that the known mass brings to a load of a motion.

        They are kg m² and kg m for a ``rotary`` load, kg and 0 for a ``linear`` one.
        """
        if motion == "linear":
            return self.added_mass, 0.0
        return self.added_mass * self.radius**2, self.added_mass * self.radius
