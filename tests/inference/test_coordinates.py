"""Coordinates: round trips, Jacobians against finite differences, bounds."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
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
    np.testing.assert_allclose(coordinates.from_parameters(x)[0], u, rtol=1e-6, atol=1e-6)
    # five sds out a shorter step would be lost in rounding: 2e-16 over a slope of 5e-6
    numeric = numeric_log_determinant(coordinates.to_parameters, u, step=1e-4)
    assert jacobian[0] == pytest.approx(numeric, abs=1e-5)
    assert x[0, 0] > 0.0
    assert x[0, 1] > -1.0
    assert x[0, 3] < 5.0


def test_a_normal_far_above_its_bound_stays_one_and_one_cut_in_its_middle_becomes_one():
    coordinates = BoundedCoordinates([0.0], [INF], np.array([0.1]))
    steps = np.diff(coordinates.from_parameters(np.array([[3.0], [3.1], [3.2]]))[:, 0])
    np.testing.assert_allclose(steps, 1.0, rtol=1e-3)
    u = np.linspace(-12.0, 12.0, 49)[:, None]
    x, jacobian = coordinates.to_parameters(u)
    density = jacobian + stats.halfnorm(scale=0.1).logpdf(x[:, 0])
    np.testing.assert_allclose(density, stats.norm.logpdf(u[:, 0]), rtol=1e-11)


@settings(max_examples=30, deadline=None)
@given(widths, st.lists(st.floats(-5.0, 5.0), min_size=4, max_size=4))
def test_straight_values_are_those_that_bounds_cut(given_widths, u):
    ends = [0.0, -1.0, -INF, -INF], [INF, 2.0, INF, 5.0]
    coordinates = BoundedCoordinates(*ends, np.array(given_widths))
    u = np.array(u)[None]
    v, slope = coordinates.straighten(u)
    x, whole = coordinates.to_parameters(u)
    here = coordinates._alone
    np.testing.assert_array_equal(v[:, here], x[:, here])
    np.testing.assert_allclose(coordinates.bend(v), u, rtol=1e-6, atol=1e-6)
    if coordinates._between[1]:  # a quantile of the place between
        whole = whole - stats.norm.logpdf(u[0, 1]) - np.log(3.0)
    assert slope == pytest.approx(whole)
    beyond = v.copy()
    beyond[0, 0] = -1e-9
    assert not np.isfinite(coordinates.bend(beyond)).all()


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
