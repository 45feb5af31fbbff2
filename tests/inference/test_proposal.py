"""The fitted proposal: its density is that of its draws, and it follows a bent posterior."""

import numpy as np
import pytest
from scipy import stats

from bayesfric.inference.sampling.proposal import MixedProposal, Proposal

WIDE = 0.1  # share of the t, 5 degrees of freedom


def random_covariance(d, seed):
    root = np.random.default_rng(seed).normal(size=(d, d))
    return root @ root.T + 0.1 * np.eye(d)


def mixture(seed=0):
    d = 3
    rng = np.random.default_rng(seed)
    weights, means = np.array([0.3, 0.7]), rng.normal(scale=2.0, size=(2, d))
    covariances = np.stack([random_covariance(d, k) for k in (1, 2)])
    mean, whole = np.array([0.5, -1.0, 2.0]), random_covariance(d, 3)
    made = Proposal(
        weights, means, np.linalg.cholesky(covariances), mean, np.linalg.cholesky(whole)
    )
    return made, weights, means, covariances, mean, whole


def test_the_density_is_that_of_scipys_normals_and_t():
    made, weights, means, covariances, mean, whole = mixture()
    x = np.random.default_rng(3).normal(scale=4.0, size=(200, 3))
    parts = [
        (1.0 - WIDE) * w * stats.multivariate_normal(m, c).pdf(x)
        for w, m, c in zip(weights, means, covariances, strict=True)
    ]
    parts.append(WIDE * stats.multivariate_t(mean, whole, df=5.0).pdf(x))
    np.testing.assert_allclose(made.log_density(x), np.log(sum(parts)), rtol=1e-10)


def test_draws_come_from_that_density():
    """Along any line the draws are a mixture of normals and a t, by their distribution."""
    made, weights, means, covariances, mean, whole = mixture()
    n = 40_000
    draws = made.draw(n, np.random.RandomState(4))
    for direction in np.random.default_rng(5).normal(size=(4, 3)):
        scale = np.sqrt(direction @ whole @ direction)

        def cdf(y, direction=direction, scale=scale):
            total = WIDE * stats.t(5.0).cdf((y - direction @ mean) / scale)
            for w, m, c in zip(weights, means, covariances, strict=True):
                sd = np.sqrt(direction @ c @ direction)
                total += (1.0 - WIDE) * w * stats.norm(direction @ m, sd).cdf(y)
            return total

        assert stats.kstest(draws @ direction, cdf).pvalue > 1e-4


@pytest.mark.parametrize(("bend", "width", "finer"), [(0.5, 0.7, 1.0), (1.0, 0.3, 2.0)])
def test_it_follows_a_bent_posterior_better_than_a_normal(bend, width, finer):
    """Draws of y = bend x² + noise: importance weights must be more even than a normal's.

    The last fit, all draws come from it, is the finer the more it bends.
    """
    rng = np.random.default_rng(6)

    def log_density(z):
        return stats.norm.logpdf(z[:, 0]) + stats.norm(bend * z[:, 0] ** 2, width).logpdf(z[:, 1])

    x = rng.normal(size=20_000)
    draws = np.stack([x, bend * x**2 + width * rng.normal(size=x.size)], axis=1)

    def efficiency(proposal):
        z = proposal.draw(20_000, np.random.RandomState(7))
        w = np.exp(log_density(z) - proposal.log_density(z))
        return w.sum() ** 2 / (w**2).sum() / w.size

    plain = Proposal.normal(draws.mean(axis=0), np.cov(draws.T))
    learned, last = Proposal.fitted(draws), Proposal.fitted(draws, last=True)
    assert efficiency(learned) > 1.2 * efficiency(plain)
    assert efficiency(last) > finer * efficiency(learned)


@pytest.mark.parametrize("straight", [False, True])
def test_the_coordinates_in_which_draws_are_normal_have_nearly_all(straight):
    """Draws are ``exp`` of a normal, or that normal itself; straight coordinates are logarithms."""

    def there(x):
        with np.errstate(invalid="ignore"):
            return np.log(x), -np.log(x).sum(axis=1)

    rng = np.random.default_rng(5)
    normal = np.array([3.0, 3.0]) + rng.normal(size=(20_000, 2)) * (1.0 if straight else 0.5)
    draws = np.exp(normal) if straight else normal
    made = MixedProposal.fitted(draws, there, np.exp)
    assert (made.share > 0.9) == straight
    z = made.draw(20_000, np.random.RandomState(7))
    log = stats.norm(3.0, 1.0 if straight else 0.5).logpdf
    above = np.where(z > 0.0, z, 1.0)
    wanted = log(np.log(above)) - np.log(above) if straight else log(z)
    w = np.exp(wanted.sum(axis=1) - made.log_density(z))
    w[straight & (z <= 0.0).any(axis=1)] = 0.0
    # as even as with the better one alone: nine in ten are normal, the rest of a wide t
    assert w.sum() ** 2 / (w**2).sum() / w.size > 0.8


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e9])
def test_too_few_draws_for_a_mixture_make_a_normal_whatever_the_units(scale):
    draws = scale * np.random.default_rng(8).normal(size=(100, 6))
    made = Proposal.fitted(draws)
    assert made.weights.tolist() == [1.0 - WIDE, WIDE]
    np.testing.assert_allclose(made.means[0], draws.mean(axis=0), rtol=1e-9)
    np.testing.assert_allclose(made.roots[0] @ made.roots[0].T, np.cov(draws.T), rtol=1e-6)


def test_coordinates_that_are_all_but_one_do_not_break_it():
    x = np.random.default_rng(9).normal(size=(9000, 1))
    made = Proposal.fitted(np.concatenate([x, x], axis=1))
    assert np.isfinite(made.log_density(made.draw(100, np.random.RandomState(1)))).all()
