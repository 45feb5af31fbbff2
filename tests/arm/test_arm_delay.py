"""Delays of joints are combined as random effects: closed forms."""

import numpy as np
import pytest

from bayesfric.arm.departures import combined


def test_equal_delays_have_the_sd_of_their_mean():
    assert combined([(0.004, 0.001)] * 4) == pytest.approx((0.004, 0.0005))
    assert combined([]) == (0.0, np.inf)


@pytest.mark.parametrize("sd", [1e-6, 1e-4])
def test_scattered_delays_have_the_sd_of_a_sample(sd):
    """For equal sds DerSimonian and Laird's estimate is the variance of the sample."""
    delays = np.random.default_rng(1).normal(0.003, 0.002, 7)
    mean, error = combined([(x, sd) for x in delays])
    assert mean == pytest.approx(delays.mean())
    assert error == pytest.approx(delays.std(ddof=1) / np.sqrt(7.0))
