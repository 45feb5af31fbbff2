"""Measured torque and position that simulations are compared with (output error)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.recordings.arrays import Array, Index, without_excluded
from bayesfric.recordings.measurement import Hold, Inputs, Measurement
from bayesfric.recordings.signals import Signals

# Fewer samples of a segment determine not much more than its two initial states.
_LEAST_SAMPLES = 20


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One recording for the output error, cut into segments with separate initial states."""

    name: str  # of the recording
    time: Array  # (N,) s since the file's first stamp
    position: Array  # (N,) of the joint as measured, not filtered, rad or m
    torque: Array  # (N,) of the motor as measured, not filtered, N m or N
    period: float  # s
    segments: Index  # (K, 2) half-open ranges of samples
    q0: Array  # (K,) starting values of position and speed at each segment's first sample
    qd0: Array
    inputs: Inputs
    hold: Hold = "linear"  # interpolation of the torque between samples

    @property
    def samples(self) -> Index:
        """Samples inside the segments, in order."""
        return np.concatenate([np.arange(a, b) for a, b in self.segments])

    @property
    def segment_of(self) -> Index:
        """Segment of every sample in :attr:`samples`."""
        return np.repeat(np.arange(len(self.segments)), np.diff(self.segments, axis=1)[:, 0])


def trajectory(recording: Measurement, observation: Signals, length: float) -> Trajectory:
    """Cut a recording into segments of about ``length`` (s; may be infinite) where it is fast."""
    if recording.integrated:
        problem = "has no position, to which the output error compares a simulation"
        hint = "record it, or leave output-error out"
        raise BadInput(f"recording '{recording.name}'", problem, hint)
    computed = recording.back_emf is not None or recording.feedback is not None
    if computed and observation.inputs.torque_rate is not None:
        problem = "a simulation cannot delay a torque that was computed from a voltage or target"
        raise BadInput(
            "mechanism.delay", problem, "give torque or current, or leave output-error out"
        )
    parts = without_excluded(recording.segments, recording.excluded)
    return Trajectory(
        name=recording.name,
        time=recording.time,
        position=recording.position,
        # a target is held, and the position moves on
        torque=recording.torque if recording.feedback is None else observation.torque,
        period=recording.period,
        inputs=observation.inputs,
        hold=recording.hold if recording.feedback is None else "linear",
        **_cut(parts, recording.name, recording.period, length, observation),
    )


def divided(long: Trajectory, observation: Signals, length: float) -> Trajectory:
    """Cut the segments of a trajectory into shorter ones, as in :func:`trajectory`."""
    ranges = [(int(a), int(b)) for a, b in long.segments]
    return replace(long, **_cut(ranges, long.name, long.period, length, observation))


def _cut(
    ranges: Sequence[tuple[int, int]],
    name: str,
    period: float,
    length: float,
    observation: Signals,
) -> dict[str, Any]:
    """Divide ranges about evenly, ``(K, 2)``, with initial states; too short segments go.

    Borders are where the joint is fastest within a quarter of a segment: at standstill, breakaway
    cannot be linearised in the state.
    """
    pieces: list[tuple[int, int]] = []
    speed = observation.qd
    for a, b in ranges:
        if length < _LEAST_SAMPLES * period:
            break
        parts = max(1, round((b - a) * period / length)) if np.isfinite(length) else 1
        borders = np.linspace(a, b, parts + 1).round().astype(int)
        # no segment may become too short
        reach = min((b - a) // (4 * parts), max(((b - a) // parts - _LEAST_SAMPLES - 1) // 2, 0))
        for i in range(1, parts):
            near = np.abs(speed[borders[i] - reach : borders[i] + reach + 1])
            # of equally fast samples the middle one, so that a steady motion is cut evenly
            fastest = np.flatnonzero(near >= near.max() * (1.0 - 1e-9))
            borders[i] += int(fastest[np.argmin(np.abs(fastest - reach))]) - reach
        pieces += [
            (first, last)
            for first, last in zip(borders[:-1].tolist(), borders[1:].tolist(), strict=True)
            if last - first >= _LEAST_SAMPLES
        ]
    if not pieces:
        raise BadInput(
            f"recording '{name}', segment",
            f"has no run of {_LEAST_SAMPLES} samples to simulate",
            f"give at least {_LEAST_SAMPLES * period:.3g} s, exclude less, or record longer",
        )
    segments = np.array(pieces, dtype=np.int64)
    starts = segments[:, 0]
    return {"segments": segments, "q0": observation.q[starts], "qd0": observation.qd[starts]}
