"""Recordings: what was measured, in SI units, on a uniform time base."""

from bayesfric.recordings.observation import Observation, observe
from bayesfric.recordings.options import (
    Channel,
    Current,
    Position,
    Processing,
    Source,
    Torque,
    Velocity,
    Voltage,
)
from bayesfric.recordings.read import read_recordings
from bayesfric.recordings.recording import Recording

__all__ = [
    "Channel",
    "Current",
    "Observation",
    "Position",
    "Processing",
    "Recording",
    "Source",
    "Torque",
    "Velocity",
    "Voltage",
    "observe",
    "read_recordings",
]
