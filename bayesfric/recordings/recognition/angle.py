"""The likely unit of an angle: by the encoder's step, where it rests, its torque, and its range."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from bayesfric.huber import HUBER, robust_sd, shares
from bayesfric.recordings import units
from bayesfric.recordings.measurement import Array
from bayesfric.recordings.recognition import values as by_value
from bayesfric.recordings.resolution import finest_step

_UNITS = by_value.ANGLES
# Counts a turn of encoders, powers of two, and how well a step must tell one.
_COUNTS, _EXACT = tuple(2**bits for bits in range(8, 25)), 1e-4
# Ends in rad between which drives send an angle in 16 bits, in the MIT protocol: of T-Motor's AK
# series, first and second, and four pi.
_SENT, _CODES = (95.5, 12.5, 4.0 * math.pi), 65535.0
# A rest: its speed over the largest; how near it is to a half turn, over that; the share of rests
# that are, and at how many places apart from zero, with which share of the rests each.
_SLOW, _NEAR, _MOSTLY, _PLACES, _EACH = 0.02, 0.05, 0.8, 2, 0.01
# s over which torque and motion are averaged; the share of the torque that a unit must explain, and
# what it leaves at most over what the next best does.
_AVERAGED, _EXPLAINS, _BETTER = 0.1, 0.8, 0.5
# Of what slides, a travel in m that most axes have.
_SHORT = 1.0
_ROUNDS, _TINY = 20, 1e-30
# An angle in rad beyond that is more than four turns either way.
_MANY_TURNS = 8.0 * math.pi


# numbers that no joint has tell nothing
@np.errstate(all="ignore")
def angle_unit(
    position: Array, time: Array | None = None, effort: Array | None = None
) -> tuple[str, str]:
    """Give the likely unit of an angle, and why, with what others would mean.

    ``time`` in s and ``effort`` in any unit, both ``(n,)`` as the angle is, tell more.
    """
    low, high = float(position.min()), float(position.max())
    span = f"from {low:.4g} to {high:.4g}"
    if by_value.whole(position):
        return "turn/4096", f"whole numbers {span}: counts, of how many a turn is not in the log"
    means = (
        f"{span}, {(high - low) / (2.0 * math.pi):.3g} turns if it were rad, "
        f"{high - low:.4g} degrees if it were deg"
    )
    if high - low < _SHORT:
        means += f", {1e3 * (high - low):.4g} mm if it slides and is in m"
    if told := next(_evidence(position, time, effort), None):
        return told[0], f"{told[1]}; {means}"
    likely = "deg" if max(abs(low), abs(high)) > _MANY_TURNS else "rad"
    return likely, f"by its range alone: {means}"


def _evidence(
    position: Array, time: Array | None, effort: Array | None
) -> Iterator[tuple[str, str]]:
    """Look for what tells a unit, the surest first."""
    yield from _by_step(position)
    if time is not None:
        yield from _by_rests(position, time)
        if effort is not None:
            yield from _by_torque(position, time, effort)


def _by_step(position: Array) -> Iterator[tuple[str, str]]:
    """Look for the step of an encoder, or of the bus that its angle was sent over."""
    levels = np.unique(position)
    step = finest_step(position)
    if levels.size == position.size or not step > 0.0:
        return
    gaps = np.diff(levels)
    count = np.round(gaps / step)
    # numbers were rounded: all gaps together tell it best
    step = float(gaps[count > 0].sum() / count.sum())
    for unit in _UNITS:
        turn = 1.0 / (step * units.scale([unit], "angle") / (2.0 * math.pi))
        for counts in _COUNTS:
            if abs(turn / counts - 1.0) < _EXACT:
                yield unit, f"its step of {step:.4g} is a turn over {counts} in {unit}"
    for end in _SENT:
        if abs(step * _CODES / (2.0 * end) - 1.0) < _EXACT:
            yield "rad", f"its step of {step:.4g} is that of drives that send ±{end:.4g} rad"


def _by_rests(position: Array, time: Array) -> Iterator[tuple[str, str]]:
    """Look for rests hanging or balanced: at multiples of half a turn, in one unit only."""
    speed = np.abs(by_value.smooth(np.gradient(position, time)))
    slow = by_value.smooth(position)[speed < _SLOW * float(np.percentile(speed, 99))]
    for unit in _UNITS:
        x = slow * (units.scale([unit], "angle") / math.pi)
        near = np.round(x)[np.abs(x - np.round(x)) < _NEAR]
        places, counts = np.unique(near, return_counts=True)
        apart = (places != 0.0) & (counts > _EACH * x.size)
        if near.size > _MOSTLY * x.size and apart.sum() >= _PLACES and unit != "turn":
            rested = ", ".join(f"{place / 2:g}" for place in places[apart])
            yield unit, f"in {unit} it rests at {rested} turns, where a pendulum does"


def _by_torque(position: Array, time: Array, effort: Array) -> Iterator[tuple[str, str]]:
    """Gravity goes with the sine of the angle, which only one unit makes of many turns."""
    part = by_value.middle(position.size)
    left = {}
    for unit in _UNITS:
        found = _left(position[part] * units.scale([unit], "angle"), time[part], effort[part])
        if found is None:
            return
        left[unit] = found
    best, other = sorted(left, key=left.__getitem__)[:2]
    if left[best] < min(1.0 - _EXPLAINS, _BETTER * left[other]):
        one, two = (f"{max(0.0, 1.0 - left[unit]):.0%}" for unit in (best, other))
        yield (
            best,
            f"in {best} inertia, friction and gravity explain {one} of the torque, "
            f"in {other} {two}",
        )


def _left(q: Array, time: Array, effort: Array) -> float | None:
    """Share of the usual square of a torque that a motion leaves; hands that push count little."""
    from scipy.ndimage import uniform_filter1d

    width = max(3, round(_AVERAGED / float(np.median(np.diff(time)))))
    if q.size < 20 * width:
        return None

    def averaged(x: Array) -> Array:
        for _ in range(3):
            x = uniform_filter1d(x, width)
        return x[3 * width : -3 * width]

    smooth = uniform_filter1d(q, width)
    v = np.gradient(smooth, time)
    dry = np.tanh(v / (0.05 * v.std() + _TINY))
    terms = (np.ones_like(q), np.sin(q), np.cos(q), v, dry, np.gradient(v, time))
    columns = np.column_stack([averaged(x) for x in terms])
    columns /= np.sqrt(np.mean(columns**2, axis=0)) + _TINY
    y = averaged(effort)
    usual = float(np.median(np.abs(y - np.median(y))))
    weights, rest = np.ones_like(y), y
    if not 0.0 < usual < math.inf or not np.isfinite(columns).all() or not np.isfinite(y).all():
        return None
    for _ in range(_ROUNDS):
        root = np.sqrt(weights)
        try:
            found = np.linalg.lstsq(columns * root[:, None], y * root, rcond=None)[0]
        except np.linalg.LinAlgError:
            return None
        rest = y - columns @ found
        weights = shares(rest, max(HUBER * robust_sd(rest), _TINY))
    return float(np.median(np.abs(rest)) / usual) ** 2
