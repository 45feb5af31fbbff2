"""Output error, section 4.3: exact recovery, honest sds, and against SciPy's algorithms."""

import dataclasses
import time

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares as scipy_least_squares

from bayesfric.base.errors import BadInput
from bayesfric.estimates.input_error import few_threads
from bayesfric.estimates.output_error import (
    OutputError,
    Shooting,
    choose_substeps,
    eliminate_states,
    output_error,
    resolution,
    segment_length,
)
from bayesfric.estimates.point_estimate import Estimate, Estimation, Knowledge
from bayesfric.estimates.trajectory import trajectory
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.experiment import multisine, square
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.mechanism.scaling import scalings
from bayesfric.recordings.measurement import Inputs
from bayesfric.recordings.signals import observe
from bayesfric.recordings.source import Processing
from tests.conftest import made_recording

PERIOD = 2e-3


def excite(seconds, amplitude, seed=3):
    """Square wave and multisine: everything a joint has shows in its motion."""
    stamps = np.arange(round(seconds / PERIOD)) * PERIOD
    lines = multisine(stamps, 0.45 * amplitude, (0.3, 0.7, 1.3, 2.9, 5.3), seed=seed)
    return square(stamps, amplitude, 1.0) + lines


def move(chain, values, torque):
    return simulate(chain, chain.vector(values), torque, PERIOD, substeps=1)


def prepare(position, torque, length=np.inf, name="made-up", **keys):
    stamps = np.arange(position.size) * PERIOD
    recording = made_recording(
        stamps, position, torque, PERIOD, name=name, inputs=Inputs(0.0, 0.0, name)
    )
    observation = observe(recording, Processing(**keys))
    return trajectory(recording, observation, length), observation


# torque that moves each joint well, s of it
SETTINGS = {"rabbit-knee": (4.0, 0.8), "motor-axis": (2.0, 0.5), "servo-pendulum": (3.0, 0.15)}


@pytest.fixture(autouse=True)
def few():
    with few_threads([]):
        yield


def start(chain, values, off=0.0, seed=0):
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], len(chain.names))
    point = tuple((n, values[n] * (1.0 + off * s)) for n, s in zip(chain.names, signs, strict=True))
    return Estimate("input-error", (), 0.0, 1, "", point=point)


def simulated(preset):
    chain, values = PRESETS[preset].chain(), PRESETS[preset].values
    seconds, amplitude = SETTINGS[preset]
    torque = excite(seconds, amplitude)
    return chain, values, torque, move(chain, values, torque).q


def fitted(chain, begin, parts, knowledge=None, **options):
    """Output error of what :func:`prepare` made, one recording or several, from a start."""
    (trajectories, observations), known = zip(*parts, strict=True), knowledge or Knowledge()
    return output_error(chain, trajectories, observations, known, Estimation(**options), begin)


@pytest.mark.parametrize("preset", SETTINGS)
def test_exact_recovery_from_twenty_per_cent_off(preset):
    chain, values, torque, q = simulated(preset)
    known = ["load.first_moment"] if preset == "rabbit-knee" else []
    knowledge = Knowledge(fixed={n: values[n] for n in known})
    begin = start(chain, values, 0.2)
    estimate = fitted(chain, begin, [prepare(q, torque)], knowledge, substeps=1, segment=0.2)
    assert estimate.residual_unit == "rad"
    assert estimate.residual_rms < 1e-8
    assert dict(estimate.point) == pytest.approx(values, rel=1e-6)
    assert all(estimate[name].determined for name in set(chain.names) - set(known))


def test_what_a_scaling_leaves_open_has_no_sd():
    chain, values, torque, q = simulated("rabbit-knee")
    begin = start(chain, values, 0.1)
    estimate = fitted(chain, begin, [prepare(q, torque)], substeps=1, segment=0.2)
    (scaling,) = scalings(chain)
    for name in scaling.names:
        assert np.isinf(estimate[name].sd), name
        assert np.isinf(estimate[name].sd_robust), name
        assert estimate[name].span is not None
    for name in set(chain.names) - set(scaling.names):
        assert estimate[name].value == pytest.approx(values[name], rel=1e-6), name
        assert estimate[name].determined, name
    lambdas = [(2 + a - b) / (a + b) for a, b in [(values[scaling.drive], values[scaling.back])]]
    assert estimate["gearbox.lambda_ratio"].value == pytest.approx(lambdas[0], rel=1e-6)
    # the vector stands where alpha_1 alpha_2 = 1, in the middle of what a passive gearbox allows
    point = dict(estimate.point)
    assert (1 + point[scaling.drive]) * (1 - point[scaling.back]) == pytest.approx(1.0, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("of_position", "of_torque"), [(1e-4, 0.0), (0.0, 0.005)])
def test_the_robust_sd_is_right_for_noise_of_either(of_position, of_torque):
    """Integrated noise of the torque makes the sd for white residuals several times too small."""
    chain, values, torque, q = simulated("motor-axis")
    repeats, numbers = 60, []
    for seed in range(repeats):
        rng = np.random.default_rng(seed)
        noise = rng.standard_normal((2, q.size)) * [[of_position], [of_torque]]
        parts = [prepare(q + noise[0], torque + noise[1])]
        estimate = fitted(chain, start(chain, values), parts, substeps=1, segment=0.1)
        numbers.append([(v.value, v.sd, v.sd_robust) for v in estimate.parameters])
    value, plain, robust = np.moveaxis(numbers, 2, 0)
    spread = value.std(axis=0, ddof=1)
    # a spread from n repeats has the relative error 1/sqrt(2(n - 1))
    error = 5.0 / np.sqrt(2.0 * (repeats - 1))
    assert np.all(np.abs(np.sqrt((robust**2).mean(axis=0)) / spread - 1.0) < error)
    if of_torque:
        assert np.all(plain.mean(axis=0) < 0.33 * spread)
    else:
        assert np.all(np.abs(plain.mean(axis=0) / spread - 1.0) < error)
        off = np.abs(value.mean(axis=0) - chain.vector(values))
        assert np.all(off < 5.0 * spread / np.sqrt(repeats))


def test_a_prior_settles_what_the_scaling_leaves_open():
    chain, values, torque, q = simulated("rabbit-knee")
    rng = np.random.default_rng(1)
    parts = [prepare(q + 1e-5 * rng.standard_normal(q.size), torque)]
    knowledge = Knowledge(priors={"load.first_moment": (0.42, 0.021)})
    estimate = fitted(chain, start(chain, values, 0.02), parts, knowledge, substeps=1, segment=0.2)
    assert estimate["load.first_moment"].value == pytest.approx(0.42, rel=1e-4)
    # nothing but the prior knows the scale
    assert estimate["load.first_moment"].sd == pytest.approx(0.021, rel=0.01)


@pytest.mark.parametrize("times", [1.0, 2.0])
def test_another_minimum_than_the_torques_is_reported(times):
    """A motion of twice the inertia, whose torque is not the recorded one."""
    chain, values, torque, q = simulated("motor-axis")
    heavy = values | {"motor.inertia": times * values["motor.inertia"]}
    (trajectory, _), (_, observation) = (
        prepare(x, torque) for x in (move(chain, heavy, torque).q, q)
    )
    parts = [(trajectory, observation)]
    estimate = fitted(chain, start(chain, values), parts, substeps=1, segment=0.2)
    assert ("ANOTHER MINIMUM" in estimate.notes[0]) == (times > 1.0)


def test_what_cannot_be_simulated_is_refused():
    chain, values, torque, q = simulated("motor-axis")
    trajectory, observation = prepare(q, torque)
    mad = dataclasses.replace(trajectory, torque=np.full_like(torque, 1e12))
    with pytest.raises(BadInput, match="cannot be simulated"):
        fitted(chain, start(chain, values), [(mad, observation)])
    massless = Joint((Element("motor", coulomb="symmetric", viscous=True),))
    with pytest.raises(BadInput, match="no inertia"):
        fitted(massless, start(massless, values), [prepare(q, torque)])


def test_at_its_time_limit_it_gives_the_best_so_far_marked():
    chain, values, torque, q = simulated("motor-axis")
    parts, begin = [prepare(q, torque)], start(chain, values, 0.2)
    for seconds in (1e-9, 0.02):
        began = time.process_time()
        estimate = fitted(chain, begin, parts, max_seconds=seconds)
        assert time.process_time() - began < 5.0
        assert not estimate.converged
        assert "NOT CONVERGED" in estimate.notes[0]
        assert "estimation.max_seconds" in estimate.notes[0]
        assert not any(value.determined for value in estimate.values)
        assert set(dict(estimate.point)) == set(chain.names)
    assert fitted(chain, begin, parts).converged


# --- multiple shooting ----------------------------------------------------------------


KNEE = PRESETS["rabbit-knee"]
CHAIN = KNEE.chain()
VALUES = CHAIN.vector(KNEE.values)
# smooth, so that SciPy follows it: inertia, viscous loss, gravity
SMOOTH = Joint((Element("motor", inertia=True, viscous=True),), Load(first_moment=True))
SMOOTH_VALUES = {"motor.inertia": 0.02, "motor.viscous": 0.1, "load.first_moment": 0.05}
AT = SMOOTH.vector(SMOOTH_VALUES)
NAMES = SMOOTH.names


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


def test_positions_and_derivatives_are_those_of_scipy_s_integrator():
    trajectories = [t for t, _ in PARTS]
    shooting = Shooting(SMOOTH, trajectories, 4)
    states = np.array([[0.02, 0.1], [-0.3, 0.4]])
    positions, by_parameter, by_state = shooting.sensitivities(AT, states, 1e-5 * AT, (1e-5, 1e-4))
    steps = 1e-4 * AT
    for k, t in enumerate(trajectories):
        rows = shooting.segment_of == k
        exact = moves(t.torque, AT, states[k])
        np.testing.assert_allclose(positions[rows], exact, atol=1e-8)
        for j in range(3):
            sides = [moves(t.torque, AT + s * steps * np.eye(3)[j], states[k]) for s in (1, -1)]
            slope = (sides[0] - sides[1]) / (2.0 * steps[j])
            np.testing.assert_allclose(
                by_parameter[rows, j], slope, atol=2e-4 * np.abs(slope).max()
            )
        for i in range(2):
            sides = [moves(t.torque, AT, states[k] + s * 1e-3 * np.eye(2)[i]) for s in (1, -1)]
            np.testing.assert_allclose(
                by_state[rows, i], (sides[0] - sides[1]) / 2e-3, rtol=1e-4, atol=1e-6
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
    fit = OutputError(SMOOTH, *zip(PARTS[0], strict=True), knowledge, options)
    begin = dict(zip(NAMES, 1.2 * AT, strict=True)) | knowledge.fixed
    assert fit.fit(SMOOTH.vector(begin))
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
    fit = OutputError(SMOOTH, *zip(*PARTS, strict=True), Knowledge(), options)
    assert fit.fit(AT)
    recording = fit.shooting.recording_of
    sizes = np.array([np.sqrt(np.mean(fit.residual[recording == k] ** 2)) for k in (0, 1)])
    weights = fit.weights * sizes[recording]
    np.testing.assert_allclose(weights / weights[0], 1.0, rtol=1e-2)


@pytest.mark.parametrize(("n_parameters", "length"), [(1, 0.4), (3, 0.8 / 6.0), (20, 40 * PERIOD)])
def test_segments_are_two_a_parameter_and_of_forty_samples(n_parameters, length):
    assert segment_length([t for t, _ in PARTS], n_parameters) == pytest.approx(length)
    assert segment_length([t for t, _ in [*PARTS, *PARTS]], 1) == 0.5


@pytest.fixture(scope="module")
def knee():
    torque = excite(2.0, 0.8)
    motion = move(CHAIN, KNEE.values, torque)
    trajectory, _ = prepare(motion.q, torque, 0.5)
    starts = trajectory.segments[:, 0]
    return Shooting(CHAIN, [trajectory], 1), np.stack([motion.q[starts], motion.qd[starts]], 1)


def test_one_sided_differences_stay_within_the_limits(knee):
    shooting, states = knee
    at = VALUES.copy()
    name = CHAIN.names.index("joint.viscous")
    at[name] = 0.0
    steps = np.zeros(at.size)
    steps[name] = 1e-5
    _, inside, _ = shooting.sensitivities(at, states, steps, (1e-6, 1e-5))
    assert np.isfinite(inside).all()
    steps[name] = 1e-6
    _, finer, _ = shooting.sensitivities(at, states, steps, (1e-6, 1e-5))
    assert np.max(np.abs(inside - finer)) < 1e-4 * np.abs(finer).max()


def test_a_joint_that_sticks_has_no_initial_speed_to_fit():
    """Far below breakaway the position stays what it was; its speed there says nothing."""
    torque = np.full(200, 0.01)
    # its differences are rounding, of which a dead zone leaves more or less from machine to machine
    trajectory, _ = prepare(np.full(200, 0.1), torque, dead_zone=0)
    shooting = Shooting(CHAIN, [trajectory], 1)
    states = np.array([[0.1, 0.0]])
    _, _, by_state = shooting.sensitivities(VALUES, states, 1e-5 * VALUES, (1e-6, 1e-5))
    assert np.allclose(by_state[:, 0], 1.0, atol=1e-9)
    # a speed v carries the joint no farther than v²/2a, a = 9 rad/s² and more
    assert np.abs(by_state[:, 1]).max() < 1e-5 / 18.0
    projected, _, eliminated = eliminate_states(shooting, by_state, np.ones((200, 1)))
    assert eliminated == 1
    assert np.abs(projected).max() < 1e-12


def test_substeps_are_as_few_as_the_encoder_allows(knee):
    shooting, states = knee
    substeps, error = choose_substeps(shooting, VALUES, states)
    finest = resolution(shooting.trajectories[0].position)
    assert error <= 0.01 * finest
    if substeps > 1:
        assert choose_substeps(shooting, VALUES, states, max_count=substeps // 2)[1] > 0.01 * finest
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
