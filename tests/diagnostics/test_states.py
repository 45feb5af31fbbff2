"""States that a motion leaves behind, against what they are in closed form."""

import numpy as np
import pytest

from bayesfric.diagnostics.states import deflection, in_gap, resonating, since_reversal


def test_a_bristle_bends_exponentially_and_turns_about():
    q = np.linspace(0.0, 1.0, 1001)
    z = deflection(q, 0.2)
    np.testing.assert_allclose(z, 1.0 - np.exp(-q / 0.2), atol=1e-12)
    back = deflection(np.concatenate([q, q[::-1]]), 0.2)
    gone = np.exp(-1.0 / 0.2)
    assert back[-1] == pytest.approx(-1.0 + (2.0 - gone) * gone, abs=1e-12)


def test_distance_is_counted_from_the_last_reversal_that_is_one():
    q = np.concatenate([np.linspace(0, 1, 101), np.linspace(0.99, 0.2, 80)])
    q[50] += 1e-4  # a step of the encoder turns nothing
    found = since_reversal(q, 1e-2)
    assert found[100] == pytest.approx(1.0)
    assert found[-1] == pytest.approx(0.8)


def test_a_load_crosses_its_gap_in_the_time_of_a_free_fall():
    period, half, pull = 1e-4, 0.002, 3.0
    need = np.full(4000, -pull)
    need[:1000] = pull
    begins = np.zeros(4000, dtype=bool)
    begins[0] = True
    place = in_gap(need, period, half, begins)
    assert (place[:1000] == 1.0).all()
    flight = np.flatnonzero(place == -1.0)[0] - 1000
    assert flight * period == pytest.approx(np.sqrt(4.0 * half / pull), abs=2 * period)


def test_an_elastic_transmission_adds_what_a_two_mass_drive_does():
    t = np.arange(4000) / 1000.0
    x = np.sin(2 * np.pi * 5.0 * t)
    (more,) = resonating(x, ((0, 4000),), 1e-3, [25.0])
    middle = slice(1000, 3000)
    gain = (more[middle] @ x[middle]) / (x[middle] @ x[middle])
    r = 5.0 / 25.0
    exact = np.real(1.0 / (1.0 - r**2 + 0.1j * r)) - 1.0
    assert gain == pytest.approx(exact, rel=0.02)
