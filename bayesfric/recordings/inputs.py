"""What a joint feels in a recording besides its motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from bayesfric.recordings.arrays import Array


@dataclass(frozen=True, eq=False)
class Signal:
    """A signal of a recording, looked up by time, so that any part of its samples finds it."""

    stamps: Array  # (N,) s, rising
    values: Array  # (N,)

    def at(self, time: Array) -> Array:
        """Values at some times ``(n,)``; exact at stamps, straight lines between them."""
        return np.asarray(np.interp(time, self.stamps, self.values), dtype=np.float64)


# Fields of the inputs that are signals.
_SIGNALS = ("torque_rate", "temperature", "load_torque")
# Degrees Celsius at which losses that depend on temperature are what their parameters say.
ROOM = 20.0


@dataclass(frozen=True)
class Inputs:
    """Known of one recording; travels whole from the file to the kernels."""

    added_mass: float = 0.0  # known mass bolted to the load, kg
    radius: float = 0.0  # its distance from the axis, m; a sliding load takes the mass alone
    recording: str = ""  # its name, for what each has of its own, as an offset
    # of the measured motor torque, N m/s or N/s, for a joint with an unknown delay; recordings
    # alike in the rest are alike
    torque_rate: Signal | None = field(default=None, compare=False)
    # of the joint, degrees Celsius, for a joint whose losses depend on it
    temperature: Signal | None = field(default=None, compare=False)

    # that acts on the load from outside, as measured, N m or N
    load_torque: Signal | None = field(default=None, compare=False)
    # further columns by name, which no model has
    others: Mapping[str, Signal] = field(default_factory=dict, compare=False)

    def signal(self, name: str) -> Signal | None:
        """Look up what a term may be multiplied by; a further column, if there is one, by name.

        Where no file is, as of motions that are thought of, a further column is zero.
        """
        if name in _SIGNALS:
            own: Signal | None = getattr(self, name)
            return own
        return self.others.get(name, steady(0.0))

    @property
    def known_load(self) -> bool:
        """Whether a known mass or a measured torque loads the joint."""
        return bool(self.added_mass) or self.load_torque is not None

    def load(self, motion: str) -> tuple[float, float]:
        """Inertia and first moment that the known mass brings to a load of a motion.

        They are kg m² and kg m for a ``rotary`` load, kg and 0 for a ``linear`` one.
        """
        if motion == "linear":
            return self.added_mass, 0.0
        return self.added_mass * self.radius**2, self.added_mass * self.radius


def steady(value: float) -> Signal:
    """Give a signal that never changes."""
    return Signal(np.zeros(1), np.full(1, value))


# What a joint feels at constant speed and room temperature.
AT_ROOM = Inputs(torque_rate=steady(0.0), temperature=steady(ROOM))
