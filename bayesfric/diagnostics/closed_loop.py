"""What else explains the motion of a closed loop: the regression of its prediction errors.

A candidate is a torque along the motion that the model makes of the targets alone, which no error
of a prediction has touched (an instrument). Added to the joint in small, the filter says what it
does to every prediction; that, over the predictions' sds, is its column, less what the model's own
terms along the same motion make of it. Errors of a right model are independent and standard normal,
which is what replicates hold.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from bayesfric.diagnostics.candidates import columns_along
from bayesfric.diagnostics.explanation import Explanation, finding_of
from bayesfric.diagnostics.motion import MotionSignals, scales_of
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
from bayesfric.mechanism.closed_loop import ENCODER, INSTANTS, follow
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.signals import Signals

# Simulated recordings for the calibration check: they have no torque noise, so few suffice.
_REPLICATES = 8
# Torque of a candidate, as a share of the largest, by which its effect is differentiated.
_SMALL = 1e-2


def explain_closed_loop(target: Target, parameters: Array, seed: int) -> Explanation:
    """Find what else explains the motion, at sampled parameters ``(d,)``."""
    begun, likelihood = time.process_time(), target.likelihood
    assert isinstance(likelihood, ClosedLoopLikelihood)
    chain, observations = likelihood.chain, likelihood.observations
    values = target.chain_values(parameters[None])[0]
    noise = target.noise.scales(parameters[None, len(target.free) :])
    size, known = np.maximum(np.abs(values), 1e-12), set(chain.names) - set(target.free)
    free = np.array([name in target.free for name in chain.names])
    steps = np.diag(1e-4 * size)[free]
    errors, sds, base = _linearised(likelihood, values, noise, free)
    scales, blocks, keys = scales_of(chain, values, observations), [], list[Key]()
    torques = []
    for r in range(len(observations)):
        motion = MotionSignals(chain, values, *_played(likelihood, values, r), scales)
        keys, columns = map(list, zip(*columns_along(motion), strict=True))
        played, at = motion.o, (motion.o.q, motion.o.qd, motion.o.qdd)
        terms = inverse_torque(chain, values + steps, *at, inputs=played.inputs, time=played.stamps)
        terms -= inverse_torque(chain, values, *at, inputs=played.inputs, time=played.stamps)
        torques.append(np.nan_to_num(np.array(columns)).T)
        z = np.nan_to_num(np.concatenate([np.array(columns), terms / steps.sum(axis=1)[:, None]]))
        unit = _SMALL * scales.torque / np.maximum(np.abs(z).max(axis=1), 1e-300)
        pushes: list[Array | None] = [None] * len(observations)
        pushes[r] = -z * unit[:, None]
        pushed, _ = likelihood.errors(np.tile(values, (len(z), 1)), noise, pushes)[r]
        blocks.append(-((pushed - errors[r]) / sds[r]).T / unit * z.any(axis=1))
    outputs = likelihood.outputs
    layout = Layout(
        tuple(o.follows for o in outputs),
        tuple(np.round((o.time - o.time[0]) / o.period).astype(np.int64) for o in outputs),
        tuple(o.time for o in outputs),
    )
    others, terms = np.split(np.concatenate(blocks), [len(keys)], axis=1)
    full = others
    others = project_out(basis_of(terms), full)
    others *= np.linalg.norm(others, axis=0) > TESTABLE * np.linalg.norm(full, axis=0)
    left = np.concatenate(errors) / np.concatenate(sds)
    data = Columns(base, others, left, layout, tuple(keys))
    right = StoredColumns(replace(data, residual=np.zeros_like(left)) for _ in range(REPLICATES))
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
    vectors = draw_parameters(chain, values, data, _REPLICATES, random)
    replicates = [
        (vector, replace(data, base=rows, residual=np.concatenate(errors) / np.concatenate(sds)))
        for vector in vectors
        for errors, sds, rows in [
            _linearised(_simulated(likelihood, vector, noise[0], random), vector, noise, free)
        ]
        if np.isfinite(rows).all()
    ]
    gradients = {
        name: gradient
        for name, gradient in reported_gradients(chain, values, observations).items()
        if name not in known and np.isfinite(gradient).all()
    }
    regression = Regression(
        data,
        right,
        scales,
        size,
        gradients,
        np.random.SeedSequence(seed),
        torques=np.concatenate(torques),
        effects_on_outputs=full,
    )
    effects = regression.effects()
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
    likelihood: ClosedLoopLikelihood, values: Array, noise: Array, free: Flags
) -> tuple[list[Array], list[Array], Array]:
    """Return prediction errors ``(M,)`` and sds of each recording, and derivatives ``(M, d)``.

    The latter are those of predictions over their sds, by the ``free`` parameters.
    """
    steps = np.diag(1e-4 * np.maximum(np.abs(values), 1e-12))[free]
    every = likelihood.errors(np.concatenate([values[None], values + steps]), noise)
    errors, sds = [e[0] for e, _ in every], [np.sqrt(s[0]) for _, s in every]
    base = np.zeros((sum(e.size for e in errors), values.size))
    base[:, free] = np.concatenate(
        [-(e[1:] - e[0]).T / sd[:, None] for (e, _), sd in zip(every, sds, strict=True)]
    ) / steps.sum(axis=1)
    return errors, sds, base


def _simulated(
    likelihood: ClosedLoopLikelihood, values: Array, noise: Array, random: np.random.Generator
) -> ClosedLoopLikelihood:
    """Replace readings by those of a simulated encoder on the motion that the targets make."""
    recordings = []
    for r, (recording, o) in enumerate(
        zip(likelihood.recordings, likelihood.observations, strict=True)
    ):
        played, _ = _played(likelihood, values, r)
        instants, encoder = noise[r, INSTANTS], noise[r, ENCODER]
        q = played.q + played.qd * instants * random.standard_normal(played.q.size)
        q += encoder * random.standard_normal(q.size)
        if step := o.position_step:
            q = step * np.round(q / step)
        recordings.append(replace(recording, position=q))
    return likelihood.of(recordings, values)


def _played(likelihood: ClosedLoopLikelihood, values: Array, r: int) -> tuple[Signals, Measurement]:
    """Replace a recording's motion by the one that its targets make of the model."""
    o, recording = likelihood.observations[r], likelihood.recordings[r]
    assert recording.law is not None
    starts = [a for a, _ in recording.segments]
    state, options = (o.q[starts], o.qd[starts]), {"inputs": o.inputs, "time": recording.time}
    q, qd = follow(
        likelihood.chain, values[None], recording.law, recording.period, recording.segments,
        *state, **options,
    )  # fmt: skip
    qdd = np.zeros_like(qd[0])
    for a, b in recording.segments:
        qdd[a:b] = np.gradient(qd[0, a:b], recording.period)
    return replace(o, q=q[0], qd=qd[0], qdd=qdd), replace(recording, position=q[0])
