"""Shares and numbers are written without powers of ten."""

import pytest

from bayesfric.base.templates import percent, two


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
