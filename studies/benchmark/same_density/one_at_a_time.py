"""dynesty and nutpie on the compiled density of one vector, with its gradient by hand."""

from __future__ import annotations

import time

import dynesty
import numpy as np
import nutpie.compiled_pyfunc
import problem
from density import RADIUS, Reduced, check
from given import Setup
from measured import Measured
from scipy.special import ndtri

LIVE = 1000
WIDER = 2.5  # width of dynesty's base, in standard deviations of the posterior
DLOGZ = 0.1
LIMIT = 100.0  # CPU s
TUNE, DRAWS, CHAINS = 600, 4000, 4


def reduced(setup: Setup) -> Reduced:
    """Build the density of one vector and check it against the target."""
    medians = np.array([problem.PRIOR_MEDIANS[name] for name in setup.target.names])
    reduced_density = Reduced.of(setup.target, setup.pilot, medians, problem.PRIOR_SD)
    u = setup.target.from_parameters(setup.pilot)
    rng = np.random.default_rng(5)
    far = u[:300] + u.std(axis=0) * rng.standard_normal((300, u.shape[1]))
    u = np.concatenate([u[:100], far])
    u = u[reduced_density.distance(setup.target.to_parameters(u)[0]) < RADIUS]
    check(setup.target(u), np.array([reduced_density.with_gradient(x)[0] for x in u]))
    return reduced_density


def beyond(reduced_density: Reduced, draws: np.ndarray) -> str:
    """Report how many parameters ``(.., 12)`` lie where the densities differ."""
    n = int((reduced_density.distance(draws.reshape(-1, draws.shape[-1])) > RADIUS).sum())
    return f"{n} draws beyond {RADIUS:g} sds" if n else ""


def nested(setup: Setup, seed: int) -> Measured:
    """Sample by static nested sampling in the same coordinates.

    The prior is no product there. So the base is a normal about the posterior, 2.5 times as wide,
    and the likelihood is the density over that normal's: the same posterior and evidence, from a
    far better start than the prior.
    """
    reduced_density = reduced(setup)
    u = setup.target.from_parameters(setup.pilot)
    mean, root = u.mean(axis=0), WIDER * np.linalg.cholesky(np.cov(u.T))
    inverse = np.linalg.inv(root)

    def log_likelihood(x: np.ndarray) -> float:
        z = inverse @ (x - mean)
        height = reduced_density.with_gradient(x)[0]
        return height + 0.5 * float(z @ z) if height > -np.inf else -1e300

    log_likelihood(mean)
    begin = time.process_time()
    sampler = dynesty.NestedSampler(
        log_likelihood,
        lambda c: mean + root @ ndtri(c),
        mean.size,
        nlive=LIVE,
        rstate=np.random.default_rng(seed),
    )
    finished, iterations = False, 0
    while not finished and time.process_time() - begin < LIMIT:
        sampler.run_nested(dlogz=DLOGZ, maxiter=500, add_live=False, print_progress=False)
        finished, iterations = sampler.it - iterations < 500, sampler.it
    sampler.run_nested(dlogz=DLOGZ, maxiter=0, add_live=True, print_progress=False)
    spent = time.process_time() - begin
    results = sampler.results
    draws = setup.target.to_parameters(np.asarray(results.samples))[0]
    weights = np.exp(results.logwt - np.max(results.logwt))
    note = beyond(reduced_density, draws[weights > 1e-6]) if finished else "cut off"
    calls = float(np.sum(results.ncall))
    return Measured(draws[None], 0.0, spent, calls, weights, LIVE, note)


class _Outside(ValueError):
    """Recoverable error: nutpie treats it as a divergence."""

    is_recoverable = True


def nuts(setup: Setup, seed: int) -> Measured:
    """Sample by nutpie's NUTS, low-rank mass matrix; every gradient is a call into Python."""
    reduced_density = reduced(setup)
    mode, root = setup.whitened()
    starts = np.ascontiguousarray(np.linalg.solve(root, (setup.starts(seed) - mode).T).T)
    reduced_density.with_gradient(mode)  # compiled
    used = 0

    def density(z: np.ndarray) -> tuple[float, np.ndarray]:
        height, gradient = reduced_density.with_gradient(mode + root @ z)
        if not np.isfinite(height):
            raise _Outside
        return height, gradient @ root

    def initial(_: int) -> np.ndarray:
        nonlocal used
        used += 1
        return starts[used % len(starts)]

    d = starts.shape[1]
    model = nutpie.compiled_pyfunc.from_pyfunc(
        d,
        lambda: density,
        lambda *_: lambda x: {"u": np.asarray(x)},
        [np.dtype("float64")],
        [(d,)],
        ["u"],
        make_initial_point_fn=initial,
    )
    begin = time.process_time()
    trace = nutpie.sample(
        model,
        draws=DRAWS,
        tune=TUNE,
        chains=CHAINS,
        cores=1,
        seed=seed,
        low_rank_modified_mass_matrix=True,
        target_accept=0.8,
        save_warmup=True,
        progress_bar=False,
    )
    spent = time.process_time() - begin
    before = float(trace.warmup_sample_stats["n_steps"].sum())
    after = float(trace.sample_stats["n_steps"].sum())
    u = mode + trace.posterior["u"].to_numpy() @ root.T
    draws = setup.target.to_parameters(u.reshape(-1, d))[0].reshape(u.shape)
    bad = int(trace.sample_stats["diverging"].sum())
    divergences = f"{bad} divergences" if bad else ""
    note = "; ".join(filter(None, [beyond(reduced_density, draws), divergences]))
    share = after / (before + after)
    return Measured(draws, spent * (1.0 - share), spent * share, after, None, CHAINS, note)


ARMS = {"dynesty": nested, "nutpie NUTS": nuts}
