"""A geared axis on a simulated bench, and what a default fit would sample of it."""

from functools import cache

import numpy as np
from scipy.linalg import block_diag, toeplitz

import bayesfric as bf
from bayesfric.diagnostics.statistics import Layout
from bayesfric.estimates import autoregression as ar
from bayesfric.fit.model import Model
from bayesfric.recordings.filters import ParallelFilter
from tests.axis import recording_of

TRUTH = {
    "motor.inertia": 2e-5,
    "motor.viscous": 4e-5,
    "motor.coulomb": 6e-3,
    "load.first_moment": 0.3,
    "offset": 1e-3,
}
# what published analyses do
CENTRAL = {"lowpass": "50 Hz", "decimate": 10, "differentiation": "central"}
QUICK = {"min_ess": 400, "ensembles": 2, "walkers": 24}


def axis(**more):
    motor = bf.Element("motor", inertia=True, coulomb="symmetric", viscous=True, ratio=50.0)
    return bf.Joint([motor], bf.Load(first_moment=True), **({"offset": True} | more))


@cache
def table(duration=10.0):
    """Record ten seconds, or more, at 500 Hz, in counts of 8192 a turn of the motor.

    It is simulated ten times finer, for the torque of a simulation is straight between samples.
    """
    options = {
        "duration": duration,
        "rate": 5000,
        "excitation": "multisine",
        "amplitude": 0.06,
        "lag": 0.003,
        "encoder_counts": 8192,
        "encoder_side": "motor",
        "torque_noise": 2e-4,
        "seed": 3,
    }
    return bf.simulate(axis(), TRUTH, **options)[::10]


def recording(columns=None):
    return recording_of(table() if columns is None else columns, side="motor")


def model(recordings=None, processing=None, joint=None, **tables):
    return Model(
        joint or axis(),
        recording(),
        processing=processing or {},
        self_check={} if recordings is None else {"recordings": recordings},
        sampling=QUICK | tables.pop("sampling", {}),
        **tables,
    )


def draws_about(values, share=0.01, n=4):
    """Vectors ``(n, n_parameters)`` scattered a little about one."""
    rng = np.random.default_rng(5)
    return np.asarray(values) * (1.0 + share * rng.standard_normal((n, len(values))))


def laid_out(*counts, gaps=(), rate=100.0):
    """Recordings of so many outputs, those at ``gaps`` missing from each."""
    at = [np.setdiff1d(np.arange(n), gaps) for n in counts]
    runs = tuple(np.diff(steps) == 1 for steps in at)
    return Layout(
        runs, tuple(steps - steps[0] for steps in at), tuple(steps / rate for steps in at)
    )


def autoregressive(partial, at):
    """Exact covariance of an autoregressive series at some of its steps."""
    known = list(ar.autocovariance(partial))
    phi = ar.predictors(partial[None])[-1][0]
    while len(known) <= at[-1]:
        known.append(float(phi @ np.array(known[-1 : -len(phi) - 1 : -1])))
    return toeplitz(known)[np.ix_(at, at)]


def dense_covariance(autocorrelation, layout):
    """Covariance ``(n, n)`` of noise in variances of its innovations, recording by recording."""
    blocks = [autoregressive(autocorrelation.partial, at) for at in layout.at]
    for block, t in zip(blocks, layout.stamps, strict=True):
        span = t[-1] - t[0]
        for k in range(1, 1 + int(min(max(2.0 * span, 4.0), t.size / 8, 60))):
            wave = np.cos(np.pi * k * (t - t[0]) / span) / np.sqrt(k)
            block += autocorrelation.drift**2 * np.outer(wave, wave)
    return block_diag(*blocks)


def every_sample(n):
    """Filter whose outputs are the ``n`` samples."""
    return ParallelFilter(np.ones(1), np.arange(n), np.ones(n), np.ones(n))
