from typing import get_args

import numpy as np
import pytest

from bayesfric.mechanism import experiment
from bayesfric.mechanism.experiment import Simulation, record
from bayesfric.mechanism.joint import PRESETS

TIME = np.arange(4001) * 1e-3


def test_square_has_its_half_periods_to_the_sample():
    torque = experiment.square(np.arange(2000) * 1e-3, 0.8, 1.0)
    np.testing.assert_array_equal(torque, np.repeat([0.8, -0.8, 0.8, -0.8], 500))


@pytest.mark.parametrize("frequency", [0.1, 0.7, 2.5, 12.5])
def test_square_switches_where_rounding_could_move_a_sample(frequency):
    samples = np.arange(round(2 / frequency * 1000))
    exact = (2 * samples * round(frequency * 10) // 10_000) % 2
    np.testing.assert_array_equal(
        experiment.square(samples * 1e-3, 1.0, frequency), np.where(exact == 0, 1.0, -1.0)
    )


@pytest.mark.parametrize("name", get_args(Simulation.model_fields["excitation"].annotation))
def test_every_excitation_moves_a_joint(name):
    """And takes no torque far beyond what was asked for."""
    chain = PRESETS["motor-axis"].chain()
    columns, motion, _ = record(chain, Simulation(excitation=name, duration=1.0, torque_noise=0.0))
    assert np.ptp(motion.q) > 0.01
    assert 0.0 < np.abs(columns["torque"]).max() < 3.0 * Simulation().amplitude


@pytest.mark.parametrize("seed", [None, 7])
def test_multisine_has_the_lines_asked_for(seed):
    hertz = np.array([1.0, 2.0, 3.0, 5.0])
    amplitude = np.array([0.1, 0.2, 0.3, 0.4])
    torque = experiment.multisine(TIME[:-1], amplitude, hertz, seed=seed)
    lines = 2 * np.abs(np.fft.rfft(torque)) / torque.size
    expected = np.zeros_like(lines)
    expected[(hertz * 4).astype(int)] = amplitude
    np.testing.assert_allclose(lines, expected, atol=1e-13)


def test_schroeder_phases_keep_the_peak_low():
    hertz = np.arange(1, 21) * 0.25
    schroeder = np.abs(experiment.multisine(TIME, 1.0, hertz)).max()
    assert schroeder < 2.0 * np.sqrt(20 / 2)
    assert np.abs(experiment.multisine(TIME, 1.0, hertz, seed=1)).max() > schroeder


def test_chirp_turns_as_often_as_its_mean_frequency_says():
    torque = experiment.chirp(TIME, 1.0, 1.0, 9.0)
    assert np.sum((torque[:-2] < 0) & (torque[1:-1] >= 0)) == 4 * 5 - 1
    assert experiment.chirp([0.0], 1.0, 1.0, 2.0) == 0.0


def test_current_loop_is_exact_for_a_held_command():
    period, lag = 1e-3, 5e-3
    command = np.where(TIME < 2.0, 0.8, -0.8)
    actual = experiment.current_loop(command, period, lag)
    rise = 0.8 * -np.expm1(-TIME / lag)
    fall = -0.8 + 1.6 * np.exp(-(TIME - 2.0) / lag)
    np.testing.assert_allclose(actual, np.where(TIME <= 2.0, rise, fall), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(experiment.current_loop(command, period, 0.0), command)
    with pytest.raises(ValueError, match="lag"):
        experiment.current_loop(command, period, -1.0)
