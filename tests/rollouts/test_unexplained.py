"""Pieces of residuals: what they keep of the residuals, and how much of them moves a joint."""

import numpy as np
import pytest

from bayesfric.results.roll_out import LEVEL
from bayesfric.rollouts.rollout import Series, memory, moving_share, played


def remembering(n=20_000, a=0.8, seed=0):
    """A first-order autoregression with standard deviation one."""
    rng = np.random.default_rng(seed)
    x = np.empty(n)
    x[0] = rng.standard_normal()
    for k in range(1, n):
        x[k] = a * x[k - 1] + np.sqrt(1.0 - a**2) * rng.standard_normal()
    return x


def test_memory_of_an_autoregression_is_its_integrated_time():
    # (1 + a) / (1 - a); its estimate's relative sd is about sqrt(2 (2 W + 1) / N), Sokal
    assert memory(remembering()) == pytest.approx(9.0, rel=0.25)
    assert memory(np.random.default_rng(1).standard_normal(20_000)) == pytest.approx(1.0, abs=0.1)
    assert memory(np.zeros(30)) == 1.0


def test_pieces_keep_size_and_neighbours():
    x = remembering()
    rng = np.random.default_rng(2)
    drawn = played([Series(x, 0.02)], 40, 2000, 0.02, rng)
    # 80,000 outputs of which every nine are one: sd of a variance sqrt(2 * 9 / 80000) = 0.015
    assert drawn.var() == pytest.approx(1.0, abs=0.06)
    lag = np.mean(drawn[:, 1:] * drawn[:, :-1]) / drawn.var()
    # one pair in ninety is torn apart
    assert lag == pytest.approx(0.8, abs=0.03)


def test_between_outputs_it_goes_straight():
    rng = np.random.default_rng(3)
    drawn = played([Series(remembering(300), 0.05)], 1, 1001, 0.005, rng)[0]
    every = drawn[::10]
    assert drawn == pytest.approx(np.interp(np.arange(1001), np.arange(0, 1001, 10), every))


def test_the_same_seed_gives_the_same_bytes():
    series = [Series(remembering(400), 0.02), Series(remembering(90, seed=4), 0.01)]
    drawn = [played(series, 3, 500, 0.01, np.random.default_rng(5)).tobytes() for _ in range(2)]
    assert drawn[0] == drawn[1]


def test_the_share_that_moves_the_joint_is_found():
    """Errors that are half of what the whole torque would make; parameters known or not."""
    rng = np.random.default_rng(6)
    for known in (0.0, 0.3):
        alone = known * rng.standard_normal((4000, 300))
        moved = alone + rng.standard_normal((4000, 300))
        measured = np.concatenate([
            np.sqrt(known**2 + 0.25) * rng.standard_normal(300) for _ in range(1)
        ])  # fmt: skip
        # the 90 % point of 300 normals: sd of the quantile 0.09 of a sd, twice that allowed
        assert moving_share(measured, alone, moved, 0.0) == pytest.approx(0.5, abs=0.1)


def test_noise_that_moves_nothing_counts_for_nothing():
    rng = np.random.default_rng(7)
    alone = rng.standard_normal((200, 300))
    moved = alone + rng.standard_normal((200, 300))
    assert moving_share(0.5 * rng.standard_normal(300), alone, moved, 0.0) == 0.0


def test_nothing_can_be_told_of_what_does_not_move():
    nothing = np.full((5, 8), np.nan)
    assert moving_share(np.zeros(8), nothing, nothing, 0.0) == 1.0
    assert LEVEL == 0.9
