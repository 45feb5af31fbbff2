"""The order of the noise is found again, and what is left is tested."""

import numpy as np
import pytest

from bayesfric.inference.likelihood.autoregression import simulated
from bayesfric.inference.likelihood.noise_choice import choose_order

FOLLOWS = np.ones(2999, dtype=bool)
FOLLOWS[[500, 501, 1700]] = False


@pytest.mark.parametrize("own", [False, True])
@pytest.mark.parametrize("partial", [[], [0.6], [0.8, -0.5], [0.5, 0.3, -0.3]])
def test_the_order_is_found_again(partial, own):
    rng = np.random.default_rng(4)
    residuals = [0.1 * simulated(np.array(partial), FOLLOWS, 1, rng)[0] for _ in range(2)]
    found = choose_order(residuals, [FOLLOWS, FOLLOWS], own)
    assert found.order == len(partial)
    assert found.white
    # p orders take the variance of the series down to that of its innovations
    expected = np.sqrt(np.prod(1.0 - np.array(partial) ** 2))
    assert found.tried[found.order].innovations == pytest.approx(expected, rel=0.03)
    assert found.tried[0].bic == 0.0
    if partial:
        assert found.tried[0].p_value < 1e-6


def test_residuals_of_nothing_are_white():
    assert choose_order([np.zeros(100)], [FOLLOWS[:99]], True).order == 0


def test_a_handful_of_residuals_is_no_evidence():
    rng = np.random.default_rng(1)
    assert choose_order([rng.standard_normal(15)], [np.ones(14, dtype=bool)], True).order == 0
