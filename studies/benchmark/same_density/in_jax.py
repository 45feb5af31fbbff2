"""blackjax on the same density in JAX: NUTS, and HMC of many chains at once."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import arviz as az
import blackjax
import jax
import jax.numpy as jnp
import numpy as np
from density import Reduced, check
from given import Setup
from measured import Measured
from one_at_a_time import beyond, reduced

jax.config.update("jax_enable_x64", True)

WARM_UP = 1000
CHAINS, DRAWS = 4, 3000  # NUTS
MANY, STEPS = 64, 1000  # HMC
LENGTHS = (5, 7, 10, 14)  # of HMC's trajectories, tried in its warm-up
TRIED = 120


@dataclass(frozen=True)
class _Whitened:
    """The density in whitened coordinates, and starts."""

    setup: Setup
    reduced_density: Reduced
    density: Callable[[Any], Any]
    mode: np.ndarray
    root: np.ndarray
    starts: Any

    @classmethod
    def of(cls, setup: Setup, seed: int) -> _Whitened:
        reduced_density, (mode, root) = reduced(setup), setup.whitened()
        density = reduced_density.in_jax()
        u = setup.target.from_parameters(setup.pilot[:300])
        check(setup.target(u), np.asarray(jax.jit(jax.vmap(density))(u)))
        starts = jnp.asarray(np.linalg.solve(root, (setup.starts(seed) - mode).T).T)
        return cls(setup, reduced_density, lambda z: density(mode + root @ z), mode, root, starts)

    def measured(
        self,
        z: np.ndarray,
        warm_up: float,
        sampling: float,
        evaluations: float,
        divergent: int,
        note: str = "",
    ) -> Measured:
        u = self.mode + z.reshape(-1, z.shape[2]) @ self.root.T
        draws = self.setup.target.to_parameters(u)[0].reshape(z.shape)
        divergences = f"{divergent} divergences" if divergent else ""
        notes = [note, beyond(self.reduced_density, draws), divergences]
        return Measured(
            draws, warm_up, sampling, evaluations, None, len(z), "; ".join(filter(None, notes))
        )


def nuts(setup: Setup, seed: int) -> Measured:
    """Sample four chains sequentially, with dense mass matrix and window adaptation."""
    whitened = _Whitened.of(setup, seed)
    density, starts = whitened.density, whitened.starts
    begin = time.process_time()
    key, *keys = jax.random.split(jax.random.key(seed), CHAINS + 1)
    warm = blackjax.window_adaptation(blackjax.nuts, density, is_mass_matrix_diagonal=False)
    (_, settings), _ = warm.run(key, starts[0], WARM_UP)
    kernel = blackjax.nuts(density, **settings)

    @jax.jit
    def chain(key: Any, start: Any) -> Any:
        def step(state: Any, key: Any) -> Any:
            state, info = kernel.step(key, state)
            return state, (state.position, info.num_integration_steps, info.is_divergent)

        return jax.lax.scan(step, kernel.init(start), jax.random.split(key, DRAWS))[1]

    compiled = chain.lower(keys[0], starts[0]).compile()
    warm_up = time.process_time() - begin
    begin = time.process_time()
    chains = [jax.block_until_ready(compiled(k, starts[1 + i])) for i, k in enumerate(keys)]
    spent = time.process_time() - begin
    u = np.stack([np.asarray(positions) for positions, *_ in chains])[:, 50:]
    steps = float(sum(int(lengths.sum()) for _, lengths, _ in chains))
    divergent = int(sum(int(flags.sum()) for *_, flags in chains))
    return whitened.measured(u, warm_up, spent, steps, divergent)


def hmc(setup: Setup, seed: int) -> Measured:
    """Sample 64 chains in parallel; choose the trajectory's length in warm-up."""
    whitened = _Whitened.of(setup, seed)
    density, starts = whitened.density, whitened.starts[:MANY]
    begin = time.process_time()
    key, tuning, *keys = jax.random.split(jax.random.key(seed), len(LENGTHS) + 3)
    adaptation = blackjax.window_adaptation(
        blackjax.hmc, density, is_mass_matrix_diagonal=False, num_integration_steps=4
    )
    (_, settings), _ = adaptation.run(tuning, starts[0], WARM_UP)
    mass, size = settings["inverse_mass_matrix"], settings["step_size"]

    def runner(length: int, steps: int) -> Any:
        kernel = blackjax.hmc(density, size, mass, length)

        @jax.jit
        def run(key: Any, positions: Any) -> Any:
            def step(state: Any, key: Any) -> Any:
                state, info = jax.vmap(kernel.step)(jax.random.split(key, MANY), state)
                return state, (state.position, info.is_divergent)

            states = jax.vmap(kernel.init)(positions)
            return jax.lax.scan(step, states, jax.random.split(key, steps))[1]

        return run

    efficiency = {}
    for length, trial_key in zip(LENGTHS, keys, strict=False):
        u = np.asarray(runner(length, TRIED)(trial_key, starts)[0])
        starts = jnp.asarray(u[-1])
        ess = min(float(az.ess(c.T)) for c in np.moveaxis(u[TRIED // 3 :], 2, 0))
        efficiency[length] = ess / length
    best = max(efficiency, key=lambda length: efficiency[length])
    compiled = runner(best, STEPS).lower(key, starts).compile()
    warm_up = time.process_time() - begin
    begin = time.process_time()
    u, divergent = jax.block_until_ready(compiled(key, starts))
    spent = time.process_time() - begin
    u = np.swapaxes(np.asarray(u), 0, 1)
    evaluations = float(STEPS * MANY * best)
    return whitened.measured(u, warm_up, spent, evaluations, int(divergent.sum()), f"L = {best}")


ARMS = {"blackjax NUTS": nuts, "blackjax HMC": hmc}
