"""Numerical trouble: counted, reported with a hint, and never averaged in.

The sampler is the real one; the densities are made up, so that what goes wrong is known.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from bayesfric.inference.sampling import TROUBLE, Sampling, sample
from bayesfric.inference.start import Start

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

    def not_a_number(self, u):
        return np.zeros(len(u), dtype=bool)

    def height(self, u):
        return -0.5 * np.sum(u**2, axis=1)

    def __call__(self, u):
        bad = self.not_a_number(u)
        self.not_finite += int(bad.sum())
        return np.where(bad, -np.inf, self.height(u))


class NotFiniteAbove(Normal):
    """The likelihood is not finite where y is above an edge."""

    def __init__(self, edge):
        super().__init__()
        self.edge = edge

    def not_a_number(self, u):
        return u[:, 1] > self.edge


def test_places_without_a_likelihood_have_no_probability_and_are_reported():
    """What is left is a normal cut at the edge, exactly."""
    result = sample(NotFiniteAbove(0.5), NORMAL, ENOUGH)
    d = result.diagnostics
    y = result["y"].ravel()
    assert y.max() <= 0.5
    n = min(d.ess[1], y.size)
    cut = stats.truncnorm(-np.inf, 0.5)
    for p in (0.05, 0.5, 0.95):
        assert abs((y < cut.ppf(p)).mean() - p) < 5.0 * np.sqrt(p * (1 - p) / n), p
    assert d.not_finite_share > TROUBLE
    (warning,) = d.warnings
    assert float(warning.split()[1]) / 100 == pytest.approx(d.not_finite_share, rel=0.05)


def test_a_few_far_proposals_are_counted_and_nothing_more():
    """Four sds out a normal has 3e-5, and the wide part of the proposal about 3e-4."""
    d = sample(NotFiniteAbove(4.0), NORMAL, ENOUGH).diagnostics
    assert 0 < d.not_finite < 0.01 * (d.warmup + d.steps) * d.walkers * d.ensembles
    assert d.not_finite_share < TROUBLE
    assert d.warnings == ()
    assert d.status == "reliable", d.problems


class OneSpike(Normal):
    """The first walker's start is a spike that no proposal beats: it would stay there forever."""

    spike = np.full(2, np.nan)

    def height(self, u):
        if len(u) == ENOUGH.walkers and np.isnan(self.spike).all():
            self.spike = u[0].copy()
        return np.where((u == self.spike).all(axis=1), 20.0, super().height(u))


def test_a_walker_that_never_moves_is_put_on_another():
    target = OneSpike()
    result = sample(target, NORMAL, ENOUGH)
    assert np.isfinite(target.spike).all()
    assert result.diagnostics.status == "reliable", result.diagnostics.problems
    assert not (result.draws == target.spike).all(axis=-1).any()


def test_draws_are_those_of_walkers_that_moved():
    result = sample(Normal(), NORMAL, SHORT)
    acceptance = result.diagnostics.acceptance.copy()
    acceptance[0, 0] = 0.0
    stuck = replace(result, diagnostics=replace(result.diagnostics, acceptance=acceptance))
    np.testing.assert_array_equal(stuck.flat(), result.flat()[result.draws.shape[2] :])


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


def test_no_accepted_proposal_is_unusable():
    # the ensembles' centres in one call, the walkers of each in one
    result = sample(Frozen(calls=1 + SHORT.ensembles), NORMAL, SHORT)
    d = result.diagnostics
    assert not d.acceptance.any()
    assert d.status == "unusable"
    assert (d.ess == 0.0).all()
    assert "no proposal was accepted" in d.problems[0]
    assert d.steps + d.warmup >= SHORT.max_steps


class Islands(Normal):
    """A dozen narrow peaks far apart in eight dimensions, more than a proposal has parts."""

    names = tuple("abcdefgh")
    peaks = np.random.default_rng(3).normal(scale=20.0, size=(12, 8))

    def height(self, u):
        return -0.5 * ((u[:, None] - self.peaks) ** 2).sum(axis=2).min(axis=1)


def test_ensembles_that_disagree_are_reported():
    wide = Start(np.zeros(8), 400.0 * np.eye(8))
    more = {"ensembles": 4, "max_steps": 600}
    result = sample(Islands(), wide, SHORT.model_copy(update=more))
    d = result.diagnostics
    assert d.rhat.max() > SHORT.max_rhat
    assert d.status == "unusable"
    worst = result.names[int(d.rhat.argmax())]
    assert any(f"their medians of {worst}: " in text for text in d.problems)


class Bananas(Normal):
    """Six bent valleys, each narrow and some ten times as long as a normal around it sees."""

    names = tuple("abcdefghijkl")

    def height(self, u):
        long, across = u[:, ::2], u[:, 1::2]
        return -0.5 * np.sum(long**2 / 100.0 + (across - 0.3 * long**2) ** 2, axis=1)


def test_sampling_that_cannot_mix_stops_early():
    patient = Sampling(seed=5, walkers=24, max_steps=6000)
    d = sample(Bananas(), Start(np.zeros(12), 9.0 * np.eye(12)), patient).diagnostics
    assert d.status != "reliable"
    assert d.warmup + d.steps < 0.5 * patient.max_steps
    assert d.problems[0].startswith(f"stopped after {d.warmup + d.steps} steps")
