"""Check intervals by simulation-based calibration (Talts et al. 2018), SIMULATED recordings.

``python studies/calibration/calibrate.py`` draws true values from the priors, simulates a recording
of each, samples its posterior as ``fit`` does, and ranks the truth among the draws. Ranks must be
uniform and 90 % intervals hold the truth in 90 % of the recordings. Two wrong controls, white noise
on autoregressive data and emcee's biased snooker move, must fail. Writes ``result.json``, which
``figures.py`` draws and ``table.py`` prints; ``--recordings N`` and ``--cases A B`` for less.
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache

# Recordings are sampled in parallel processes, with one thread each.
if __name__ == "__main__":
    for variable in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")

import json
from pathlib import Path
from typing import Any

import emcee
import numpy as np
import position_case
from numpy.typing import NDArray
from ranks import summary_of

from bayesfric.base.errors import BadInput
from bayesfric.estimates.torque import filtered_torque
from bayesfric.inference import sampling
from bayesfric.inference.fitting import fit, make_target
from bayesfric.inference.noise import Autoregressive
from bayesfric.inference.priors import Prior, read_prior
from bayesfric.inference.sampling import Sampling
from bayesfric.inference.target import Target
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.experiment import Simulation, record
from bayesfric.mechanism.joint import PRESETS
from bayesfric.recordings.filters import ParallelFilter
from bayesfric.recordings.measurement import Inputs
from bayesfric.recordings.signals import Signals

Array = NDArray[np.float64]
FOLDER = Path(__file__).resolve().parent
SEED = 2005
RATE = 250.0  # Hz
DURATION = 4.0  # s
# Number of thinned draws among which the truth is ranked.
RANKED = 99
# Standard deviation of the logarithm of the priors, centred at Table 3.
PRIOR_SD = 0.3
SETTINGS = Sampling(min_ess=500.0, max_steps=4000, walkers=64, max_rhat=1.02)


@dataclass(frozen=True)
class Case:
    """True and assumed noise model of the torque; None for the output error."""

    true: Autoregressive | None
    assumed: Autoregressive | None
    move: str = "own"


CASES = {
    "white": Case(Autoregressive(0), Autoregressive(0)),
    "AR(1)": Case(Autoregressive(1), Autoregressive(1)),
    "AR(2)": Case(Autoregressive(2), Autoregressive(2)),
    "output error": Case(None, None),
    "control: white noise on AR(1) data": Case(Autoregressive(1), Autoregressive(0)),
    "control: snooker move": Case(Autoregressive(0), Autoregressive(0), "snooker"),
}


@lru_cache(maxsize=1)
def motions() -> tuple[Signals, Signals]:
    """Simulate two noise-free motions of the knee, the second with 2 kg at 0.35 m."""
    observations = []
    for amplitude, mass in ((0.9, 0.0), (1.2, 2.0)):
        options = Simulation(
            duration=DURATION,
            rate=RATE,
            excitation="square-multisine",
            amplitude=amplitude,
            encoder_counts=0,
            added_mass=mass,
            radius=0.35 if mass else 0.0,
            seed=SEED,
        )
        _, motion, _ = record(PRESETS["rabbit-knee"].chain(), options)
        moving = np.flatnonzero(motion.qd != 0.0)
        observations.append(
            Signals(
                name="loaded" if mass else "alone",
                q=motion.q[moving],
                qd=motion.qd[moving],
                qdd=motion.qdd[moving],
                torque=motion.torque[moving],
                compared=motion.torque[moving],
                filter=ParallelFilter(
                    np.ones(1), np.arange(moving.size), *np.ones((2, moving.size))
                ),
                time=motion.time[moving],
                measured=motion.torque[moving],
                speed=motion.qd[moving],
                period=1.0 / RATE,
                segment_of=np.cumsum(np.diff(moving, prepend=moving[0] - 1) > 1).astype(np.int64),
                stamps=motion.time[moving],
                inputs=Inputs(mass, 0.35 if mass else 0.0),
                steps=("simulated motion as it was",),
                warnings=(),
                settings={"sampling_rate": RATE},
            )
        )
    return observations[0], observations[1]


def priors(noise: Autoregressive) -> dict[str, Prior]:
    """Return the priors of the joint and of a noise model."""
    infinite = float("inf")
    densities = {}
    for p in PRESETS["rabbit-knee"].chain().parameters:
        value = PRESETS["rabbit-knee"].values[p.name]
        text = {"distribution": "lognorm", "s": PRIOR_SD, "scale": value}
        upper = 1.0 if p.name == "gearbox.load_back" else infinite
        densities[p.name] = read_prior(p.name, text, lower=0.0, upper=upper)
    sigma = {"distribution": "lognorm", "s": PRIOR_SD, "scale": 0.02}
    densities["noise.sigma"] = read_prior("noise.sigma", sigma, lower=0.0, upper=infinite)
    for quantity in noise.quantities[1:]:
        name = f"noise.{quantity}"
        text: Any = {"distribution": "gamma", "a": 2.0, "scale": 10.0}
        low, high = 1.0, infinite
        if quantity.startswith("pacf"):
            text, low, high = [0.2, 0.9] if quantity == "pacf_1" else [-0.6, 0.6], -1.0, 1.0
        densities[name] = read_prior(name, text, lower=low, upper=high)
    return densities


def recording(case: Case, rng: np.random.Generator) -> tuple[Target, Array]:
    """Draw a truth from the priors, simulate its recordings, and return the assumed target."""
    if case.true is None or case.assumed is None:
        return position_case.recording(rng)
    chain = PRESETS["rabbit-knee"].chain()
    source = make_target(chain, motions(), priors(case.true), "shared", case.true)
    truth = np.concatenate([p.draw(1, rng) for p in source.priors])
    values = source.chain_values(truth[None])
    scales = source.noise.scales(truth[None, len(source.free) :])
    observations = []
    for r, (signals, follows) in enumerate(
        zip(motions(), (output.follows for output in source.likelihood.outputs), strict=True)
    ):
        torque = filtered_torque(chain, signals, values)[0]
        torque = torque + case.true.draw(follows, scales[:, r], rng)[0]
        observations.append(replace(signals, torque=torque, measured=torque))
    target = make_target(chain, observations, priors(case.assumed), "shared", case.assumed)
    return target, truth[: len(target.names)]


def run_case(task: tuple[str, int]) -> dict[str, Any] | None:
    """Rank the truth of one recording among its posterior draws; ``None`` if it is refused.

    An output-error fit is refused if its linearisation fails over the posterior.
    """
    name, number = task
    case = CASES[name]
    seed = np.random.SeedSequence(SEED, spawn_key=(list(CASES).index(name), number))
    rng = np.random.default_rng(seed)
    target, truth = recording(case, rng)
    settings = SETTINGS.model_copy(update={"seed": int(rng.integers(2**31))})
    if case.true is None:  # every step simulates
        settings = settings.model_copy(update={"walkers": 12})
    if case.move == "snooker":
        settings, moves = settings.model_copy(update={"max_steps": 800}), sampling._moves
        mix = [(emcee.moves.DEMove(), 0.2), (emcee.moves.DESnookerMove(), 0.8)]
        sampling._moves = lambda *_: mix
        try:
            result = fit(target, settings)
        finally:
            sampling._moves = moves
    else:
        try:
            result = fit(target, settings)
        except BadInput:
            return None
    draws = result.posterior.flat()
    chosen = draws[rng.permutation(draws.shape[0])[:RANKED]]
    names, quantities = quantities_of(result.target, np.concatenate([truth[None], draws]))
    _, ranked = quantities_of(result.target, np.concatenate([truth[None], chosen]))
    low, high = np.quantile(quantities[:, 1:], [0.05, 0.95], axis=1)
    prior = np.array([p.sd() for p in result.target.priors])
    sds = draws.std(axis=0)
    return {
        "names": names,
        "rank": (ranked[:, 1:] < ranked[:, :1]).sum(axis=1).tolist(),
        "covered": ((low <= quantities[:, 0]) & (quantities[:, 0] <= high)).tolist(),
        "contraction": (1.0 - (sds / prior) ** 2).tolist(),
        "status": result.posterior.diagnostics.status,
        "seconds": result.posterior.diagnostics.seconds,
    }


def quantities_of(target: Target, vectors: Array) -> tuple[list[str], Array]:
    """Return parameters, noise scales and gauge-free combinations, ``(k, n)``."""
    names, rows = list(target.names), list(vectors.T)
    for q in derive(target.likelihood.chain, target.chain_values(vectors), 20.0):
        if q.gauge_free and np.isfinite(q.values).all():
            names.append(q.name)
            rows.append(q.values)
    return names, np.stack(rows)


def main() -> None:
    """Run all cases and save the result."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--recordings", type=int, default=500)
    parser.add_argument("--controls", type=int, default=200)
    parser.add_argument("--cases", nargs="*", default=list(CASES))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    path = FOLDER / "result.json"
    result = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    for name in options.cases:
        n = options.controls if name.startswith("control") else options.recordings
        with ProcessPoolExecutor(options.workers) as pool:
            outcomes = list(pool.map(run_case, [(name, i) for i in range(n)], chunksize=4))
        rows = [row for row in outcomes if row is not None]
        result[name] = {**summary_of(rows, RANKED), "refused": n - len(rows)}
        print(name, result[name]["recordings"], result[name]["statuses"], flush=True)
        path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
