"""Which samples may be compared with a model: those that move, away from what is left out."""

from __future__ import annotations

import numpy as np

from bayesfric.recordings.arrays import Array, Flags, Segments, runs
from bayesfric.recordings.measurement import Measurement


def compared_parts(recording: Measurement, trim: int) -> Segments:
    """Give the stretches that may be compared: segments without ``trim`` samples at either end.

    Without what is excluded, too, and as many samples beside that: the low-pass carries it a little
    way past its borders, as past a segment's.
    """
    kept = trimmed(recording.segments, trim)
    return without_excluded(kept, near(recording.excluded, trim))


def trimmed(segments: Segments, trim: int) -> Segments:
    """Take ``trim`` samples off both ends of every segment; nothing may be left of one."""
    return tuple((a + trim, max(b - trim, a + trim)) for a, b in segments)


def moving_samples(qd: Array, segments: Segments, dead_zone: float, guard: int) -> Flags:
    """Flag the samples that may be used for their speed: those not below the dead zone.

    ``guard`` samples beside a rest are not used either: the low-pass carries its torque and speed
    a little way past its ends. As many slow samples in a row are a rest, fewer a reversal.
    """
    moving = np.abs(qd) >= dead_zone
    rests = resting(qd, segments, dead_zone, guard)
    return moving if not rests.any() else moving & ~near(rests, guard)


def too_slow(limit: str = "the dead zone") -> str:
    """Say of outputs why their speed leaves them out, as :func:`moving_samples` and windows do."""
    return (
        f"at joint speeds below {limit}, as at rest or where it turns round, or filtered together "
        "with such samples"
    )


def resting(qd: Array, segments: Segments, dead_zone: float, guard: int) -> Flags:
    """Flag samples below the dead zone, ``guard`` or more in a row."""
    flags = np.zeros(len(qd), dtype=np.bool_)
    for a, b in without_excluded(segments, np.abs(qd) >= dead_zone):
        flags[a:b] = b - a >= guard
    return flags


def near(flags: Flags, reach: int) -> Flags:
    """Flag what lies no more than ``reach`` samples from a flagged one."""
    n = len(flags)
    before = np.concatenate([[0], np.cumsum(flags)])
    index = np.arange(n)
    inside = before[np.minimum(index + reach + 1, n)] - before[np.maximum(index - reach, 0)]
    return np.asarray(inside > 0)


def without_excluded(segments: Segments, excluded: Flags) -> Segments:
    """Split segments at excluded samples, so that no window touches one."""
    return tuple(part for a, b in segments for part in runs(~excluded[a:b], a))
