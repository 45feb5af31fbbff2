"""Simulation that starts anew in every segment."""

import numpy as np
import pytest

from bayesfric.mechanism.forward import simulate, simulate_segments
from bayesfric.mechanism.presets import PRESETS

KNEE = PRESETS["rabbit-knee"]
CHAIN = KNEE.chain()
VALUES = CHAIN.vector(KNEE.values)
TIME = np.arange(600) * 1e-3
TORQUE = 0.8 * np.sign(np.sin(2 * np.pi * 4.0 * TIME + 0.1))


def test_each_segment_is_a_simulation_of_its_own():
    segments = [(10, 200), (200, 330), (400, 600)]
    q0, qd0 = np.array([0.1, -0.2, 0.3]), np.array([0.5, 0.0, -2.0])
    out = simulate_segments(CHAIN, VALUES[None], TORQUE, 1e-3, segments, q0, qd0, substeps=4)[0]
    for (a, b), q, qd in zip(segments, q0, qd0, strict=True):
        alone = simulate(CHAIN, VALUES, TORQUE[a:b], 1e-3, q0=q, qd0=qd, substeps=4)
        assert np.array_equal(out[0, a:b], alone.q)
    outside = np.ones(600, dtype=bool)
    for a, b in segments:
        outside[a:b] = False
    assert np.isnan(out[0, outside]).all()
    assert outside.sum() == 80


def test_restarts_at_the_states_of_one_motion_are_that_motion():
    whole = simulate(CHAIN, VALUES, TORQUE, 1e-3, substeps=4)
    starts = np.arange(0, 600, 100)
    segments = np.stack([starts, starts + 100], axis=1)
    out = simulate_segments(
        CHAIN, VALUES[None], TORQUE, 1e-3, segments, whole.q[starts], whole.qd[starts], substeps=4
    )[0]
    # decided afresh at a sample, a step is at most rounded differently
    assert np.max(np.abs(out[0] - whole.q)) < 1e-10


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"segments": [(5, 5)]}, "not empty"),
        ({"segments": [0, 5]}, r"\(K, 2\)"),
        ({"segments": [(0, 601)]}, "within"),
        ({"segments": [(-1, 5)]}, "within"),
        ({"values": VALUES}, "shape"),
        ({"values": VALUES[None] * np.nan}, "finite"),
        ({"q0": [np.nan]}, "finite"),
        ({"qd0": [np.inf]}, "finite"),
        ({"substeps": 0}, "substeps"),
    ],
)
def test_bad_input_is_refused(changed, message):
    given = {
        "values": VALUES[None],
        "torque": TORQUE,
        "period": 1e-3,
        "segments": [(0, 600)],
        "q0": [0.0],
        "qd0": [0.0],
    } | changed
    with pytest.raises(ValueError, match=message):
        simulate_segments(CHAIN, **given)
