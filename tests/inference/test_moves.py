"""Every move against exact posteriors, and the facts about emcee that made us write them."""

import emcee
import numpy as np
import pytest
from scipy import stats

from bayesfric.inference.sampling.convergence import autocorrelation_time
from bayesfric.inference.sampling.moves import (
    DifferentialEvolutionMove,
    IndependenceMove,
    TransformedMove,
)
from bayesfric.inference.sampling.proposal import MixedProposal, Proposal


def run(log_density, starts, moves, steps, seed=0):
    walkers, d = starts.shape
    sampler = emcee.EnsembleSampler(walkers, d, log_density, moves=moves, vectorize=True)
    sampler.random_state = np.random.RandomState(seed).get_state()
    sampler.run_mcmc(emcee.State(starts), steps, skip_initial_state_check=True)
    return sampler.get_chain().swapaxes(0, 1)[None]  # (1, walkers, steps, d)


def covariance(d):
    """A badly scaled, correlated normal."""
    rng = np.random.default_rng(d)
    rotation, _ = np.linalg.qr(rng.normal(size=(d, d)))
    return (rotation * np.geomspace(1e-3, 1e2, d)) @ rotation.T


def make_moves(name, d):
    if name == "de":
        return [(DifferentialEvolutionMove(), 1.0)]
    # a proposal as wrong as a short warm-up makes it
    proposal = Proposal.normal(0.3 * np.ones(d) * 1e-2, 1.4 * covariance(d))
    independence = IndependenceMove(proposal)
    if name == "independence":
        return [(independence, 1.0)]
    return [(independence, 0.7), (DifferentialEvolutionMove(), 0.3)]


@pytest.mark.parametrize("d", [2, 6, *(pytest.param(d, marks=pytest.mark.slow) for d in (12, 20))])
@pytest.mark.parametrize("name", ["de", "independence", "mix"])
def test_moves_sample_a_correlated_normal_exactly(name, d):
    sigma = covariance(d)
    precision = np.linalg.inv(sigma)
    root = np.linalg.cholesky(sigma)

    def log_density(x):
        return -0.5 * np.einsum("ni,ij,nj->n", x, precision, x)

    walkers = 4 * d + 20
    starts = np.random.default_rng(1).normal(size=(walkers, d)) @ root.T
    steps = 4000 if name == "de" else 2500
    chain = run(log_density, starts, make_moves(name, d), steps)
    white = chain @ np.linalg.inv(root).T
    tau = autocorrelation_time(white).max()
    n = walkers * steps / tau
    flat = white.reshape(-1, d)
    # Five standard errors of mean and variance of n independent draws, over all d of each.
    assert np.abs(flat.mean(axis=0)).max() < 5.0 / np.sqrt(n)
    assert np.abs(flat.var(axis=0) - 1.0).max() < 5.0 * np.sqrt(2.0 / n)
    assert n > 2000.0


def cubed(x):
    """Other coordinates of positive numbers, with the log Jacobian of the way there."""
    return x**3, np.log(3.0 * x**2).sum(axis=1)


def uncubed(v):
    with np.errstate(invalid="ignore"):
        return np.where(v > 0.0, np.abs(v) ** (1 / 3), np.nan)


@pytest.mark.parametrize("name", ["de", "mix", "elsewhere", "both"])
def test_moves_keep_a_skewed_posterior_with_a_wall(name):
    """An exponential and a gamma: a wall at zero, no normal tails."""
    gamma = stats.gamma(3.0)

    def log_density(x):
        inside = (x > 0.0).all(axis=1)
        safe = np.where(x > 0.0, x, 1.0)
        density = -safe[:, 0] - safe[:, 1] + 2.0 * np.log(safe[:, 1])
        return np.where(inside, density, -np.inf)

    starts = np.random.default_rng(2).uniform(0.5, 2.0, (40, 2))
    moves = [(DifferentialEvolutionMove(), 1.0)]
    if name == "mix":
        proposal = IndependenceMove(Proposal.normal(np.array([1.0, 3.0]), np.diag([1.0, 3.0])))
        moves = [(proposal, 0.7), (DifferentialEvolutionMove(), 0.3)]
    if name == "elsewhere":
        # a wrong Jacobian, there or back, would tilt both; half of what is proposed has no way back
        proposal = Proposal.normal(np.array([1.0, 10.0]), np.diag([20.0, 900.0]))
        inner = [(IndependenceMove(proposal), 0.3), (DifferentialEvolutionMove(), 0.3)]
        moves = [(TransformedMove(move, cubed, uncubed), share) for move, share in inner]
        moves += [(DifferentialEvolutionMove(), 0.4)]
    if name == "both":
        # most of what the straight one proposes has no way back, and is drawn anew
        own = Proposal.normal(np.array([1.0, 3.0]), np.diag([1.0, 3.0]))
        straight = Proposal.normal(np.array([1.0, 10.0]), np.diag([20.0, 900.0]))
        both = MixedProposal(own, straight, 0.6, cubed, uncubed)
        moves = [(IndependenceMove(both), 0.6), (DifferentialEvolutionMove(), 0.4)]
    chain = run(log_density, starts, moves, 6000)[:, :, 500:]
    n = chain[..., 0].size / autocorrelation_time(chain)
    flat = chain.reshape(-1, 2)
    assert abs(flat[:, 0].mean() - 1.0) < 5.0 / np.sqrt(n[0])
    assert abs(flat[:, 1].mean() - 3.0) < 5.0 * gamma.std() / np.sqrt(n[1])
    for quantile in (0.05, 0.5, 0.95):
        share = (flat[:, 0] < stats.expon.ppf(quantile)).mean()
        # binomial error of an indicator, whose own autocorrelation is no longer than tau
        assert abs(share - quantile) < 5.0 * np.sqrt(quantile * (1 - quantile) / n[0])


@pytest.mark.parametrize("name", ["de", "mix"])
def test_ensembles_in_one_sampler_are_each_sampled_exactly_and_never_meet(name):
    """Three ensembles, one of them far from where the density lets it come to the others."""
    d, walkers = 2, 40

    def log_density(x):
        # two equal normals with a gap no step crosses
        return np.logaddexp(
            -0.5 * np.sum((x - 1000.0) ** 2, axis=1), -0.5 * np.sum((x + 1000.0) ** 2, axis=1)
        )

    rng = np.random.default_rng(8)
    places = np.array([-1000.0, 1000.0, 1000.0])
    starts = (places[:, None, None] + rng.normal(size=(3, walkers, d))).reshape(-1, d)
    moves = [(DifferentialEvolutionMove(3), 1.0)]
    if name == "mix":
        mean = np.full(d, 1000.0)
        moves = [(IndependenceMove(Proposal.normal(mean, np.eye(d))), 0.5), (moves[0][0], 0.5)]
    chain = run(log_density, starts, moves, 3000).reshape(3, walkers, 3000, d)
    if name == "mix":
        chain = chain[1:]  # the independence move takes the first ensemble over the gap
    else:
        assert (chain[0] < 0.0).all()
        assert (chain[1:] > 0.0).all()
    away = chain - np.sign(chain) * 1000.0
    for one in away:
        n = one[..., 0].size / autocorrelation_time(one[None])
        assert (np.abs(one.mean(axis=(0, 1))) < 5.0 / np.sqrt(n)).all()
        assert (np.abs(one.var(axis=(0, 1)) - 1.0) < 5.0 * np.sqrt(2.0 / n)).all()
