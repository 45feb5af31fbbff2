"""Recordings: what was measured, in SI units, on a uniform time base."""

from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import Observation, observe
from bayesfric.recordings.read import read_recordings
from bayesfric.recordings.recording import Recording
from bayesfric.recordings.source import (
    Channel,
    Current,
    Position,
    Processing,
    Source,
    Torque,
    Velocity,
    Voltage,
)

__all__ = [
    "Channel",
    "Current",
    "Measurement",
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
