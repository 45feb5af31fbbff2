"""When a torque was sampled: means about, after or before the stamp mean one and the same."""

import numpy as np
import pytest

from bayesfric.recordings.source import Recording, Torque

from .samples import measured, source, write

PERIOD, W = 0.01, 2 * np.pi * 2.0  # rad/s
T = np.round(np.arange(400) * PERIOD, 9)
SHIFTS = {"average": 0.0, "start": 0.5, "end": -0.5}


def mean(middle):
    """Mean of cos(W t) over one period about some times."""
    return np.cos(W * middle) * np.sinc(W * PERIOD / (2 * np.pi))


def read(folder, sampled, torque, **more):
    rows = zip(T.tolist(), np.sin(W * T).tolist(), torque.tolist(), strict=True)
    write(folder, "\n".join(["t,q,tau", *(f"{a!r},{b!r},{c!r}" for a, b, c in rows)]))
    channel = Torque(column="tau", unit="N m", **({"sampled": sampled} if sampled else {}), **more)
    return measured(Recording(source(torque=channel), folder))


@pytest.mark.parametrize("sampled", SHIFTS)
def test_torque_and_motion_pass_the_same_mean_about_the_stamp(tmp_path, sampled):
    found = read(tmp_path, sampled, mean(T + SHIFTS[sampled] * PERIOD))
    inner = slice(5, -5)
    np.testing.assert_allclose(found.torque[inner], mean(T)[inner], atol=1e-6)
    blurred = np.sin(W * T) * np.sinc(W * PERIOD / (2 * np.pi))
    np.testing.assert_allclose(found.position[inner], blurred[inner], atol=1e-5)
    assert any("averaged alike" in step for step in found.steps)


def test_that_a_command_is_held_goes_to_what_simulates(tmp_path):
    assert read(tmp_path, None, np.cos(W * T), held=True).hold == "zero"
