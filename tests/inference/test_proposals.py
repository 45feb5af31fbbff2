"""Moves against exact posteriors, and the density of the fitted proposal."""

import emcee
import numpy as np
import pytest
from scipy import stats

from bayesfric.inference.posterior import autocorrelation_time
from bayesfric.inference.proposals import (
    DifferentialEvolutionMove,
    IndependenceMove,
    MixedProposal,
    Proposal,
)

DE = DifferentialEvolutionMove
WIDE = 0.1  # share of the t, 5 degrees of freedom


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


def assert_standard_normal(chain, least=0.0):
    """Five standard errors of mean and variance of ``n`` independent draws, in every coordinate."""
    n = chain[..., 0].size / autocorrelation_time(chain).max()
    flat = chain.reshape(-1, chain.shape[-1])
    assert np.abs(flat.mean(axis=0)).max() < 5.0 / np.sqrt(n)
    assert np.abs(flat.var(axis=0) - 1.0).max() < 5.0 * np.sqrt(2.0 / n)
    assert n > least


@pytest.mark.parametrize("d", [2, 6, *(pytest.param(d, marks=pytest.mark.slow) for d in (12, 20))])
@pytest.mark.parametrize("search", [0.0, 0.3, 1.0])
def test_moves_sample_a_correlated_normal_exactly(search, d):
    sigma = covariance(d)
    precision, root = np.linalg.inv(sigma), np.linalg.cholesky(sigma)
    # a proposal as wrong as a short warm-up makes it
    independence = IndependenceMove(Proposal.normal(3e-3 * np.ones(d), 1.4 * sigma))
    moves = [(independence, 1.0 - search), (DE(), search)]

    def log_density(x):
        return -0.5 * np.einsum("ni,ij,nj->n", x, precision, x)

    starts = np.random.default_rng(1).normal(size=(4 * d + 20, d)) @ root.T
    steps = 4000 if search == 1.0 else 2500
    chain = run(log_density, starts, [move for move in moves if move[1] > 0.0], steps)
    assert_standard_normal(chain @ np.linalg.inv(root).T, least=2000.0)


def cubed(x):
    """Other coordinates of positive numbers, with the log Jacobian."""
    return x**3, np.log(3.0 * x**2).sum(axis=1)


def cube_root(v):
    with np.errstate(invalid="ignore"):
        return np.where(v > 0.0, np.abs(v) ** (1 / 3), np.nan)


NORMAL = Proposal.normal(np.array([1.0, 3.0]), np.diag([1.0, 3.0]))
# most of what the linear one proposes has no inverse, and is drawn again
MIXED = MixedProposal(
    NORMAL, Proposal.normal(np.array([1.0, 10.0]), np.diag([20.0, 900.0])), 0.6, cubed, cube_root
)


@pytest.mark.parametrize(
    "moves",
    [
        [(DE(), 1.0)],
        [(IndependenceMove(NORMAL), 0.7), (DE(), 0.3)],
        # a wrong Jacobian, there or back, would tilt it
        [(DE(1, cubed, cube_root), 0.6), (DE(), 0.4)],
        [(IndependenceMove(MIXED), 0.6), (DE(), 0.4)],
    ],
    ids=["de", "independence", "transformed", "mixed"],
)
def test_moves_keep_a_skewed_posterior_with_a_wall(moves):
    """An exponential and a gamma: a wall at zero, no normal tails."""
    gamma = stats.gamma(3.0)

    def log_density(x):
        inside = (x > 0.0).all(axis=1)
        safe = np.where(x > 0.0, x, 1.0)
        density = -safe[:, 0] - safe[:, 1] + 2.0 * np.log(safe[:, 1])
        return np.where(inside, density, -np.inf)

    starts = np.random.default_rng(2).uniform(0.5, 2.0, (40, 2))
    chain = run(log_density, starts, moves, 6000)[:, :, 500:]
    n = chain[..., 0].size / autocorrelation_time(chain)
    flat = chain.reshape(-1, 2)
    assert abs(flat[:, 0].mean() - 1.0) < 5.0 / np.sqrt(n[0])
    assert abs(flat[:, 1].mean() - 3.0) < 5.0 * gamma.std() / np.sqrt(n[1])
    for quantile in (0.05, 0.5, 0.95):
        share = (flat[:, 0] < stats.expon.ppf(quantile)).mean()
        # binomial error of an indicator, whose own autocorrelation is no longer than tau
        assert abs(share - quantile) < 5.0 * np.sqrt(quantile * (1 - quantile) / n[0])


def test_ensembles_in_one_sampler_are_each_sampled_exactly_and_never_meet():
    """Three ensembles of two equal normals with a gap that no step crosses."""
    d, walkers = 2, 40

    def log_density(x):
        return np.logaddexp(
            -0.5 * np.sum((x - 1000.0) ** 2, axis=1), -0.5 * np.sum((x + 1000.0) ** 2, axis=1)
        )

    places = np.array([-1000.0, 1000.0, 1000.0])[:, None, None]
    starts = places + np.random.default_rng(8).normal(size=(3, walkers, d))
    moves = [(DE(3), 1.0)]
    chain = run(log_density, starts.reshape(-1, d), moves, 3000).reshape(3, walkers, 3000, d)
    away = chain - places[..., None]
    assert np.abs(away).max() < 10.0
    for ensemble in away:
        assert_standard_normal(ensemble[None])


def random_covariance(d, seed):
    root = np.random.default_rng(seed).normal(size=(d, d))
    return root @ root.T + 0.1 * np.eye(d)


def mixture(seed=0):
    d = 3
    rng = np.random.default_rng(seed)
    weights, means = np.array([0.3, 0.7]), rng.normal(scale=2.0, size=(2, d))
    covariances = np.stack([random_covariance(d, k) for k in (1, 2)])
    mean, wide = np.array([0.5, -1.0, 2.0]), random_covariance(d, 3)
    proposal = Proposal(
        weights, means, np.linalg.cholesky(covariances), mean, np.linalg.cholesky(wide)
    )
    return proposal, weights, means, covariances, mean, wide


def test_the_density_is_that_of_scipys_normals_and_t():
    proposal, weights, means, covariances, mean, wide = mixture()
    x = np.random.default_rng(3).normal(scale=4.0, size=(200, 3))
    parts = [
        (1.0 - WIDE) * w * stats.multivariate_normal(m, c).pdf(x)
        for w, m, c in zip(weights, means, covariances, strict=True)
    ]
    parts.append(WIDE * stats.multivariate_t(mean, wide, df=5.0).pdf(x))
    np.testing.assert_allclose(proposal.log_density(x), np.log(sum(parts)), rtol=1e-10)


def test_draws_come_from_that_density():
    """Along any line the draws are a mixture of normals and a t, by their distribution."""
    proposal, weights, means, covariances, mean, wide = mixture()
    n = 40_000
    draws = proposal.draw(n, np.random.RandomState(4))
    for direction in np.random.default_rng(5).normal(size=(4, 3)):
        scale = np.sqrt(direction @ wide @ direction)

        def cdf(y, direction=direction, scale=scale):
            total = WIDE * stats.t(5.0).cdf((y - direction @ mean) / scale)
            for w, m, c in zip(weights, means, covariances, strict=True):
                sd = np.sqrt(direction @ c @ direction)
                total += (1.0 - WIDE) * w * stats.norm(direction @ m, sd).cdf(y)
            return total

        assert stats.kstest(draws @ direction, cdf).pvalue > 1e-4


@pytest.mark.parametrize(("curvature", "width", "finer"), [(0.5, 0.7, 1.0), (1.0, 0.3, 2.0)])
def test_it_follows_a_curved_posterior_better_than_a_normal(curvature, width, finer):
    """Draws of y = curvature x² + noise: importance weights are more even than a normal's."""
    rng = np.random.default_rng(6)

    def log_density(z):
        residual = (z[:, 1] - curvature * z[:, 0] ** 2) / width
        return stats.norm.logpdf(z[:, 0]) + stats.norm.logpdf(residual) - np.log(width)

    x = rng.normal(size=20_000)
    draws = np.stack([x, curvature * x**2 + width * rng.normal(size=x.size)], axis=1)

    def efficiency(proposal):
        z = proposal.draw(20_000, np.random.RandomState(7))
        w = np.exp(log_density(z) - proposal.log_density(z))
        return w.sum() ** 2 / (w**2).sum() / w.size

    plain = Proposal.normal(draws.mean(axis=0), np.cov(draws.T))
    learned, last = Proposal.fitted(draws), Proposal.fitted(draws, last=True)
    assert efficiency(learned) > 1.2 * efficiency(plain)
    assert efficiency(last) > finer * efficiency(learned)


@pytest.mark.parametrize("linear", [False, True])
def test_the_coordinates_in_which_draws_are_normal_have_nearly_all(linear):
    """Draws are ``exp`` of a normal, or that normal itself; linear coordinates are logarithms."""

    def forward(x):
        with np.errstate(invalid="ignore"):
            return np.log(x), -np.log(x).sum(axis=1)

    rng = np.random.default_rng(5)
    normal = np.array([3.0, 3.0]) + rng.normal(size=(20_000, 2)) * (1.0 if linear else 0.5)
    draws = np.exp(normal) if linear else normal
    proposal = MixedProposal.fitted(draws, forward, np.exp)
    assert (proposal.share > 0.9) == linear
    z = proposal.draw(20_000, np.random.RandomState(7))
    log = stats.norm(3.0, 1.0 if linear else 0.5).logpdf
    positive = np.where(z > 0.0, z, 1.0)
    expected = log(np.log(positive)) - np.log(positive) if linear else log(z)
    w = np.exp(expected.sum(axis=1) - proposal.log_density(z))
    w[linear & (z <= 0.0).any(axis=1)] = 0.0
    # as even as with the better one alone: nine in ten are normal, the rest of a wide t
    assert w.sum() ** 2 / (w**2).sum() / w.size > 0.8


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e9])
def test_too_few_draws_for_a_mixture_make_a_normal_whatever_the_units(scale):
    draws = scale * np.random.default_rng(8).normal(size=(100, 6))
    proposal = Proposal.fitted(draws)
    assert proposal.weights.tolist() == [1.0 - WIDE, WIDE]
    np.testing.assert_allclose(proposal.means[0], draws.mean(axis=0), rtol=1e-9)
    np.testing.assert_allclose(proposal.roots[0] @ proposal.roots[0].T, np.cov(draws.T), rtol=1e-6)


def test_collinear_coordinates_are_possible():
    x = np.random.default_rng(9).normal(size=(9000, 1))
    proposal = Proposal.fitted(np.concatenate([x, x], axis=1))
    assert np.isfinite(proposal.log_density(proposal.draw(100, np.random.RandomState(1)))).all()
