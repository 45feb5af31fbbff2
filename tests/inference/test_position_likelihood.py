"""Position likelihood: exact where the joint is linear, calibrated where it is not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import null_space

from bayesfric.estimates.output_error import Shooting
from bayesfric.inference.likelihood.position_likelihood import PositionLikelihood
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.experiment import Simulation, record
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.presets import PRESETS
from bayesfric.mechanism.scaling import scalings
from bayesfric.recordings.measurement import Inputs
from bayesfric.recordings.trajectory import Trajectory

KNEE = PRESETS["rabbit-knee"]
PERIOD = 0.002
# inertia and viscous loss alone: position is linear in torque and state
LINEAR = Joint(elements=(Element("motor", inertia=True, viscous=True),), load=Load())
INERTIA, VISCOUS = 0.01, 0.2


def cut(position, torque, q0, qd0, segments, period=PERIOD):
    return Trajectory(
        "made-up",
        period * np.arange(position.size),
        position,
        torque,
        period,
        np.array(segments),
        q0,
        qd0,
        inputs=Inputs(),
    )


@pytest.fixture(scope="module")
def linear():
    """60 samples in two segments and, by superposition, how torque and state move them."""
    n = 60
    torque = np.sin(np.arange(n) * 0.3)
    segments = [(0, 30), (30, 60)]

    def response(u, state):
        # exact: q'' = (u - f q')/J with u linear between samples
        a, h = VISCOUS / INERTIA, PERIOD
        e = np.exp(-a * h)
        q, v = np.zeros(30), np.zeros(30)
        q[0], v[0] = state
        for i in range(29):
            u0, slope = u[i] / INERTIA, (u[i + 1] - u[i]) / INERTIA / h
            # particular solution of v' = -a v + u0 + slope t
            p0, p1 = u0 / a - slope / a**2, slope / a
            c = v[i] - p0
            v[i + 1] = c * e + p0 + p1 * h
            q[i + 1] = q[i] + c * (1 - e) / a + p0 * h + p1 * h**2 / 2
        return q

    by_torque = np.stack([response(row, (0.0, 0.0)) for row in np.eye(30)], axis=1)
    by_state = np.stack([response(np.zeros(30), s) for s in ((1.0, 0.0), (0.0, 1.0))], axis=1)
    simulated = np.concatenate([response(torque[a:b], (0.1, 0.3)) for a, b in segments])
    noise = 1e-3 * np.random.default_rng(3).standard_normal(n)
    t = cut(simulated + noise, torque, np.full(2, 0.1), np.full(2, 0.3), segments)
    return t, by_torque, by_state, noise


def test_density_is_that_of_the_normal_with_both_noises(linear):
    """A flat prior of the states leaves the combinations of positions they do not move."""
    t, by_torque, by_state, noise = linear
    values = np.array([[INERTIA, VISCOUS]])
    likelihood = PositionLikelihood(LINEAR, [t], [], values[0])
    scales = [(0.05, 1e-3), (0.5, 1e-4), (1e-3, 2e-3)]
    found = likelihood.log_density(np.repeat(values, 3, axis=0), np.array(scales)[:, None])
    expected = []
    for torque_sd, position_sd in scales:
        covariance = torque_sd**2 * by_torque @ by_torque.T + position_sd**2 * np.eye(30)
        free = null_space(by_state.T)
        normal = stats.multivariate_normal(cov=free.T @ covariance @ free)
        # the residuals are the noise, up to what the states take
        expected.append(sum(normal.logpdf(x @ free) for x in (noise[:30], noise[30:])))
    # Runge-Kutta at one step a sample errs by some 1e-9, which 1e-4 of noise sees
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_torque_moves_the_knee_as_whole_simulations_say(knee):
    """Carried on from sample to sample, through reversals: the same as simulated to the end."""
    chain, truth, likelihood = knee
    (run,) = likelihood._runs
    shooting, torque, step = run._shooting, run._trajectory.torque, 1e-4
    for sample in (700, 1250, 3010):
        moved = []
        for sign in (1.0, -1.0):
            other = torque.copy()
            other[sample] += sign * step
            one = Shooting(chain, [replace(run._trajectory, torque=other)], shooting.substeps)
            moved.append(one.positions(truth[None], run._states)[0])
        change = (moved[0] - moved[1]) / (2.0 * step)
        k, j = divmod(sample, 500)
        expected = change[500 * k : 500 * (k + 1)].reshape(-1, run._factor).mean(axis=1)
        found = run._by_torque(truth)[k][:, j]
        np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def test_information_of_the_noise_scales(linear):
    """Of one scale alone it is two for every term; the two share what both explain."""
    likelihood = PositionLikelihood(LINEAR, [linear[0]], [], np.array([INERTIA, VISCOUS]))
    n = 56
    only_position = likelihood.noise_information(np.array([[1e-9, 1e-3]]))[0]
    assert only_position[1, 1] == pytest.approx(2.0 * n / 1e-3**2)
    assert only_position[0, 0] * 1e-9**2 < 1e-6
    scales = np.array([[0.05, 1e-3]])
    both = likelihood.noise_information(scales)[0] * np.outer(scales, scales)
    # a common factor on both scales is one scale of everything
    assert np.ones(2) @ both @ np.ones(2) == pytest.approx(2.0 * n)


def test_predictions_lie_within_their_noise(linear):
    t = linear[0]
    likelihood = PositionLikelihood(LINEAR, [t], [], np.array([INERTIA, VISCOUS]))
    (sd,) = likelihood.noise_sd(np.array([[1e-9, 1e-3]]))
    # of 60 residuals with equal variance two states a segment are taken off
    assert np.sum(sd**2) == pytest.approx(56 * 1e-6, rel=1e-6)
    (drawn,) = likelihood.draw_noise(
        np.tile([[[0.05, 1e-3]]], (4000, 1, 1)), np.random.default_rng(0)
    )
    (expected,) = likelihood.noise_sd(np.array([[0.05, 1e-3]]))
    # relative error of a sd from n draws: 1/sqrt(2n); five of them over 60 outputs
    np.testing.assert_allclose(drawn.std(axis=0), expected, rtol=5.0 / np.sqrt(8000))


@pytest.fixture(scope="module")
def knee():
    """4 s of the simulated knee with torque and encoder noise, cut every 0.5 s."""
    chain = KNEE.chain()
    columns, motion, values = record(chain, Simulation(duration=4.0, excitation="square-multisine"))
    n = motion.q.size
    starts = np.arange(0, n, 500)
    t = Trajectory(
        "knee",
        columns["time"],
        columns["position"] / chain.ratio,
        columns["torque"],
        1e-3,
        np.stack([starts, starts + 500], axis=1),
        motion.q[starts],
        motion.qd[starts],
        inputs=Inputs(),
    )
    return chain, chain.vector(values), PositionLikelihood(chain, [t], [], chain.vector(values))


def test_at_the_truth_the_terms_are_standard_normal(knee):
    chain, truth, likelihood = knee
    # torque noise as simulated; the encoder's quantisation, 8192 counts on the motor shaft
    count = 2.0 * np.pi / 8192 / chain.ratio
    scales = np.array([[0.02, count / np.sqrt(12.0)]])
    (z,) = likelihood.pointwise(truth[None], scales[None])
    (sd,) = (np.sqrt(run.variances(scales)) for run in likelihood._runs)
    square = -2.0 * (z + np.log(sd) + 0.5 * np.log(2.0 * np.pi))
    # mean of n squares of standard normals: sd sqrt(2/n)
    assert square.mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / square.size))


def test_nothing_changes_along_the_scaling(knee):
    chain, truth, likelihood = knee
    (scaling,) = scalings(chain)
    low, high = scaling.bounds(truth)
    vectors = scaling.scaled(truth, np.linspace(low, high, 7)[1:-1])
    density = likelihood.log_density(vectors, np.tile([[[0.02, 1e-5]]], (5, 1, 1)))
    np.testing.assert_allclose(density, density[0], rtol=1e-9)


def test_what_cannot_be_simulated_is_impossible(knee):
    chain, truth, likelihood = knee
    bad = truth.copy()
    bad[chain.names.index("gearbox.load_back")] = 50.0
    density = likelihood.log_density(np.stack([truth, bad]), np.tile([[[0.02, 1e-5]]], (2, 1, 1)))
    assert np.isfinite(density[0])
    assert density[1] == -np.inf
