"""Coordinates: round trips, Jacobians against finite differences, bounds."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import stats

from bayesfric.inference.coordinates import BoundedCoordinates

INF = math.inf


def numeric_log_determinant(mapped, u, step=1e-6):
    """Of a map's Jacobian, by differences over so much of each coordinate."""
    jacobian = np.empty((u.size, u.size))
    for i in range(u.size):
        h = step * max(abs(u[i]), 1e-2)
        beside = np.stack([u, u])
        beside[0, i] += h
        beside[1, i] -= h
        high, low = mapped(beside)[0]
        jacobian[:, i] = (high - low) / (2 * h)
    return np.linalg.slogdet(jacobian)[1]


widths = st.lists(st.floats(0.01, 20.0), min_size=4, max_size=4)


@settings(max_examples=60, deadline=None)
# four sds out a place is 4e-5 widths from its bound: further, differences lose its last digits
@given(st.one_of(st.none(), widths), st.lists(st.floats(-4.0, 4.0), min_size=4, max_size=4))
def test_bounded_coordinates_invert_and_their_jacobian_is_right(given_widths, u):
    coordinates = BoundedCoordinates(
        [0.0, -1.0, -INF, -INF],
        [INF, 2.0, INF, 5.0],
        None if given_widths is None else np.array(given_widths),
    )
    u = np.array(u)
    x, jacobian = coordinates.to_parameters(u[None])
    if given_widths is not None:
        assume(np.isfinite(jacobian[0]))
    np.testing.assert_allclose(coordinates.from_parameters(x)[0], u, rtol=1e-6, atol=1e-6)
    # five sds out a shorter step would be lost in rounding: 2e-16 over a slope of 5e-6
    numeric = numeric_log_determinant(coordinates.to_parameters, u, step=1e-4)
    assert jacobian[0] == pytest.approx(numeric, abs=1e-5)
    assert x[0, 0] > 0.0
    assert x[0, 1] > -1.0
    assert x[0, 3] < 5.0


def test_with_widths_a_parameter_is_its_own_coordinate_and_the_bound_cuts_it():
    coordinates = BoundedCoordinates([0.0, -INF], [INF, 5.0], np.array([0.1, 2.0]))
    x = np.array([[3.0, -2.0], [1e-9, 4.9], [-1e-9, 1.0], [1.0, 5.1]])
    parameters, slope = coordinates.to_parameters(x)
    np.testing.assert_array_equal(parameters, x)
    assert slope.tolist() == [0.0, 0.0, -INF, -INF]
    np.testing.assert_array_equal(coordinates.from_parameters(x[:2]), x[:2])
    # of an unknown width it is the logarithm of the distance
    unknown = BoundedCoordinates([0.0, -INF], [INF, 5.0], np.array([np.nan, 2.0]))
    np.testing.assert_array_equal(
        unknown.from_parameters(x[:2]), np.column_stack([np.log(x[:2, 0]), x[:2, 1]])
    )


def test_a_uniform_share_between_two_bounds_is_a_standard_normal_coordinate():
    """What the prior alone says of a parameter between bounds: no long tail at either."""
    coordinates = BoundedCoordinates([-0.6], [0.6])
    u = np.linspace(-8.0, 8.0, 41)[:, None]
    x, jacobian = coordinates.to_parameters(u)
    density = jacobian + stats.uniform(-0.6, 1.2).logpdf(np.clip(x[:, 0], -0.6, 0.6))
    np.testing.assert_allclose(density, stats.norm.logpdf(u[:, 0]), rtol=1e-12)


@pytest.mark.parametrize("given_widths", [None, np.array([0.02])])
def test_what_rounding_puts_on_a_bound_is_impossible(given_widths):
    """A partial autocorrelation of one has no density to divide by."""
    coordinates = BoundedCoordinates([-1.0], [1.0], given_widths)
    x, jacobian = coordinates.to_parameters(np.array([[-800.0], [0.0], [800.0]]))
    assert (np.abs(x[np.isfinite(jacobian)]) < 1.0).all()
    assert np.isfinite(jacobian).tolist() == [False, True, False]
