"""How wrong a format's joint is over the recorded range: in torque, and in motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayesfric.export.at_joint import (
    Moved,
    simulator_joint,
    simulator_vectors,
    torque_along,
)
from bayesfric.mechanism.forward import simulate_segments
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.trajectory import Trajectory
from bayesfric.report.summary.derived_quantities import rms_of

# Seconds of free motion over which two joints are compared, each time from the same state.
SPAN = 2.0


def wrong(
    chain: Joint,
    vector: Array,
    numbers: dict[str, Array],
    motions: Sequence[Moved],
    trajectories: Sequence[Trajectory],
    torque: Array | None = None,
) -> dict[str, Any]:
    """Replay recorded motion through the fitted joint and through a format's, and let both run.

    Parameters
    ----------
    chain, vector
        The fitted joint ``(d,)``. A delay is left out: it is of the recording.
    numbers
        Of the format, ``(1,)`` each.
    motions, trajectories
        Of the recordings.
    torque
        Motor torque ``(M,)`` by a law of the format's own, which is not let run.
    """
    here = vector[None].copy()
    if chain.delay_name:
        here[0, chain.names.index(chain.delay_name)] = 0.0
    whole = torque_along(chain, here, motions)[0]
    plain = simulator_joint(chain.load.motion, chain.load.gravity)

    motion: list[Array] = []
    if torque is None:
        there = simulator_vectors(plain, numbers)
        torque = np.asarray(torque_along(plain, there, motions)[0])
        motion = _motion(chain, here, plain, there, trajectories)
    apart = torque - whole
    return {
        "motor": {"rms": rms_of(apart), "largest": float(np.abs(apart).max())},
        "motion_rms": rms_of(np.concatenate(motion)) if motion else None,
        "motion_span": SPAN,
        "torque_rms": rms_of(whole),
    }


def _motion(
    chain: Joint, here: Array, plain: Joint, there: Array, trajectories: Sequence[Trajectory]
) -> list[Array]:
    """Simulate both joints; give how far apart they are, of each stretch that both get through."""
    apart = []
    for t in trajectories:
        given = (t.torque, t.period, t.segments, t.q0, t.qd0)
        options: dict[str, Any] = {
            "inputs": replace(t.inputs, recording=""),
            "begin": float(t.time[0]),
            "hold": t.hold,
        }
        mine, _ = simulate_segments(chain, here, *given, **options)
        other, _ = simulate_segments(plain, there, *given, **options)
        apart += [(mine - other)[0, a:b] for a, b in t.segments]
    return [one for one in apart if np.isfinite(one).all()]
