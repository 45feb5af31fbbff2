"""Simulated positions, their derivatives, and initial states taken out of a fit."""

import numpy as np
import pytest

from bayesfric.estimates.shooting import (
    Elimination,
    Shooting,
    choose_substeps,
    resolution,
    step_error,
)
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.joint import PRESETS
from tests.estimates.simulated import PERIOD, excite, move, prepare

KNEE = PRESETS["rabbit-knee"]
CHAIN = KNEE.chain()
VALUES = CHAIN.vector(KNEE.values)


@pytest.fixture(scope="module")
def knee():
    torque = excite(2.0, 0.8)
    motion = move(CHAIN, KNEE.values, torque)
    trajectory, _ = prepare(motion.q, torque, 0.5)
    starts = trajectory.segments[:, 0]
    return Shooting(CHAIN, [trajectory], 1), np.stack([motion.q[starts], motion.qd[starts]], 1)


def test_positions_are_those_measured_at_the_truth(knee):
    shooting, states = knee
    simulated = shooting.positions(VALUES[None], states)[0]
    # restarts only change how steps fall between events: the error of the method is 1e-9 here
    assert np.max(np.abs(simulated - shooting.measured)) < 1e-8
    (trajectory,) = shooting.trajectories
    assert len(trajectory.segments) == 4
    lengths = np.diff(trajectory.segments, axis=1)[:, 0]
    assert np.array_equal(shooting.segment_of, np.repeat(np.arange(4), lengths))


def test_derivatives_by_parameters_are_those_of_other_steps(knee):
    """Richardson's extrapolation of two other widths, each segment simulated by itself."""
    shooting, states = knee
    width = 1e-5 * np.abs(VALUES)
    found = shooting.sensitivities(VALUES, states, width, (1e-6, 1e-5))
    (a, b), (q0, qd0) = shooting.trajectories[0].segments[1], states[1]

    def slope(j, h):
        sides = []
        for sign in (1, -1):
            moved = VALUES.copy()
            moved[j] += sign * h
            torque = shooting.trajectories[0].torque[a:b]
            sides.append(simulate(CHAIN, moved, torque, PERIOD, q0=q0, qd0=qd0, substeps=1).q)
        return (sides[0] - sides[1]) / (2.0 * h)

    for j in range(VALUES.size):
        h = 1e-4 * abs(VALUES[j])
        exact = (4.0 * slope(j, h / 2.0) - slope(j, h)) / 3.0
        size = np.abs(exact).max()
        # a kink that a step carries over a sample leaves an error of the order of the step
        assert np.max(np.abs(found.parameters[a:b, j] - exact)) <= 2e-4 * size, CHAIN.names[j]


def test_one_sided_differences_stay_within_the_limits(knee):
    shooting, states = knee
    at = VALUES.copy()
    name = CHAIN.names.index("joint.viscous")
    at[name] = 0.0
    steps = np.zeros(at.size)
    steps[name] = 1e-5
    inside = shooting.sensitivities(at, states, steps, (1e-6, 1e-5))
    assert np.isfinite(inside.parameters).all()
    steps[name] = 1e-6
    finer = shooting.sensitivities(at, states, steps, (1e-6, 1e-5), central=False)
    size = np.abs(finer.parameters).max()
    assert np.max(np.abs(inside.parameters - finer.parameters)) < 1e-4 * size


def test_states_act_on_their_own_segment_only(knee):
    shooting, states = knee
    found = shooting.sensitivities(VALUES, states, np.zeros(VALUES.size), (1e-6, 1e-5))
    for k in range(4):
        for i, step in enumerate((1e-6, 1e-5)):
            sides = np.stack([states, states])
            sides[:, k, i] += (step, -step)
            there, back = shooting.positions(np.tile(VALUES, (2, 1)), sides)
            change = (there - back) / (2.0 * step)
            inside = shooting.segment_of == k
            assert not change[~inside].any()
            assert np.allclose(change[inside], found.states[inside, i], atol=1e-9)
        first = np.flatnonzero(shooting.segment_of == k)[0]
        assert found.states[first] == pytest.approx([1.0, 0.0], abs=1e-8)


def test_eliminating_states_is_fitting_them(knee):
    """Projected columns are the residuals of the states' own least squares, segment by segment."""
    shooting, states = knee
    found = shooting.sensitivities(VALUES, states, 1e-5 * VALUES, (1e-6, 1e-5))
    out = Elimination(shooting, found.states, found.parameters)
    for k in range(4):
        rows = shooting.segment_of == k
        fitted, *_ = np.linalg.lstsq(found.states[rows], found.parameters[rows], rcond=None)
        left = found.parameters[rows] - found.states[rows] @ fitted
        size = np.abs(found.parameters[rows]).max()
        assert np.max(np.abs(out.projected[rows] - left)) < 1e-9 * size
        assert np.allclose(out.onto[k], fitted, rtol=1e-6, atol=1e-9 * np.abs(fitted).max())
    assert out.lost == 8


def test_a_joint_that_sticks_has_no_initial_speed_to_fit():
    """Far below breakaway the position stays what it was; its speed there says nothing."""
    torque = np.full(200, 0.01)
    # its differences are rounding, of which a dead zone leaves more or less from machine to machine
    trajectory, _ = prepare(np.full(200, 0.1), torque, dead_zone=0)
    shooting = Shooting(CHAIN, [trajectory], 1)
    states = np.array([[0.1, 0.0]])
    found = shooting.sensitivities(VALUES, states, 1e-5 * VALUES, (1e-6, 1e-5))
    assert np.allclose(found.states[:, 0], 1.0, atol=1e-9)
    # a speed v carries the joint no farther than v²/2a, a = 9 rad/s² and more
    assert np.abs(found.states[:, 1]).max() < 1e-5 / 18.0
    out = Elimination(shooting, found.states, np.ones((200, 1)))
    assert out.lost == 1
    assert np.abs(out.projected).max() < 1e-12


def test_substeps_are_as_few_as_the_encoder_allows(knee):
    shooting, states = knee
    substeps, error = choose_substeps(shooting, VALUES, states)
    finest = resolution(shooting.trajectories[0].position)
    assert error <= 0.01 * finest
    if substeps > 1:
        assert step_error(shooting, VALUES, states, substeps // 2)[0] > 0.01 * finest
    exact = shooting.positions(VALUES[None], states, 64)[0]
    plain = shooting.positions(VALUES[None], states, substeps)[0]
    # the estimate is one of the order, not a bound
    assert np.max(np.abs(plain - exact)) < 3.0 * error + 1e-13


def test_resolution_is_the_encoders_or_the_noise():
    rng = np.random.default_rng(0)
    smooth = np.sin(np.arange(5000) * 1e-3)
    assert resolution(np.round(smooth / 1e-3) * 1e-3) == pytest.approx(1e-3, rel=1e-6)
    # third differences of white noise have sqrt(20) times its sd; of a median of 5000: 2 %
    assert resolution(smooth + 1e-4 * rng.standard_normal(5000)) == pytest.approx(1e-4, rel=0.1)
