"""What a joint feels in a recording besides its motion."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Inputs:
    """Known of one recording; travels whole from the file to the kernels.

    Attributes
    ----------
    added_mass
        Known mass bolted to the load, kg.
    radius
        Its distance from the axis, m; a sliding load takes the mass alone.
    recording
        Name of the recording, for what each has of its own, as an offset.
    """

    added_mass: float = 0.0
    radius: float = 0.0
    recording: str = ""

    def load(self, motion: str) -> tuple[float, float]:
        """Inertia and first moment that the known mass brings to the load.

        Parameters
        ----------
        motion
            Whether the load turns or slides, ``rotary`` or ``linear``.

        Returns
        -------
        tuple of float
            kg m² and kg m for a turning load, kg and 0 for a sliding one.
        """
        if motion == "linear":
            return self.added_mass, 0.0
        return self.added_mass * self.radius**2, self.added_mass * self.radius
