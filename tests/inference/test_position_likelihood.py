"""Position likelihood of the simulated knee; a linear joint is in test_likelihood_dense."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.estimates.output_error import Shooting
from bayesfric.inference.position_likelihood import PositionLikelihood
from bayesfric.mechanism.experiment import Simulation, record
from bayesfric.mechanism.joint import PRESETS
from bayesfric.mechanism.scaling import scalings
from bayesfric.recordings.measurement import Inputs
from bayesfric.recordings.trajectory import Trajectory

KNEE = PRESETS["rabbit-knee"]


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
            moved_to = replace(run._trajectory, torque=other)
            simulated = Shooting(chain, [moved_to], shooting.substeps)
            moved.append(simulated.positions(truth[None], run._states)[0])
        change = (moved[0] - moved[1]) / (2.0 * step)
        k, j = divmod(sample, 500)
        expected = change[500 * k : 500 * (k + 1)].reshape(-1, run._factor).mean(axis=1)
        derivative = run._by_torque(truth)[k][:, j]
        np.testing.assert_allclose(derivative, expected, atol=1e-5 * np.abs(expected).max())


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
