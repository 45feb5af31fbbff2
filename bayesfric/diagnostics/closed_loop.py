"""What else explains the motion of a closed loop: the regression of its prediction errors.

A candidate is a torque along the motion that the model makes of the targets alone, which no error
of a prediction has touched (an instrument). What the filter makes of it in every prediction, over
the predictions' sds, is its column, less what the model's own terms along the same motion make of
it. Errors of a right model are independent and standard normal, which is what replicates hold.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial

import numpy as np

from bayesfric.diagnostics.candidates import columns_along
from bayesfric.diagnostics.explanation import Explanation, finding_of
from bayesfric.diagnostics.motion import MotionSignals, Scales, scales_of
from bayesfric.diagnostics.regression import (
    Regression,
    StoredColumns,
    draw_parameters,
    reported_gradients,
)
from bayesfric.diagnostics.statistics import (
    REPLICATES,
    TESTABLE,
    Columns,
    Key,
    Layout,
    basis_of,
    project_out,
)
from bayesfric.inference.closed_loop import ClosedLoopLikelihood
from bayesfric.inference.target import Target
from bayesfric.mechanism.closed_loop import follow
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.signals import Signals

# Simulated recordings for the calibration check.
_REPLICATES = 8
# Step of derivatives, as a share of a parameter.
_STEP = 1e-4


def explain_closed_loop(target: Target, parameters: Array, seed: int) -> Explanation:
    """Find what else explains the motion, at sampled parameters ``(d,)``."""
    begun, likelihood, count = time.process_time(), target.likelihood, len(target.free)
    assert isinstance(likelihood, ClosedLoopLikelihood)
    chain, observations = likelihood.chain, likelihood.observations
    values = target.chain_values(parameters[None])[0]
    noise = target.noise.scales(parameters[None, count:])
    free = np.array([name in target.free for name in chain.names])
    steps = _STEP * np.maximum(np.abs(values), 1e-12)
    prior_sds = np.array([prior.sd() for prior in target.priors[:count]])
    # of a value near zero the prior says what is small
    steps[free] = np.maximum(steps[free], 0.1 * _STEP * np.nan_to_num(prior_sds, posinf=0.0))
    scales = scales_of(chain, values, observations)
    base, left = _linearised(likelihood, values, noise, steps, free)
    keys, torques, full, terms = _effects(likelihood, values, noise, steps, free, scales)
    others = project_out(basis_of(terms), full)
    others *= np.linalg.norm(others, axis=0) > TESTABLE * np.linalg.norm(full, axis=0)
    layout = Layout(
        tuple(o.follows for o in likelihood.outputs),
        tuple(np.round((o.time - o.time[0]) / o.period).astype(int) for o in likelihood.outputs),
        tuple(o.time for o in likelihood.outputs),
    )
    data = Columns(base, others, left, layout, tuple(keys))
    right = StoredColumns(replace(data, residual=np.zeros_like(left)) for _ in range(REPLICATES))
    gradients = reported_gradients(chain, values, observations)
    fixed = set(chain.names) - set(target.free)
    regression = Regression(
        data,
        right,
        scales,
        np.maximum(np.abs(values), 1e-12),
        {n: x for n, x in gradients.items() if n not in fixed and np.isfinite(x).all()},
        np.random.SeedSequence(seed),
        torques=torques,
        effects_on_outputs=full,
    )
    effects = regression.effects()
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
    replicates = []
    for vector in draw_parameters(chain, values, data, _REPLICATES, random):
        simulated = _simulated(likelihood, vector, noise[0], random)
        base, left = _linearised(simulated, vector, noise, steps, free)
        if np.isfinite(base).all():
            replicates.append((vector, replace(data, base=base, residual=left)))
    return Explanation(
        tuple(finding_of(chain, effect) for effect in effects if effect.significant),
        regression.kinds,
        regression.indistinguishable,
        tuple(replicates),
        largest=effects[0].largest,
        limit=effects[0].limit,
        cpu_seconds=time.process_time() - begun,
        missing=regression.missing(observations),
    )


def _linearised(
    likelihood: ClosedLoopLikelihood, values: Array, noise: Array, steps: Array, free: Flags
) -> tuple[Array, Array]:
    """Return derivatives ``(M, d)`` of predictions by free parameters, and errors ``(M,)``.

    Both are over the sds of the predictions.
    """
    every = likelihood.errors(values + np.vstack([0.0 * values, np.diag(steps)[free]]), noise)
    errors = np.concatenate([e / np.sqrt(s[0]) for e, s in every], axis=1)
    base = np.zeros((errors.shape[1], values.size))
    base[:, free] = -(errors[1:] - errors[0]).T / steps[free]
    return base, errors[0]


def _effects(
    likelihood: ClosedLoopLikelihood,
    values: Array,
    noise: Array,
    steps: Array,
    free: Flags,
    scales: Scales,
) -> tuple[list[Key], Array, Array, Array]:
    """Return keys and torques ``(N, m)`` of all candidates, and what these do to predictions.

    The latter ``(M, m)``, and that of the model's own terms ``(M, k)``, are over the sds.
    """
    chain, blocks, torques, keys = likelihood.chain, list[Array](), list[Array](), list[Key]()
    for r in range(len(likelihood.observations)):
        motion = MotionSignals(chain, values, *_played(likelihood, values, r), scales)
        keys, columns = map(list, zip(*columns_along(motion), strict=True))
        played, at = motion.o, (motion.o.q, motion.o.qd, motion.o.qdd)
        torque = partial(inverse_torque, chain, inputs=played.inputs, time=played.stamps)
        terms = torque(values + np.diag(steps)[free], *at) - torque(values, *at)
        terms /= steps[free][:, None]
        z = np.nan_to_num(np.concatenate([np.array(columns), terms]))
        torques.append(z[: len(keys)].T)
        blocks.append(likelihood.effects(r, values, noise[0, r], z).T)
    effects, of_terms = np.split(np.concatenate(blocks), [len(keys)], axis=1)
    return keys, np.concatenate(torques), effects, of_terms


def _simulated(
    likelihood: ClosedLoopLikelihood, values: Array, noise: Array, random: np.random.Generator
) -> ClosedLoopLikelihood:
    """Replace readings by those of a simulated encoder on the motion that the targets make."""
    recordings = []
    for r, (recording, o) in enumerate(
        zip(likelihood.recordings, likelihood.observations, strict=True)
    ):
        push, encoder, instants = likelihood.draw_disturbance(
            values, noise[r], recording.time.size, recording.period, random
        )
        played, _ = _played(likelihood, values, r, push[None])
        q = played.q + encoder + instants * played.qd
        if step := o.position_step:
            q = step * np.round(q / step)
        recordings.append(replace(recording, position=q))
    return likelihood.of(recordings, values)


def _played(
    likelihood: ClosedLoopLikelihood, values: Array, r: int, push: Array | None = None
) -> tuple[Signals, Measurement]:
    """Replace a recording's motion by that which its targets, and a torque, make of the model."""
    o, recording = likelihood.observations[r], likelihood.recordings[r]
    assert recording.law is not None
    starts = [a for a, _ in recording.segments]
    q, qd = follow(
        likelihood.chain, values[None], recording.law, recording.period, recording.segments,
        o.q[starts], o.qd[starts], push=push, inputs=o.inputs, time=recording.time,
    )  # fmt: skip
    qdd = np.zeros_like(qd[0])
    for a, b in recording.segments:
        qdd[a:b] = np.gradient(qd[0, a:b], recording.period)
    return replace(o, q=q[0], qd=qd[0], qdd=qdd), replace(recording, position=q[0])
