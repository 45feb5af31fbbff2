"""How wrong a format's joint is over the recorded range: in torque, and in motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from bayesfric.export.at_joint import (
    Array,
    Moved,
    simulator_joint,
    simulator_vectors,
    torque_along,
)
from bayesfric.mechanism.forward import simulate_segments
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.trajectory import Trajectory
from bayesfric.report.summary.derived_quantities import rms_of

# Seconds of free motion over which two joints are compared, each time from the same state.
SPAN = 2.0


@dataclass(frozen=True)
class Size:
    """How large a difference is over the recordings."""

    rms: float
    p90: float  # 90th percentile of its size
    largest: float


@dataclass(frozen=True, eq=False)
class Wrong:
    """What a format's joint does to torque and motion."""

    difference: Array  # (M,) along the recorded motion, measured motor torque, N m or N
    whole: Array  # (M,) torque of the fitted joint, as above
    free: Array  # (M,) what inertia, gravity and springs alone take of it
    load: Array  # (M,) torque of the link at the joint
    motor: Size
    joint: Size  # the same at the joint, times the gain
    # rad or m, SPAN s from the same state, of all stretches together and of the middle one; None
    # where none could be run
    motion_rms: float | None
    motion_median: float | None
    torque_rms: float  # of the fitted joint, to compare with

    def as_dict(self) -> dict[str, Any]:
        """Give the numbers as JSON holds them."""
        return {
            "motor": asdict(self.motor),
            "joint": asdict(self.joint),
            "motion_rms": self.motion_rms,
            "motion_median": self.motion_median,
            "motion_span": SPAN,
            "torque_rms": self.torque_rms,
        }


def wrong(
    chain: Joint,
    vector: Array,
    numbers: dict[str, Array],
    motions: Sequence[Moved],
    trajectories: Sequence[Trajectory],
) -> Wrong:
    """Replay recorded motion through the fitted joint and through a format's, and let both run.

    Parameters
    ----------
    chain, vector
        The fitted joint ``(d,)``. A delay is left out: it is of the recording.
    numbers
        Of the format, ``(1,)`` each.
    motions, trajectories
        Of the recordings.
    """
    here, whole = _fitted(chain, vector, motions)
    plain = simulator_joint(chain.load.motion, chain.load.gravity)
    there = simulator_vectors(plain, numbers)
    difference = torque_along(plain, there, motions)[0] - whole
    motion = _motion(chain, here, plain, there, trajectories)
    return _wrong(plain, difference, whole, numbers, motions, motion)


def wrong_by(
    chain: Joint,
    vector: Array,
    torque: Array,
    numbers: dict[str, Array],
    motions: Sequence[Moved],
) -> Wrong:
    """Compare the fitted joint with motor torque ``(M,)`` of a law of its own."""
    _, whole = _fitted(chain, vector, motions)
    plain = simulator_joint(chain.load.motion, chain.load.gravity)
    return _wrong(plain, torque - whole, whole, numbers, motions, ())


def _fitted(chain: Joint, vector: Array, motions: Sequence[Moved]) -> tuple[Array, Array]:
    here = vector[None].copy()
    if chain.delay_name:
        here[0, chain.names.index(chain.delay_name)] = 0.0
    return here, torque_along(chain, here, motions)[0]


def _wrong(
    plain: Joint,
    difference: Array,
    whole: Array,
    numbers: dict[str, Array],
    motions: Sequence[Moved],
    motion: Sequence[Array],
) -> Wrong:
    none = np.zeros(1)
    free = {**numbers, "friction": none, "damping": none, "quadratic": none}
    link = {**free, "armature": none, "torque_offset": none, "gain": np.ones(1)}
    without, load = (
        torque_along(plain, simulator_vectors(plain, one), motions)[0] for one in (free, link)
    )
    return Wrong(
        difference,
        whole,
        without,
        load,
        _size(difference),
        _size(float(numbers["gain"][0]) * difference),
        rms_of(np.concatenate(motion)) if motion else None,
        float(np.median([rms_of(x) for x in motion])) if motion else None,
        rms_of(whole),
    )


def _size(x: Array) -> Size:
    big = np.abs(x)
    return Size(rms_of(x), float(np.quantile(big, 0.9)), float(big.max()))


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
