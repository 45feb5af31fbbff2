"""The posterior of the benchmark, common to all samplers.

A **simulated** knee of Rabbit, Table 3 of the 2005 IFAC paper: 1 Hz square torque of 0.8 N m plus
a multisine, behind a 5 ms current loop, 1 kHz. (With the square alone emcee accepted 1.4 % of its
steps in a trial, with the multisine 6 %: this favours the rivals.) Position, speed and
acceleration are those of the simulation, and the measured torque is the true one plus white normal
noise of 0.02 N m. So the likelihood is exact: this measures samplers, not filters. Samples
at standstill are left out, because no inverse model predicts static friction.

Eleven parameters of the joint and the noise scale are free. Each has a log-normal prior, sd 1 of
its logarithm, around a value that is off Table 3 by up to 50 %; ``gearbox.load_back`` stays below
1, as in a gearbox that the leg can turn. In the logarithms, in which the rivals sample, these
priors are normal with sd 1, the simplest case.

``python studies/benchmark/problem.py problem.npz`` writes the rivals' input.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesfric.inference.fitting import make_target
from bayesfric.inference.priors import Prior, read_prior
from bayesfric.inference.start import climb, gauss_newton
from bayesfric.inference.target import Target
from bayesfric.mechanism.experiment import Simulation, record
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.recordings.filters import ParallelFilter
from bayesfric.recordings.measurement import Inputs
from bayesfric.recordings.signals import Signals

Array = NDArray[np.float64]

SAMPLES = 10_000
RATE = 1000.0  # Hz
TORQUE_NOISE = 0.02  # N m
SEED = 2005
PRIOR_SD = 1.0  # of the natural logarithm
# Chosen close to, but different from, Table 3 (noise: 0.02 N m).
PRIOR_MEDIANS = {
    "motor.inertia": 2.6e-4,
    "motor.viscous": 5.0e-3,
    "motor.coulomb_positive": 0.11,
    "motor.coulomb_negative": 0.080,
    "gearbox.load_drive": 0.25,
    "gearbox.load_back": 0.40,
    "joint.viscous": 2.5,
    "joint.coulomb_positive": 4.0,
    "joint.coulomb_negative": 6.5,
    "load.inertia": 0.30,
    "load.first_moment": 0.55,
    "noise.sigma": 0.03,
}
# In a gearbox that the leg can turn, mu_2 < 1.
PRIOR_UPPER = {"gearbox.load_back": 1.0}
N_STARTS = 1024
N_REFERENCES = 12


def knee() -> Joint:
    """Build the joint."""
    return PRESETS["rabbit-knee"].chain()


def truth() -> dict[str, float]:
    """Return the true values, including the noise scale."""
    return {**PRESETS["rabbit-knee"].values, "noise.sigma": TORQUE_NOISE}


def priors() -> dict[str, Prior]:
    """Return the priors of all twelve parameters."""
    return {
        name: read_prior(
            name,
            {"distribution": "lognorm", "s": PRIOR_SD, "scale": median},
            lower=0.0,
            upper=PRIOR_UPPER.get(name, float("inf")),
        )
        for name, median in PRIOR_MEDIANS.items()
    }


def observation(n_samples: int = SAMPLES, seed: int = SEED) -> Signals:
    """Simulate the recording and keep the first ``n_samples`` at which the joint moves."""
    simulation = Simulation(
        duration=1.05 * n_samples / RATE + 0.1,
        rate=RATE,
        excitation="square-multisine",
        amplitude=0.8,
        frequency=1.0,
        lag=0.005,
        encoder_counts=0,
        torque_noise=TORQUE_NOISE,
        seed=seed,
    )
    columns, motion, _ = record(knee(), simulation)
    moving = np.flatnonzero(motion.qd != 0.0)[:n_samples]
    if moving.size < n_samples:
        raise RuntimeError(f"the joint moves at {moving.size} samples only, not {n_samples}")
    torque = columns["torque"][moving]
    return Signals(
        name="simulated knee",
        q=motion.q[moving],
        qd=motion.qd[moving],
        qdd=motion.qdd[moving],
        torque=torque,
        compared=torque,
        # no filter: every sample is an output
        filter=ParallelFilter(np.ones(1), np.arange(n_samples), *np.ones((2, n_samples))),
        time=motion.time[moving],
        measured=torque,
        speed=motion.qd[moving],
        period=1.0 / RATE,
        segment_of=np.cumsum(np.diff(moving, prepend=moving[0] - 1) > 1).astype(np.int64),
        stamps=motion.time[moving],
        inputs=Inputs(),
        steps=("simulated motion as it was, torque with white noise, no filter",),
        warnings=(),
        settings={"sampling_rate": RATE, "n_outputs": n_samples},
    )


def target(n_samples: int = SAMPLES, seed: int = SEED) -> Target:
    """Build the posterior as ``bayesfric`` samples it; ``seed`` is that of the noise."""
    return make_target(knee(), [observation(n_samples, seed)], priors(), "shared")


def log_density_of_logarithms(target: Target, logarithms: Array) -> Array:
    """Return the log density of the parameters' logarithms, ``(n, 12)`` to ``(n,)``."""
    parameters = np.exp(logarithms)
    density = target.log_prior(parameters) + target.log_likelihood(parameters)
    return density + logarithms.sum(axis=1)


def starts(target: Target, n: int, rng: np.random.Generator) -> Array:
    """Draw starts close to the posterior, as logarithms ``(n, 12)``.

    From a Laplace approximation in the coordinates of ``bayesfric``. Rivals start there and need
    no search.
    """
    true = np.array([[truth()[name] for name in target.names]])
    mode = climb(target, target.from_parameters(true), climbs=1)
    drawn = np.stack([prior.draw(500, rng) for prior in target.priors], axis=1)
    laplace = gauss_newton(target, mode, target.from_parameters(drawn))
    coordinates = laplace.draw(n, target, rng, spread=1.0)
    return np.log(target.to_parameters(coordinates)[0])


def write(path: Path, n_samples: int = SAMPLES, seed: int = SEED) -> Target:
    """Write the problem for the rivals, and return its target.

    The file holds, for names in the order of ``names``:

    ``q, qd, qdd, torque``
        ``(N,)`` joint motion (rad, s) and measured motor torque (N m).
    ``prior``
        JSON: ``median``, ``sd`` of the logarithm and ``upper`` of each parameter, in order.
    ``ratio, gravity``
        Known constants of the joint.
    ``starts``
        ``(1024, 12)`` logarithms close to the posterior.
    ``reference_logarithms, reference_log_density``
        ``(12, 12)`` and ``(12,)``: values of ``bayesfric`` up to a constant, half of them close
        to the posterior and half far out.
    """
    posterior = target(n_samples, seed)
    chain, recording = posterior.likelihood.chain, posterior.likelihood.observations[0]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
    near = starts(posterior, N_STARTS, rng)
    true = np.log([truth()[name] for name in posterior.names])
    far = true + 0.3 * rng.standard_normal((N_REFERENCES // 2, true.size))
    references = np.concatenate([near[: N_REFERENCES - far.shape[0]], far])
    table = [
        {
            "name": name,
            "median": PRIOR_MEDIANS[name],
            "sd": PRIOR_SD,
            "upper": PRIOR_UPPER.get(name),
        }
        for name in posterior.names
    ]
    np.savez(
        path,
        names=np.array(posterior.names),
        q=recording.q,
        qd=recording.qd,
        qdd=recording.qdd,
        torque=recording.measured,
        prior=json.dumps(table),
        ratio=chain.ratio,
        gravity=chain.load.gravity,
        starts=near,
        reference_logarithms=references,
        reference_log_density=log_density_of_logarithms(posterior, references),
    )
    return posterior


if __name__ == "__main__":
    write(Path(sys.argv[1]))
