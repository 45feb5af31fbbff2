"""Multiple shooting against SciPy: its integrator, its least squares, dense algebra of states."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares as scipy_least_squares

from bayesfric.estimates.input_error import few_threads
from bayesfric.estimates.output_error import (
    OutputError,
    Shooting,
    choose_substeps,
    eliminate_states,
    output_error,
    resolution,
)
from bayesfric.estimates.point_estimate import Estimate, Estimation, Knowledge
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import PRESETS, Joint
from tests.estimates.simulated import PERIOD, excite, move, prepare

KNEE = PRESETS["rabbit-knee"]
CHAIN = KNEE.chain()
VALUES = CHAIN.vector(KNEE.values)
# smooth, so that SciPy follows it: inertia, viscous loss, gravity
SMOOTH = Joint((Element("motor", inertia=True, viscous=True),), Load(first_moment=True))
SMOOTH_VALUES = {"motor.inertia": 0.02, "motor.viscous": 0.1, "load.first_moment": 0.05}
AT = SMOOTH.vector(SMOOTH_VALUES)
NAMES = SMOOTH.names


@pytest.fixture(autouse=True)
def few():
    with few_threads([]):
        yield


def moves(torque, values, state):
    """Position from a torque that is linear between samples, by an integrator of order eight."""
    time = PERIOD * np.arange(torque.size)
    j, f, ml = (values[NAMES.index(n)] for n in SMOOTH_VALUES)

    def slope(t, x):
        driven = np.interp(t, time, torque)
        return x[1], (driven - f * x[1] - 9.80665 * ml * np.sin(x[0])) / j

    solution = solve_ivp(
        slope, (0.0, time[-1]), state, "DOP853", time, rtol=1e-9, atol=1e-11, max_step=PERIOD
    )
    return solution.y[0]


def recorded(seconds, sigma, seed, name="made-up"):
    torque = excite(seconds, 0.6, seed=seed)
    q = move(SMOOTH, SMOOTH_VALUES, torque).q
    noise = sigma * np.random.default_rng(seed).standard_normal(q.size)
    return prepare(q + noise, torque, name=name)


PARTS = recorded(0.5, 1e-4, 1, "one"), recorded(0.3, 1e-3, 2, "two")
START = Estimate("input-error", (), 0.0, 1, "", point=tuple(zip(NAMES, 1.1 * AT, strict=True)))


def test_positions_and_derivatives_are_those_of_scipy_s_integrator():
    trajectories = [t for t, _ in PARTS]
    shooting = Shooting(SMOOTH, trajectories, 4)
    states = np.array([[0.02, 0.1], [-0.3, 0.4]])
    derivatives = shooting.sensitivities(AT, states, 1e-5 * AT, (1e-5, 1e-4))
    steps = 1e-4 * AT
    for k, t in enumerate(trajectories):
        rows = shooting.segment_of == k
        exact = moves(t.torque, AT, states[k])
        np.testing.assert_allclose(derivatives.positions[rows], exact, atol=1e-8)
        for j in range(3):
            sides = [moves(t.torque, AT + s * steps * np.eye(3)[j], states[k]) for s in (1, -1)]
            slope = (sides[0] - sides[1]) / (2.0 * steps[j])
            np.testing.assert_allclose(
                derivatives.parameters[rows, j], slope, atol=2e-4 * np.abs(slope).max()
            )
        for i in range(2):
            sides = [moves(t.torque, AT, states[k] + s * 1e-3 * np.eye(2)[i]) for s in (1, -1)]
            np.testing.assert_allclose(
                derivatives.states[rows, i], (sides[0] - sides[1]) / 2e-3, rtol=1e-4, atol=1e-6
            )


CASES = {
    "free": Knowledge(),
    "fixed": Knowledge(fixed={"load.first_moment": 0.05}),
    "one": Knowledge(fixed={"load.first_moment": 0.05, "motor.inertia": 0.02}),
    "priors": Knowledge(priors={"motor.viscous": (0.11, 0.002), "motor.inertia": (0.02, 1e-4)}),
    "bound": Knowledge(bounds={"motor.viscous": (0.0, 0.09)}),
}


@pytest.mark.parametrize("case", CASES)
def test_the_nearest_motion_is_scipy_s(case):
    """One recording, cut into segments of 0.1 s, each from a state of its own."""
    knowledge = CASES[case]
    options = Estimation(substeps=1, segment=0.1)
    problem = OutputError(SMOOTH, *zip(PARTS[0], strict=True), knowledge, options)
    begin = dict(zip(NAMES, 1.2 * AT, strict=True)) | knowledge.fixed
    fit = problem.fit(SMOOTH.vector(begin), 0.1)
    shooting = fit.shooting
    free = [NAMES.index(n) for n in knowledge.free(SMOOTH)]
    assert fit.converged
    assert len(shooting.initial) == 5
    whole = AT.copy()
    lower, upper = knowledge.limits(SMOOTH)
    variance = float(np.mean(fit.residual**2))

    def residual(x):
        whole[free] = x[: len(free)] * AT[free]
        states = x[len(free) :].reshape(-1, 2)
        left = shooting.measured - shooting.positions(whole[None], states)[0]
        by_priors = [
            np.sqrt(variance) * (mean - whole[NAMES.index(n)]) / sd
            for n, (mean, sd) in knowledge.priors.items()
        ]
        return np.concatenate([left, by_priors])

    begin = np.concatenate([np.full(len(free), 0.85), shooting.initial.ravel()])
    reach = np.full(shooting.initial.size, np.inf)
    bounds = np.append(lower / AT[free], -reach), np.append(upper / AT[free], reach)
    tight = {"xtol": 1e-13, "ftol": 1e-13, "gtol": 1e-13}
    theirs = scipy_least_squares(residual, begin, bounds=bounds, jac="2-point", **tight)
    jacobian = theirs.jac[: shooting.measured.size]
    # with the states taken out, and what is known besides
    freedom = shooting.measured.size - len(free) - 2 * len(shooting.initial)
    left = fit.residual
    by, states = jacobian[:, : len(free)] / AT[free], jacobian[:, len(free) :]
    by = by - states @ np.linalg.lstsq(states, by, rcond=None)[0]
    sigma2 = left @ left / freedom
    information = by.T @ by / sigma2
    for name, (_, sd) in knowledge.priors.items():
        information[free.index(NAMES.index(name)), free.index(NAMES.index(name))] += sd**-2
    spread = np.sqrt(np.diag(np.linalg.inv(information)))
    values = fit.values[free]
    assert np.sum(residual(np.append(values / AT[free], fit.states)) ** 2) == pytest.approx(
        2.0 * theirs.cost, rel=1e-3
    )
    # it ends where a step would lower the cost by less than 1e-4 variances
    assert (np.abs(values - theirs.x[: len(free)] * AT[free]) < 0.02 * spread).all()
    assert fit.information.freedom == freedom
    assert fit.information.sigma == pytest.approx(np.sqrt(sigma2), rel=1e-6)
    for row, sd in zip(np.eye(len(free)), spread, strict=True):
        assert fit.information.sds(row)[0] == pytest.approx(sd, rel=2e-3)
    assert fit.at_bound.tolist() == ([0, 1, 0] if case == "bound" else [0] * len(free))
    if case in ("fixed", "one"):
        assert fit.values[NAMES.index("load.first_moment")] == 0.05


def test_recordings_are_weighed_by_what_each_leaves():
    """Repeated until it settles: one over the root mean square of each recording's residuals."""
    options = Estimation(substeps=1, segment=0.1)
    fit = OutputError(SMOOTH, *zip(*PARTS, strict=True), Knowledge(), options).fit(AT, 0.1)
    recording = fit.shooting.recording_of
    sizes = np.array([np.sqrt(np.mean(fit.residual[recording == k] ** 2)) for k in (0, 1)])
    weights = fit.weights * sizes[recording]
    np.testing.assert_allclose(weights / weights[0], 1.0, rtol=1e-2)


def test_segments_are_long_enough_to_say_something_and_many_enough_for_their_sums():
    options = Estimation(substeps=1)
    trajectories, observations = zip(*PARTS, strict=True)
    problem = OutputError(SMOOTH, trajectories, observations, Knowledge(), options)
    total = sum(t.samples.size for t in trajectories) * PERIOD
    for length in problem.lengths():
        assert length >= 40 * PERIOD
        assert total / length >= 2 * 3 or problem.lengths() == (length,)
    fixed = OutputError(
        SMOOTH, trajectories, observations, Knowledge(), Estimation(substeps=1, segment=0.17)
    )
    assert fixed.lengths() == (0.17,)


@pytest.mark.parametrize(("of_torque", "of_position"), [(0.0, 1e-4), (0.3, 1e-6)])
def test_a_longer_segment_is_taken_where_that_clearly_tells_more(of_torque, of_position):
    """Fits of all lengths, one after the other; 0.2 in the mean logarithm of the robust sds."""
    torque = excite(4.0, 0.6, seed=6)
    rng = np.random.default_rng(7)
    q = move(SMOOTH, SMOOTH_VALUES, torque).q + of_position * rng.standard_normal(torque.size)
    # slow, so that what it makes of a motion grows with the square of time
    slow = of_torque * np.sin(4.0 * PERIOD * np.arange(torque.size))
    parts = [prepare(q, torque + slow)]
    trajectories, observations = zip(*parts, strict=True)
    options = Estimation(substeps=1)
    problem = OutputError(SMOOTH, trajectories, observations, Knowledge(), options)
    assert problem.lengths() == (0.2, 0.5)
    estimate = output_error(SMOOTH, trajectories, observations, Knowledge(), options, START)
    fits = [problem.fit(AT, length) for length in problem.lengths()]
    sds = [[fit.information.sds(row)[1] for row in np.eye(3)] for fit in fits]
    # of directions that are orthogonal in the Jacobian; their product is the determinant's
    spreads = []
    for fit in fits:
        d = fit.information.directions
        spreads.append(np.mean([np.log(fit.information.sds(r / d.units)[1]) for r in d.rows]))
    best = int(spreads[1] < spreads[0] - 0.2)
    assert best == int(of_torque == 0.0)
    for j, name in enumerate(NAMES):
        assert estimate[name].sd_robust == pytest.approx(sds[best][j], rel=0.02)
        assert abs(estimate[name].value - fits[best].values[j]) < 0.1 * sds[best][j]
    assert estimate.n_outputs == fits[best].shooting.measured.size


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
    finer = shooting.sensitivities(at, states, steps, (1e-6, 1e-5))
    size = np.abs(finer.parameters).max()
    assert np.max(np.abs(inside.parameters - finer.parameters)) < 1e-4 * size


def test_states_act_on_their_own_segment_only(knee):
    shooting, states = knee
    derivatives = shooting.sensitivities(VALUES, states, np.zeros(VALUES.size), (1e-6, 1e-5))
    for k in range(4):
        for i, step in enumerate((1e-6, 1e-5)):
            sides = np.stack([states, states])
            sides[:, k, i] += (step, -step)
            there, back = shooting.positions(np.tile(VALUES, (2, 1)), sides)
            change = (there - back) / (2.0 * step)
            inside = shooting.segment_of == k
            assert not change[~inside].any()
            assert np.allclose(change[inside], derivatives.states[inside, i], atol=1e-9)
        first = np.flatnonzero(shooting.segment_of == k)[0]
        assert derivatives.states[first] == pytest.approx([1.0, 0.0], abs=1e-8)


def test_eliminating_states_is_fitting_them(knee):
    """Projected columns are the residuals of the states' own least squares, segment by segment."""
    shooting, states = knee
    derivatives = shooting.sensitivities(VALUES, states, 1e-5 * VALUES, (1e-6, 1e-5))
    projected, onto, eliminated = eliminate_states(
        shooting, derivatives.states, derivatives.parameters
    )
    for k in range(4):
        rows = shooting.segment_of == k
        fitted, *_ = np.linalg.lstsq(
            derivatives.states[rows], derivatives.parameters[rows], rcond=None
        )
        left = derivatives.parameters[rows] - derivatives.states[rows] @ fitted
        size = np.abs(derivatives.parameters[rows]).max()
        assert np.max(np.abs(projected[rows] - left)) < 1e-9 * size
        assert np.allclose(onto[k], fitted, rtol=1e-6, atol=1e-9 * np.abs(fitted).max())
    assert eliminated == 8


def test_a_joint_that_sticks_has_no_initial_speed_to_fit():
    """Far below breakaway the position stays what it was; its speed there says nothing."""
    torque = np.full(200, 0.01)
    # its differences are rounding, of which a dead zone leaves more or less from machine to machine
    trajectory, _ = prepare(np.full(200, 0.1), torque, dead_zone=0)
    shooting = Shooting(CHAIN, [trajectory], 1)
    states = np.array([[0.1, 0.0]])
    derivatives = shooting.sensitivities(VALUES, states, 1e-5 * VALUES, (1e-6, 1e-5))
    assert np.allclose(derivatives.states[:, 0], 1.0, atol=1e-9)
    # a speed v carries the joint no farther than v²/2a, a = 9 rad/s² and more
    assert np.abs(derivatives.states[:, 1]).max() < 1e-5 / 18.0
    projected, _, eliminated = eliminate_states(shooting, derivatives.states, np.ones((200, 1)))
    assert eliminated == 1
    assert np.abs(projected).max() < 1e-12


def test_substeps_are_as_few_as_the_encoder_allows(knee):
    shooting, states = knee
    substeps, error = choose_substeps(shooting, VALUES, states)
    finest = resolution(shooting.trajectories[0].position)
    assert error <= 0.01 * finest
    if substeps > 1:
        assert choose_substeps(shooting, VALUES, states, most=substeps // 2)[1] > 0.01 * finest
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
