"""Simulate recordings of an axis for the output-error likelihood, with noise on both signals.

The acting torque is the measured torque minus white noise, the measured position the simulated
one plus white noise. So the likelihood is right up to its linearisation, at the mode, of the
effects of torque noise and initial states.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.trajectory import Trajectory
from bayesfric.inference.fitting import target_of
from bayesfric.inference.position_likelihood import PositionLikelihood
from bayesfric.inference.priors import Prior, read_prior
from bayesfric.inference.target import Target
from bayesfric.mechanism.experiment import Simulation, record
from bayesfric.mechanism.forward import simulate_segments
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.recordings.filters import ParallelFilter
from bayesfric.recordings.measurement import Inputs
from bayesfric.recordings.signals import Signals

Array = NDArray[np.float64]

RATE = 200.0  # Hz
DURATION = 2.0  # s
SEGMENT = 50  # samples
SEED = 2005
# Medians of log-normal priors and the sd of the logarithm; the offset's is normal.
MEDIANS = {"noise.torque": 0.02, "noise.position": 1e-3}
PRIOR_SD = 0.3


def axis() -> Joint:
    """Build the joint: inertia, viscous and Coulomb friction, offset."""
    return PRESETS["motor-axis"].chain()


def priors() -> dict[str, Prior]:
    """Return the priors of the axis and of both noise scales."""
    infinite = float("inf")
    densities = {}
    for name, value in {**PRESETS["motor-axis"].values, **MEDIANS}.items():
        if name == "offset":
            text = {"distribution": "norm", "loc": 0.0, "scale": 0.02}
            densities[name] = read_prior(name, text, lower=-infinite, upper=infinite)
        else:
            text = {"distribution": "lognorm", "s": PRIOR_SD, "scale": value}
            densities[name] = read_prior(name, text, lower=0.0, upper=infinite)
    return densities


@lru_cache(maxsize=1)
def excitation() -> Array:
    """Return the measured torque ``(n,)``."""
    options = Simulation(
        duration=DURATION,
        rate=RATE,
        excitation="multisine",
        amplitude=3.0,
        encoder_counts=0,
        torque_noise=0.0,
        seed=SEED,
    )
    _, motion, _ = record(axis(), options)
    return np.asarray(motion.torque)


def recording(rng: np.random.Generator) -> tuple[Target, Array]:
    """Draw a truth from the priors and simulate its recording; return target and truth."""
    chain, densities = axis(), priors()
    truth = np.concatenate([p.draw(1, rng) for p in densities.values()])
    values = truth[: len(chain.names)]
    torque_sd, position_sd = truth[len(chain.names) :]
    torque, n, period = excitation(), excitation().size, 1.0 / RATE
    acting = torque - torque_sd * rng.standard_normal(n)
    segment = np.array([[0, n]])
    (q,), _ = simulate_segments(
        chain, values[None], acting, period, segment, np.zeros(1), np.zeros(1), substeps=8
    )
    qd, qdd = np.gradient(q, period), np.gradient(np.gradient(q, period), period)
    # segment borders at high speed, as in a fit: near a reversal linearisation fails
    even = np.arange(SEGMENT, n - SEGMENT // 2, SEGMENT)
    fast = [
        k - SEGMENT // 4 + int(np.argmax(np.abs(qd[k - SEGMENT // 4 : k + SEGMENT // 4])))
        for k in even
    ]
    starts = np.array([0, *fast])
    trajectory = Trajectory(
        name="axis",
        time=period * np.arange(n),
        position=q + position_sd * rng.standard_normal(n),
        torque=torque,
        period=period,
        segments=np.stack([starts, np.append(starts[1:], n)], axis=1),
        # where the linearisation begins; the likelihood integrates the states out
        q0=q[starts],
        qd0=qd[starts],
        inputs=Inputs(),
    )
    observation = Signals(
        name="axis",
        q=q,
        qd=qd,
        qdd=qdd,
        torque=torque,
        compared=torque,
        filter=ParallelFilter(np.ones(1), np.arange(n), *np.ones((2, n))),
        time=trajectory.time,
        measured=torque,
        speed=qd,
        period=period,
        segment_of=np.zeros(n, dtype=np.int64),
        stamps=trajectory.time,
        inputs=Inputs(),
        steps=("simulated motion as it was, to start the search from",),
        warnings=(),
        settings={"sampling_rate": RATE},
    )
    point = chain.vector(PRESETS["motor-axis"].values)
    likelihood = PositionLikelihood(chain, [trajectory], [observation], point)
    return target_of(likelihood, densities, "shared"), truth
