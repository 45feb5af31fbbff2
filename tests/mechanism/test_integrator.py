"""The integrator: its order, its step control, other integrators, and what it refuses."""

import numpy as np
import pytest

from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.experiment import current_loop, square
from bayesfric.mechanism.forward import simulate, simulate_segments
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.measurement import Inputs
from tests.mechanism.joints import EVERYTHING, EVERYTHING_VALUES, KNEE, axis, signal

CHAIN = KNEE.chain()
VALUES = CHAIN.vector(KNEE.values)


def interrupted(period, seconds):
    """1 Hz square wave through a 5 ms lag, with two pauses in which the joint sticks."""
    time = np.arange(round(seconds / period) + 1) * period
    command = square(time, 0.8, 1.0)
    command[((time > 1.2) & (time < 1.9)) | ((time > 3.1) & (time < 3.6))] = 0.0
    return current_loop(command, period, 5e-3)


@pytest.mark.parametrize(
    ("chain", "values", "period", "steps", "scale", "options"),
    [
        (KNEE.chain(), KNEE.values, 5e-3, (1, 2, 4, 8), 1.0, {}),
        (
            EVERYTHING,
            EVERYTHING_VALUES,
            2e-3,
            (4, 8, 16),
            0.8,
            {"inputs": Inputs(1.0, 0.4), "q0": 0.3},
        ),
    ],
    ids=["knee", "everything"],
)
def test_error_falls_with_the_fourth_power_of_the_step(
    chain, values, period, steps, scale, options
):
    torque = scale * interrupted(period, 5.0 if chain.made_from else 3.0)
    values = chain.vector(values)
    runs = {
        n: simulate(chain, values, torque, period, substeps=n, **options)
        for n in (*steps, 8 * steps[-1])
    }
    last = runs[8 * steps[-1]]
    errors = np.array([np.abs(runs[n].q - last.q).max() for n in steps])
    ratios = errors[:-1] / errors[1:]
    # kinks: more events than stops and breakaways can explain
    starts = np.sum(np.diff(last.sticking.astype(int)) == -1)
    assert last.reversals >= 3
    assert last.events > last.reversals + 2 * starts
    assert np.sum(last.sticking[100:]) > 50
    assert 12 < ratios.mean() < 20, ratios


def test_default_substeps_meet_the_tolerance():
    torque = interrupted(5e-3, 5.0)
    fine = simulate(CHAIN, VALUES, torque, 5e-3, substeps=64)
    coarse = simulate(CHAIN, VALUES, torque, 5e-3, tolerance=1e-6)
    assert coarse.substeps < 64
    assert np.abs(coarse.q - fine.q).max() < 1e-7
    assert coarse.step_error < 1e-7
    capped = simulate(CHAIN, VALUES, torque, 5e-3, tolerance=0.0)
    assert capped.substeps == 64


def varied(name, value):
    return CHAIN.vector(KNEE.values | {name: value})


def test_vectors_without_a_motion_are_nan():
    rows = [VALUES, varied("gearbox.load_back", 8.0), varied("motor.viscous", -1.0)]
    start = np.zeros((3, 1))
    q, _ = simulate_segments(CHAIN, rows, signal(1e-2), 1e-2, [(0, 121)], start, start)
    np.testing.assert_array_equal(np.isnan(q).all(axis=1), [False, True, True])
    assert np.all(np.isfinite(q[0]))
    torque = np.full(1001, 10.0)
    away, _ = simulate_segments(axis(), [[1e-3]], torque, 1.0, [(0, 1001)], [0.0], [0.0])
    assert np.isfinite(away[0, 0])
    assert np.all(np.isnan(away[0, 20:]))


@pytest.mark.parametrize(
    ("chain", "values", "torque", "match"),
    [
        (CHAIN, varied("motor.inertia", np.nan), 0.0, "motor.inertia"),
        (CHAIN, varied("joint.viscous", -1.0), 0.0, "joint.viscous"),
        (CHAIN, varied("gearbox.load_back", 8.0), 0.0, "irreversible gearbox"),
        (axis(), [0.0], 0.0, "no inertia"),
        (CHAIN, VALUES, np.inf, "torque, q0 and qd0 must be finite"),
        (axis(), [1e-3], 10.0, "runs away"),
        (Joint(axis().elements, Load(), gain=True), [1.0, 0.0], 0.0, "greater than zero"),
    ],
)
def test_what_has_no_motion_is_refused(chain, values, torque, match):
    with pytest.raises(ValueError, match=match):
        simulate(chain, values, np.full(1001, torque), 1.0)


def test_single_sample_and_sliding_load():
    motion = simulate(axis(), [1.0], [0.5], 1e-3)
    assert motion.q.shape == (1,)
    assert motion.qdd[0] == 0.5
    slide = Joint(
        elements=(Element("screw", inertia=True, motion="linear"),), load=Load(motion="linear")
    )
    moved = simulate(slide, [1.0], np.ones(11), 0.1, inputs=Inputs(1.0, 5.0))
    np.testing.assert_allclose(moved.q[-1], 0.25, rtol=1e-13)


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


def test_segments_hold_a_torque_alike():
    (q,), _ = simulate_segments(
        CHAIN, VALUES[None], TORQUE, 1e-3, [(0, 600)], [0.0], [0.0], hold="zero", substeps=8
    )
    alone = simulate(CHAIN, VALUES, TORQUE, 1e-3, hold="zero", substeps=8)
    np.testing.assert_array_equal(q, alone.q)
