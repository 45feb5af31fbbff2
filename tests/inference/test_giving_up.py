"""Sampling that cannot converge ends early and says why; a few stuck walkers spoil nothing."""

import numpy as np
import pytest

from bayesfric.inference.sampling.convergence import (
    few,
    hopeless,
    nested_rhat,
    steps_needed,
    without_stuck,
)
from bayesfric.inference.sampling.sampling import Sampling, _standing, sample
from bayesfric.inference.sampling.start import Start
from tests.inference.test_trouble import NORMAL, Normal, OneSpike

PATIENT = Sampling(seed=5, walkers=24, max_steps=10_000)


class Bananas(Normal):
    """Six bent valleys, each narrow and some ten times as long as a normal around it sees."""

    names = tuple("abcdefghijkl")

    def height(self, u):
        long, across = u[:, ::2], u[:, 1::2]
        return -0.5 * np.sum(long**2 / 100.0 + (across - 0.3 * long**2) ** 2, axis=1)


def test_sampling_that_cannot_mix_stops_early_and_says_why():
    result = sample(Bananas(), Start(np.zeros(12), 9.0 * np.eye(12)), PATIENT)
    names, d = result.names, result.diagnostics
    assert d.status != "reliable"
    assert d.warmup + d.steps < PATIENT.max_steps / 4
    (told,) = [text for text in d.problems if text.startswith("stopped after")]
    assert f"stopped after {d.warmup + d.steps} steps" in told
    assert f"sampling.max_steps is {PATIENT.max_steps}" in told
    named = told.partition("slowest are ")[2].partition(":")[0].split(", ")
    assert 1 <= len(named) <= 4
    assert set(named) <= set(names)
    need = steps_needed(d.steps, d.ensembles, d.rhat, PATIENT.max_rhat, d.tau)
    assert named[0] == names[int(need.argmax())]
    said = told.partition("would need ")[2].removeprefix("about ").partition(" ")[0]
    assert (np.inf if said == "endless" else float(said)) == pytest.approx(need.max(), rel=0.5)


def test_what_only_forgets_its_start_or_may_still_arrive_goes_on():
    looks = [1000, 2000, 3000, 4000, 5330, 7100]

    def ends(needed, allowed):
        seen = list(zip(looks, needed, strict=True))
        return [hopeless(seen[:k], allowed) for k in range(1, 7)]

    assert not any(ends([1e10 / n for n in looks], 40_000))
    assert not any(ends([79_000.0] * 6, 40_000))
    assert ends([100_000.0] * 6, 40_000) == [False] * 3 + [True] * 3
    # not on what the first few of many steps say, nor against one late look, nor in a short run
    assert not any(ends([1e6] * 6, 80_000))
    assert not ends([*[100_000.0] * 5, 70_000.0], 40_000)[-1]
    assert not hopeless([(100 * k, np.inf) for k in range(1, 5)], 400)


def test_one_stuck_walker_of_many_is_a_warning():
    target = OneSpike()
    target.walkers = 128
    settings = Sampling(seed=5, walkers=128)
    result = sample(target, NORMAL, settings)
    d = result.diagnostics
    assert (d.acceptance == 0.0).sum() == 1
    assert d.status == "reliable", d.problems
    (told,) = d.warnings
    assert told.startswith("1 walker of 512 never moved, and left out of every interval")
    assert d.ess.min() >= settings.min_ess
    assert d.rhat.max() <= settings.max_rhat
    assert not (result.flat() == target.spike).all(axis=1).any()


def test_a_few_that_hardly_move_are_a_warning_and_many_a_problem():
    moved = np.full((4, 128), 0.4)
    moved[2, :5] = 0.005
    ((told, harmless),) = _standing(moved)
    assert told.startswith("5 walkers of 512 hardly ever moved")
    assert harmless
    moved[3, 0] = 0.005
    ((_, harmless),) = _standing(moved)
    assert not harmless


def test_many_stuck_or_all_in_one_ensemble_are_no_few():
    moved = np.ones((4, 128))
    moved[0, :5] = 0.0
    assert few(moved == 0.0)
    moved[1, 0] = 0.0
    assert not few(moved == 0.0)  # more than one in a hundred
    uneven = np.ones((64, 8))
    uneven[3, 0] = 0.0
    assert not few(uneven == 0.0)  # that ensemble has lost one of eight
    assert without_stuck(uneven, uneven) is uneven


def test_the_same_number_stays_in_every_ensemble():
    moved = np.ones((3, 100))
    moved[1, 7] = 0.0
    draws = np.random.default_rng(0).standard_normal((3, 100, 50, 2))
    kept = without_stuck(draws, moved)
    assert kept.shape == (3, 99, 50, 2)
    np.testing.assert_array_equal(kept[1], np.delete(draws[1], 7, axis=0))
    np.testing.assert_array_equal(kept[0], draws[0, :99])
    assert without_stuck(draws, np.ones((3, 100))) is draws
    assert nested_rhat(kept).max() < 1.01
