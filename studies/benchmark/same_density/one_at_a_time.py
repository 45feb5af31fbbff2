"""dynesty and nutpie on the compiled density of one vector, with its gradient by hand."""

from __future__ import annotations

import time

import dynesty
import numpy as np
import nutpie.compiled_pyfunc
import problem
from density import RADIUS, Reduced, check
from given import Given
from measured import Measured
from scipy.special import ndtri

LIVE = 1000
WIDER = 2.5  # of the posterior's sds, the base that dynesty begins from
DLOGZ = 0.1
MOST = 100.0  # CPU s
TUNE, DRAWS, CHAINS = 600, 4000, 4


def reduced(given: Given) -> Reduced:
    """Make the density for one vector, and compare it with the target's."""
    medians = np.array([problem.PRIOR_MEDIANS[name] for name in given.target.names])
    made = Reduced.of(given.target, given.pilot, medians, problem.PRIOR_SD)
    u = given.target.from_parameters(given.pilot)
    rng = np.random.default_rng(5)
    far = u[:300] + u.std(axis=0) * rng.standard_normal((300, u.shape[1]))
    u = np.concatenate([u[:100], far])
    u = u[made.distance(given.target.to_parameters(u)[0]) < RADIUS]
    check(given.target(u), np.array([made.one(x)[0] for x in u]))
    return made


def beyond(made: Reduced, draws: np.ndarray) -> str:
    """Say of parameters ``(.., 12)`` how many lie where the densities differ."""
    n = int((made.distance(draws.reshape(-1, draws.shape[-1])) > RADIUS).sum())
    return f"{n} draws beyond {RADIUS:g} sds" if n else ""


def nested(given: Given, seed: int) -> Measured:
    """Sample nested, statically, in the same coordinates.

    The prior is no product there. So the base is a normal about the posterior, wider by 2.5 in
    every direction, and the likelihood is the density over that normal's: the same posterior, and
    the same evidence, from a far better start than the prior.
    """
    made = reduced(given)
    u = given.target.from_parameters(given.pilot)
    mean, root = u.mean(axis=0), WIDER * np.linalg.cholesky(np.cov(u.T))
    inverse = np.linalg.inv(root)

    def log_likelihood(x: np.ndarray) -> float:
        z = inverse @ (x - mean)
        height = made.one(x)[0]
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
    while not finished and time.process_time() - begin < MOST:
        sampler.run_nested(dlogz=DLOGZ, maxiter=500, add_live=False, print_progress=False)
        finished, iterations = sampler.it - iterations < 500, sampler.it
    sampler.run_nested(dlogz=DLOGZ, maxiter=0, add_live=True, print_progress=False)
    spent = time.process_time() - begin
    found = sampler.results
    draws = given.target.to_parameters(np.asarray(found.samples))[0]
    weights = np.exp(found.logwt - np.max(found.logwt))
    note = beyond(made, draws[weights > 1e-6]) if finished else "cut off"
    calls = float(np.sum(found.ncall))
    return Measured(draws[None], 0.0, spent, calls, weights, LIVE, note)


class _Outside(ValueError):
    """Tells nutpie to turn back, for a divergence, and not to give up."""

    is_recoverable = True


def nuts(given: Given, seed: int) -> Measured:
    """Take nutpie's NUTS with its low-rank mass matrix; one call into Python for every gradient."""
    made = reduced(given)
    mode, root = given.whitened()
    starts = np.ascontiguousarray(np.linalg.solve(root, (given.starts(seed) - mode).T).T)
    made.one(mode)  # compiled
    used = 0

    def density(z: np.ndarray) -> tuple[float, np.ndarray]:
        height, gradient = made.one(mode + root @ z)
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
    draws = given.target.to_parameters(u.reshape(-1, d))[0].reshape(u.shape)
    bad = int(trace.sample_stats["diverging"].sum())
    note = "; ".join(filter(None, [beyond(made, draws), f"{bad} divergences" if bad else ""]))
    share = after / (before + after)
    return Measured(draws, spent * (1.0 - share), spent * share, after, None, CHAINS, note)


ARMS = {"dynesty": nested, "nutpie NUTS": nuts}
