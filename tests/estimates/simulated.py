"""Recordings simulated without a file, for tests of the output error."""

import numpy as np

from bayesfric.mechanism.experiment import multisine, square
from bayesfric.mechanism.forward import simulate
from bayesfric.recordings.measurement import Inputs
from bayesfric.recordings.observation import observe
from bayesfric.recordings.source import Processing
from bayesfric.recordings.trajectory import trajectory
from tests.conftest import made_recording

PERIOD = 2e-3


def excite(seconds, amplitude, seed=3):
    """Square wave and multisine: everything a joint has shows in its motion."""
    time = np.arange(round(seconds / PERIOD)) * PERIOD
    return square(time, amplitude, 1.0) + multisine(
        time, 0.45 * amplitude, (0.3, 0.7, 1.3, 2.9, 5.3), seed=seed
    )


def move(chain, values, torque, **load):
    return simulate(chain, chain.vector(values), torque, PERIOD, substeps=1, **load)


def prepare(position, torque, length=np.inf, name="made-up", added_mass=0.0, radius=0.0, **keys):
    time = np.arange(position.size) * PERIOD
    recording = made_recording(
        time, position, torque, PERIOD, name=name, inputs=Inputs(added_mass, radius, name)
    )
    observation = observe(recording, Processing(**keys))
    return trajectory(recording, observation, length), observation
