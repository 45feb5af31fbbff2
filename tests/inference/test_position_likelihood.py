"""Position likelihood of the simulated knee; a linear joint is in test_likelihood_dense."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.estimates.output_error import Shooting
from bayesfric.estimates.trajectory import Trajectory
from bayesfric.inference.position_likelihood import PositionLikelihood
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.experiment import Simulation, record
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.mechanism.own_term import Term
from bayesfric.mechanism.scaling import scalings
from bayesfric.recordings.measurement import Inputs

KNEE = PRESETS["rabbit-knee"]


def assert_derivative(chain, point, likelihood, segment, sample, step):
    """Carried on from sample to sample, it is that of whole simulations."""
    (run,) = likelihood._runs
    start, borders = run._trajectory.segments[segment, 0], run._shooting.borders
    moved = []
    for change in (step, -step):
        torque = run._trajectory.torque.copy()
        torque[start + sample] += change
        shooting = Shooting(chain, [replace(run._trajectory, torque=torque)], run.substeps)
        moved.append(shooting.positions(point[None], run._states)[0])
    change = ((moved[0] - moved[1]) / (2.0 * step))[borders[segment] : borders[segment + 1]]
    expected = change.reshape(-1, run._factor).mean(axis=1)
    derivative = run._by_torque(point)[segment][:, sample]
    np.testing.assert_allclose(derivative, expected, atol=1e-5 * np.abs(expected).max())


def test_torque_moves_a_joint_through_reversals_as_whole_simulations_say(knee):
    for sample in (700, 1250, 3010):
        assert_derivative(*knee, *divmod(sample, 500), 1e-4)


def test_torque_moves_a_joint_whose_losses_change_with_time_as_whole_simulations_say():
    term = Term("motor.flicker", lambda m: m.speed * (1.0 + np.sin(700.0 * m.time)), "N m s")
    chain = Joint((Element("motor", inertia=True),), Load()).with_term(term)
    point = chain.vector({"motor.inertia": 0.01, "motor.flicker": 1.0})
    time = 1.0 + 0.002 * np.arange(68)
    torque, state = np.sin(0.3 * np.arange(68)), (np.array([0.11]), np.array([0.25]))
    position = 0.11 + 0.25 * (time - time[3])
    segments = np.array([(3, 63)])
    t = Trajectory(
        "t", time, position, torque, 0.002, segments, *state, inputs=Inputs(), hold="linear"
    )
    likelihood = PositionLikelihood(chain, [t], [], point)
    for sample in (0, 1, 20, 58):
        assert_derivative(chain, point, likelihood, 0, sample, 1e-3)


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
