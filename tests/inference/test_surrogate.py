"""The polynomial that stands in for a simulation."""

import numpy as np
import pytest
from scipy import stats

from bayesfric.inference.sampling.surrogate import Surrogate

MIX = np.array([[0.5, 0.2, 0.0], [0.0, 3.0, 0.4], [1.0, 0.0, 200.0]])


def flat(u):
    return np.zeros(len(u))


def cubic(u):
    """A likelihood that is a cubic, in skew coordinates far from zero."""
    z = (u - np.array([100.0, -3.0, 0.01])) @ MIX
    return (
        7.0 + z[:, 0] - np.sum(z**2, axis=1) + 0.05 * z[:, 0] ** 2 * z[:, 1] - 0.02 * z[:, 2] ** 3
    )


def states(n, seed=0):
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(n, 3)) / np.sqrt(2.0)
    return np.array([100.0, -3.0, 0.01]) + z @ np.linalg.inv(MIX)


def differences(surrogate, of, u):
    """Deviation of log ratios: a constant does not matter."""
    return np.ptp(surrogate(u) - of(u))


def test_a_cubic_is_found_exactly():
    u = states(200)
    found = Surrogate.fitted(flat, u, cubic(u))
    assert differences(found, cubic, states(20, seed=1)) < 1e-8


def test_a_quadratic_needs_few_states_and_less_is_refused():
    """Ten coefficients in three dimensions, two states for each."""
    quadratic = lambda u: -0.5 * np.sum((u - states(1)) ** 2, axis=1)  # noqa: E731
    u = states(20)
    assert differences(Surrogate.fitted(flat, u, quadratic(u)), quadratic, states(9, 2)) < 1e-8
    assert Surrogate.fitted(flat, u[:19], quadratic(u[:19])) is None
    # the same state again says nothing new
    again = np.concatenate([u[:19], u[:19]])
    assert Surrogate.fitted(flat, again, quadratic(again)) is None


def test_priors_and_walls_stay_exact():
    wall = lambda u: np.where(u[:, 1] > -3.0, stats.norm.logpdf(u[:, 0], 99.0, 2.0), -np.inf)  # noqa: E731
    u = states(2000)
    u = u[u[:, 1] > -3.0]
    found = Surrogate.fitted(wall, u, cubic(u) + wall(u))
    other = states(50, seed=1)
    inside = other[:, 1] > -3.0
    assert (found(other) == -np.inf).tolist() == (~inside).tolist()
    assert differences(found, lambda x: cubic(x) + wall(x), other[inside]) < 1e-8


def test_states_that_are_no_part_of_the_posterior_do_not_bend_it():
    """A walker left behind, where the likelihood is no cubic at all."""
    u = np.concatenate([states(200), [[1e4, 0.0, 0.0]]])
    heights = np.append(cubic(u[:-1]), -1e6)
    assert differences(Surrogate.fitted(flat, u, heights), cubic, states(20, seed=1)) < 1e-8


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_it_falls_far_out_whatever_the_cubic_does(sign):
    u = states(200)
    found = Surrogate.fitted(flat, u, cubic(u))
    centre = u.mean(axis=0)
    for direction in states(10, seed=3) - centre:
        far = found(centre + sign * np.geomspace(1e2, 1e8, 7)[:, None] * direction)
        assert (np.diff(far) < 0.0).all()


def test_a_direction_in_which_nothing_moved_has_no_surrogate():
    u = states(200)
    u[:, 2] = 0.5
    assert Surrogate.fitted(flat, u, cubic(states(200))) is None
