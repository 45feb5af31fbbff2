"""NumPyro's NUTS: float64, dense mass matrix, log parameters.

``numpyro_nuts.py PROBLEM RESULT [--seconds S] [--warm-up N] [--seed N]``; ``--warm-up`` is a
number of draws, because adaptation plans its stages by it.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import result  # first: it limits the process to one core

# isort: split

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import posterior
from numpyro.infer import MCMC, NUTS
from numpyro.infer.hmc import HMCState

BLOCK = 10  # draws between time checks

jax.config.update("jax_enable_x64", True)


def potential(problem: posterior.Posterior) -> Callable[[jax.Array], jax.Array]:
    """Return minus the log density of a vector of logarithms as a function."""
    # rows, not columns: XLA is twice as fast this way
    motor, leg = jnp.asarray(problem.motor.T.copy()), jnp.asarray(problem.leg.T.copy())
    sign, torque = jnp.asarray(problem.sign), jnp.asarray(problem.torque)
    order = np.array([9, 6, 7, 8, 10])

    def minus_log_density(x: jax.Array) -> jax.Array:
        p = jnp.exp(x)
        leg_parameters = p[order]
        lambda1, lambda2 = 1.0 + 0.5 * (p[4] - p[5]), 0.5 * (p[4] + p[5])
        gearbox = leg_parameters @ leg
        residual = torque - p[:4] @ motor - lambda1 * gearbox - lambda2 * sign * jnp.abs(gearbox)
        density = -0.5 * (residual @ residual) / p[11] ** 2 - torque.size * x[11]
        density -= 0.5 * jnp.sum(((x - problem.prior_mean) / problem.prior_sd) ** 2)
        return jnp.where(jnp.any(x > problem.upper), jnp.inf, -density)

    return minus_log_density


def main() -> None:
    """Run NumPyro and write the result."""
    options = result.arguments(__doc__)
    problem = posterior.read(options.problem)
    energy = potential(problem)
    difference = problem.check(jax.jit(lambda x: -energy(x)))
    # at the default 0.8 a trial run had divergences (56 of 2060 draws) and standard deviations
    # far too small along the ridge: faster, but not this posterior
    kernel = NUTS(potential_fn=energy, dense_mass=True, target_accept_prob=0.95)
    begin = time.perf_counter()
    sampler = MCMC(kernel, num_warmup=int(options.warm_up), num_samples=1, progress_bar=False)
    start = jnp.asarray(problem.starts[0])
    sampler.warmup(jax.random.PRNGKey(options.seed), init_params=start)
    state = sampler.last_state

    # MCMC.run compiles at every call; this is its loop, compiled once
    def step(state: HMCState, _: None) -> tuple[HMCState, tuple[jax.Array, ...]]:
        state = kernel.sample(state, (), {})
        return state, (state.z, state.num_steps, state.diverging)

    block_of_steps = jax.jit(lambda state: jax.lax.scan(step, state, None, length=BLOCK))
    state, _ = jax.block_until_ready(block_of_steps(state))
    warm_up = time.perf_counter() - begin
    blocks, steps, divergent = [], 0, 0
    begin = time.perf_counter()
    while (seconds := time.perf_counter() - begin) < options.seconds:
        state, (block, number, flags) = jax.block_until_ready(block_of_steps(state))
        blocks.append(np.asarray(block))
        steps, divergent = steps + int(number.sum()), divergent + int(flags.sum())
    draws = np.concatenate(blocks)[None]
    result.write(
        options.result,
        "NumPyro NUTS, float64, dense mass matrix, log parameters",
        result.of_chains(problem.names, draws),
        seconds=seconds,
        warm_up_seconds=warm_up,
        evaluations=steps,
        difference=difference,
        versions={"numpyro": numpyro.__version__, "jax": jax.__version__},
        draws=draws.shape[1],
        gradients_per_draw=steps / draws.shape[1],
        divergent=divergent,
    )


if __name__ == "__main__":
    main()
