"""Numerical trouble: counted, told with the mend, and never averaged in.

The sampler is the real one; the densities are made up, so that what goes wrong is known.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from bayesfric.inference.sampling.convergence import (
    hopeless,
    negligible,
    nested_rhat,
    steps_needed,
    without_stuck,
)
from bayesfric.inference.sampling.sampling import TROUBLE, Sampling, sample
from bayesfric.inference.sampling.start import Start

NORMAL = Start(np.zeros(2), np.eye(2))
SHORT = Sampling(seed=5, min_ess=300, max_steps=400, walkers=12, ensembles=2)
ENOUGH = SHORT.model_copy(update={"min_ess": 4000, "max_steps": 4000, "walkers": 24})


class Normal:
    """A standard normal in coordinates that are the parameters."""

    names = ("x", "y")
    priors = ()
    likelihood = SimpleNamespace(fast=False, method="input-error")
    coordinates = SimpleNamespace(is_nonlinear=False)

    def __init__(self):
        self.not_finite = 0

    @property
    def dimension(self):
        return len(self.names)

    def precomputed(self, u):  # noqa: ARG002
        return self

    def to_parameters(self, u):
        return u, np.zeros(len(u))

    def no_number(self, u):
        return np.zeros(len(u), dtype=bool)

    def height(self, u):
        return -0.5 * np.sum(u**2, axis=1)

    def __call__(self, u):
        bad = self.no_number(u)
        self.not_finite += int(bad.sum())
        return np.where(bad, -np.inf, self.height(u))


class NoNumberAbove(Normal):
    """The likelihood is no number where y is above an edge."""

    def __init__(self, edge):
        super().__init__()
        self.edge = edge

    def no_number(self, u):
        return u[:, 1] > self.edge


def test_places_without_a_number_have_no_probability_and_are_told():
    """What is left is a normal cut at the edge, exactly."""
    result = sample(NoNumberAbove(0.5), NORMAL, ENOUGH)
    d = result.diagnostics
    y = result["y"].ravel()
    assert y.max() <= 0.5
    n = min(d.ess[1], y.size)
    cut = stats.truncnorm(-np.inf, 0.5)
    for p in (0.05, 0.5, 0.95):
        assert abs((y < cut.ppf(p)).mean() - p) < 5.0 * np.sqrt(p * (1 - p) / n), p
    assert d.not_finite_share > TROUBLE
    (told,) = d.warnings
    assert float(told.split()[1]) / 100 == pytest.approx(d.not_finite_share, rel=0.05)


def test_a_few_far_proposals_are_counted_and_nothing_more():
    """Four sds out a normal has 3e-5, and the wide part of the proposal about 3e-4."""
    d = sample(NoNumberAbove(4.0), NORMAL, ENOUGH).diagnostics
    assert 0 < d.not_finite < 0.01 * (d.warmup + d.steps) * d.walkers * d.ensembles
    assert d.not_finite_share < TROUBLE
    assert d.warnings == ()
    assert d.status == "reliable", d.problems


class OneSpike(Normal):
    """The first walker's start is a spike that no proposal beats: it stays there for ever."""

    spike = np.full(2, np.nan)
    walkers = SHORT.walkers

    def height(self, u):
        if len(u) == self.walkers and np.isnan(self.spike).all():
            self.spike = u[0].copy()
        return np.where((u == self.spike).all(axis=1), 20.0, super().height(u))


def test_a_stuck_walker_is_told_and_left_out_of_every_interval():
    target = OneSpike()
    result = sample(target, NORMAL, SHORT)
    d = result.diagnostics
    assert (d.acceptance == 0.0).sum() == 1
    assert d.status == "unusable"
    (told,) = [text for text in d.problems if "never moved" in text]
    assert told.startswith("1 of 24 walkers never moved, and are left out of every interval")
    assert "sampling.seed" in told
    assert not any("independent draws" in text for text in d.problems)
    # it is kept where it can be looked at, and nowhere else
    assert (result.draws == target.spike).all(axis=(-1, -2)).sum() == 1
    flat = result.flat()
    assert flat.shape == (23 * result.draws.shape[2], 2)
    assert not (flat == target.spike).all(axis=1).any()


class Frozen(Normal):
    """Nothing but the starts is possible: not one proposal can be accepted."""

    def __init__(self, calls):
        super().__init__()
        self.calls, self.starts = calls, set()

    def height(self, u):
        if self.calls:
            self.calls -= 1
            self.starts |= {x.tobytes() for x in u}
        return np.array([0.0 if x.tobytes() in self.starts else -np.inf for x in u])


def test_all_zero_acceptance_is_told_and_unusable():
    # the ensembles' centres in one call, the walkers of each in one
    result = sample(Frozen(calls=1 + SHORT.ensembles), NORMAL, SHORT)
    d = result.diagnostics
    assert not d.acceptance.any()
    assert d.status == "unusable"
    assert (d.ess == 0.0).all()
    assert d.problems[0].startswith("no proposal was accepted")
    assert "units" in d.problems[0]
    assert d.steps + d.warmup >= SHORT.max_steps


class Islands(Normal):
    """A dozen narrow peaks far apart in eight dimensions, more than a proposal has parts."""

    names = tuple("abcdefgh")
    peaks = np.random.default_rng(3).normal(scale=20.0, size=(12, 8))

    def height(self, u):
        return -0.5 * ((u[:, None] - self.peaks) ** 2).sum(axis=2).min(axis=1)


def test_ensembles_that_disagree_are_told_each_by_itself():
    wide = Start(np.zeros(8), 400.0 * np.eye(8))
    more = {"ensembles": 4, "max_steps": 600}
    result = sample(Islands(), wide, SHORT.model_copy(update=more))
    d = result.diagnostics
    assert d.rhat.max() > 1.1
    assert d.status == "unusable"
    (told,) = [text for text in d.problems if "disagree" in text]
    worst = result.names[int(d.rhat.argmax())]
    medians = ", ".join(f"{x:.4g}" for x in np.median(result[worst], axis=(1, 2)))
    assert f"their medians of {worst}: {medians})" in told
    assert "sampling.max_steps" in told


# -- sampling that cannot converge ends early; a few stuck walkers spoil nothing


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
    assert told.startswith("1 of 512 walkers never moved, and are left out of every interval")
    assert d.ess.min() >= settings.min_ess
    assert d.rhat.max() <= settings.max_rhat
    assert not (result.flat() == target.spike).all(axis=1).any()


def test_many_stuck_or_all_in_one_ensemble_are_no_few():
    moved = np.ones((4, 128))
    moved[0, :5] = 0.0
    assert negligible(moved == 0.0)
    moved[1, 0] = 0.0
    assert not negligible(moved == 0.0)  # more than one in a hundred
    uneven = np.ones((64, 8))
    uneven[3, 0] = 0.0
    assert not negligible(uneven == 0.0)  # that ensemble has lost one of eight
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
