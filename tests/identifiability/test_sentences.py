"""What is told in logarithms is worded as a share or a factor, which needs no logarithm to read."""

import numpy as np
import pytest

from bayesfric.identifiability.sentences import left
from bayesfric.templates import percent, two


@pytest.mark.parametrize("share", [0.0003, 0.01, 0.2])
def test_a_small_sd_of_a_logarithm_is_a_share(share):
    value = np.random.default_rng(1).normal(size=20000) * share
    said = left(1.0 / share)
    assert said.endswith(" %")
    # of what is spread so, the relative sd
    assert abs(float(said.removesuffix(" %")) / 100 / np.exp(value).std() - 1.0) < 0.1


def test_a_wide_one_is_a_factor_and_none_is_nothing():
    assert left(0.5) == f"a factor {np.exp(2.0):.2g}"
    assert left(1e-7) == "nothing told"
    assert left(0.0) == "nothing told"


@pytest.mark.parametrize(
    ("share", "written"),
    [(0.0, "0"), (0.0123, "1.2"), (0.094, "9.4"), (0.0996, "10"), (0.123, "12"), (0.9996, "100")],
)
def test_a_share_is_written_without_powers_of_ten(share, written):
    assert percent(share) == written


@pytest.mark.parametrize(
    ("x", "written"), [(0.1234, "0.12"), (99.4, "99"), (99.6, "100"), (-101.3, "-101"), (0.0, "0")]
)
def test_two_digits_never_become_a_power_of_ten(x, written):
    assert two(x) == written
