"""What a simulated bench records: commanded, lagged, moved, read and noisy, each by its formula."""

import numpy as np
import pytest
from scipy.signal import chirp

from bayesfric.base.errors import BadInput
from bayesfric.mechanism import experiment
from bayesfric.mechanism.experiment import Simulation, record
from bayesfric.mechanism.forward import simulate
from bayesfric.recordings.measurement import Inputs
from tests.mechanism.joints import GEARED, KNEE, LIGHT

EXACT = {"encoder_counts": 0, "torque_noise": 0.0, "lag": 0.0, "parameters": LIGHT}


def recorded(**options):
    return record(GEARED, Simulation(**EXACT | {"duration": 4.0, "rate": 500.0} | options))


@pytest.mark.parametrize("frequency", [0.1, 0.7, 1.0, 2.5, 12.5])
def test_square_switches_where_rounding_could_move_a_sample(frequency):
    samples = np.arange(round(2 / frequency * 1000))
    exact = (2 * samples * round(frequency * 10) // 10_000) % 2
    wave = experiment.square(samples * 1e-3, 0.8, frequency)
    np.testing.assert_array_equal(wave, np.where(exact == 0, 0.8, -0.8))


def test_current_loop_is_exact_for_a_held_command():
    time, period, lag = np.arange(4001) * 1e-3, 1e-3, 5e-3
    command = np.where(time < 2.0, 0.8, -0.8)
    actual = experiment.current_loop(command, period, lag)
    rise = 0.8 * -np.expm1(-time / lag)
    fall = -0.8 + 1.6 * np.exp(-(time - 2.0) / lag)
    np.testing.assert_allclose(actual, np.where(time <= 2.0, rise, fall), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(experiment.current_loop(command, period, 0.0), command)


def test_sines_and_chirps_have_their_phases():
    time = np.arange(1000) * 1e-3
    sine = experiment.sine(time, 2.0, 3.0, 0.4)
    np.testing.assert_allclose(sine, 2.0 * np.sin(6.0 * np.pi * time + 0.4), atol=1e-12)
    # Schroeder: -pi k (k + 1)/n
    lines = np.fft.rfft(experiment.multisine(time, 1.0, [1.0, 2.0, 3.0]))[[1, 2, 3]]
    expected = -np.pi * np.array([0.0, 2.0, 6.0]) / 3.0 - np.pi / 2.0
    np.testing.assert_allclose(lines / np.abs(lines), np.exp(1j * expected), atol=1e-9)
    # a chirp begins at the first stamp
    expected = chirp(time, 6.0, time[-1], 0.5, phi=-90)
    np.testing.assert_allclose(experiment.chirp(2.5 + time, 1.0, 6.0, 0.5), expected, atol=1e-9)


@pytest.mark.parametrize("kind", ["square", "sine", "multisine", "chirp", "square-multisine"])
def test_a_command_is_that_of_its_formula(kind):
    """Of k sines each has the amplitude over the root of k, at any phase."""
    hertz = (0.5, 1.25, 3.0)
    columns, _, _ = recorded(excitation=kind, amplitude=0.3, frequency=1.0, frequencies=hertz)
    time, torque = columns["time"], columns["torque"]
    np.testing.assert_allclose(time, np.arange(2000) / 500.0)
    turns = time % 1.0
    waves = {
        "square": np.where(turns < 0.5 - 1e-9, 0.3, -0.3),
        "sine": 0.3 * np.sin(2.0 * np.pi * time),
        "chirp": 0.3 * chirp(time, 0.5, time[-1], 3.0, phi=-90),
    }
    if kind in waves:
        np.testing.assert_allclose(torque, waves[kind], atol=1e-9)
        return
    left = torque - (waves["square"] if "square" in kind else 0.0)
    lines = 2.0 * np.abs(np.fft.rfft(left)) / left.size
    expected = np.zeros_like(lines)
    expected[[2, 5, 12]] = 0.3 / np.sqrt(3.0)
    np.testing.assert_allclose(lines, expected, atol=1e-12)


def test_a_recording_is_moved_by_what_its_current_loop_makes_of_the_command():
    options = {"lag": 0.02, "added_mass": 0.4, "radius": 0.3, "hold": "zero", "amplitude": 0.3}
    columns, motion, values = recorded(**options)
    command = experiment.square(columns["time"], 0.3, 1.0)
    expected = experiment.current_loop(command, 1.0 / 500.0, 0.02)
    np.testing.assert_allclose(columns["torque"], expected, atol=1e-15)
    assert values == LIGHT
    inputs = Inputs(0.4, 0.3)
    vector = GEARED.vector(LIGHT)
    alone = simulate(GEARED, vector, expected, 1.0 / 500.0, inputs=inputs, hold="zero")
    np.testing.assert_array_equal(motion.q, alone.q)


@pytest.mark.parametrize(("side", "ratio"), [("motor", 5.0), ("joint", 1.0)])
def test_an_encoder_rounds_to_its_counts(side, ratio):
    columns, motion, _ = recorded(encoder_counts=500, encoder_side=side)
    counts = columns["position"] / (2.0 * np.pi / 500)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    off = columns["position"] - ratio * motion.q
    assert np.abs(off).max() <= np.pi / 500 + 1e-12
    assert len(np.unique(np.round(counts))) > 20


def test_noise_is_white_of_the_sd_asked_for_and_not_what_moves_the_joint():
    quiet, motion, _ = recorded(excitation="multisine", seed=4)
    noisy, same, _ = recorded(excitation="multisine", seed=4, torque_noise=0.05)
    again, _, _ = recorded(excitation="multisine", seed=4, torque_noise=0.05)
    other, moved, _ = recorded(excitation="multisine", seed=5, torque_noise=0.05)
    np.testing.assert_array_equal(motion.q, same.q)
    np.testing.assert_array_equal(noisy["torque"], again["torque"])
    assert np.abs(motion.q - moved.q).max() > 0.01
    noise = noisy["torque"] - quiet["torque"]
    # relative error of a sd from n: 1/sqrt(2n); of a correlation 1/sqrt(n)
    n = noise.size
    assert noise.std() == pytest.approx(0.05, rel=4.0 / np.sqrt(2.0 * n))
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 4.0 / np.sqrt(n)
    of_other_seed = other["torque"] - recorded(excitation="multisine", seed=5)[0]["torque"]
    assert abs(np.corrcoef(noise, of_other_seed)[0, 1]) < 4.0 / np.sqrt(n)


def test_true_values_are_the_preset_s_but_for_what_is_said():
    chain = KNEE.chain()
    values = Simulation(parameters={"joint.viscous": 1.0}).true_values(chain)
    assert values == KNEE.values | {"joint.viscous": 1.0}
    assert tuple(values) == chain.names
    for parameters, match in (
        ({"joint.viscos": 1.0}, "no such parameter"),
        ({"joint.viscous": -1.0}, "not a possible value"),
        ({"joint.viscous": np.inf}, "not a possible value"),
    ):
        with pytest.raises(BadInput, match=match):
            Simulation(parameters=parameters).true_values(chain)
    with pytest.raises(BadInput, match="has no value"):
        Simulation().true_values(GEARED)
    # at the ends of a support values are possible
    edge = Simulation(parameters=LIGHT | {"motor.viscous": 0.0})
    assert edge.true_values(GEARED)["motor.viscous"] == 0.0
    assert record(GEARED, Simulation(**EXACT | {"duration": 0.01}))[1].q.size == 10
    with pytest.raises(BadInput, match="fewer than 10"):
        recorded(duration=0.009, rate=1000.0)
    with pytest.raises(BadInput, match="runs away"):
        recorded(amplitude=1e9)
