"""Checks of a signal: that it moves, is not clipped, and how coarse it is."""

from __future__ import annotations

from typing import Literal

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.recordings.arrays import Array, Flags, runs
from bayesfric.recordings.resolution import finest_step

# A step below this share of the range is rounding of numbers.
_NO_STEP = 1e-6
# Shorter runs of one value are expected in a quantised signal.
_RUN = 4
_CLIPPED_SHARE = 0.01
# Longest delay of a velocity that is searched for, s, and least unexplained share of its power.
_MAX_DELAY = 0.1
_UNEXPLAINED = 0.01
# Correlation of a measured velocity with the differentiated position above which they are the same
# signal, and below which unrelated; and the tolerance of their ratio.
_SAME, _UNRELATED, _FACTOR = 0.9, 0.3, 0.1
# Factors between units that are often confused, and the tolerance of a ratio.
_BETWEEN = {
    "deg and rad": 180.0 / np.pi,
    "rpm and rad/s": 30.0 / np.pi,
    "turn and rad": 2.0 * np.pi,
    "rpm and deg/s": 6.0,
    "thousandths and whole": 1e3,
}
_NEAR = 0.02
# Fewer distinct whole numbers may be a switched torque.
_COUNTS = 20
# A torque of two levels: their width, and the least share of samples on them and with the sign of
# the speed.
_LEVEL, _MOSTLY = 0.05, 0.9
# Speed, over its root mean square, below which a torque that follows the speed changes sign.
_SLOW = 0.2
# Share of a torque's variance that position and speed explain under simple feedback.
_FOLLOWS = 0.98
_LEAST_SAMPLES = 50

Feedback = Literal["sign of speed", "position error"]


def check_moves(values: Array, where: str, signal: str) -> None:
    """Refuse a signal that never changes."""
    if np.ptp(values) == 0:
        raise BadInput(
            where,
            f"the {signal} is {values[0]:.6g} in every sample",
            "check that this is the right column and that the joint moved",
        )


def check_size(values: Array, where: str, signal: str) -> None:
    """Refuse a signal of an impossible size in SI units."""
    largest = float(np.abs(values).max(initial=0.0))
    if not largest < 1e15:
        problem = f"the {signal} is at most {largest:.3g} in SI units"
        raise BadInput(where, problem, "check its unit")


def clipped(values: Array, signal: str) -> list[str]:
    """Warn of limits of a raw signal at which 1 % of the samples lie, in runs of 4 and more."""
    ends = {float(values.max()), float(values.min())}
    # a value below half of the largest is an idle drive, not a limited one
    limits = [end for end in sorted(ends) if 2 * abs(end) >= max(map(abs, ends))]
    share = sum(b - a for end in limits for a, b in runs(values == end) if b - a >= _RUN)
    if share < _CLIPPED_SHARE * len(values):
        return []
    return [
        f"{signal}: stays at {' or '.join(f'{end:.6g}' for end in limits)} (raw) for "
        f"{100 * share / len(values):.2g} % of the samples; does the drive or sensor saturate "
        "there? A drive that gives no more is measured right; of a sensor that shows no more "
        "leave those seconds out (exclude)"
    ]


def quantisation(values: Array) -> float | None:
    """Return the quantisation step of a signal; None where there is none, or no value repeats."""
    if np.unique(values).size == values.size:
        return None
    step = finest_step(values)
    return step if step > _NO_STEP * float(np.ptp(values)) else None


def unwrapped(angle: Array) -> tuple[Array, int]:
    """Unwrap an angle in rad of the encoder's shaft, and count the jumps."""
    steps = np.diff(angle)
    jumps = np.abs(steps) > np.pi
    # an angle that covers more than a turn is unwrapped already
    if not jumps.any() or np.ptp(angle) > 2.0 * np.pi * (1.0 + 1e-6):
        return angle, 0
    # an undone jump must leave a step as small as the others
    turns = np.round(steps / (2.0 * np.pi))
    usual = float(np.abs(steps[~jumps]).max(initial=0.0))
    if np.abs(steps - 2.0 * np.pi * turns)[jumps].max() > 2.0 * usual:
        return angle, 0
    values = angle.copy()
    values[1:] -= 2.0 * np.pi * np.cumsum(turns)
    return values, int(np.count_nonzero(jumps))


def speed_mismatch(velocity: Array, differentiated: Array, usable: Flags) -> float | None:
    """Compare a measured velocity with the differentiated position, with the same filter.

    Returns their ratio where it differs from one by 10 % or more, and 0 where they are unrelated.
    """
    v, d = velocity[usable], differentiated[usable]
    power, other = float(v @ v), float(d @ d)
    if not power > 0.0 or not other > 0.0:
        return None
    correlation = float(v @ d) / np.sqrt(power * other)
    if abs(correlation) < _SAME:
        return 0.0 if abs(correlation) < _UNRELATED else None
    factor = float(v @ d) / other
    return factor if abs(factor - 1.0) > _FACTOR else None


def speed_delay(
    velocity: Array, differentiated: Array, usable: Flags, period: float
) -> float | None:
    """Estimate the delay, s, of a measured velocity behind the differentiated position.

    ``None`` where it is negligible, or explains less than half of what the two differ by.
    """
    at = np.flatnonzero(usable)
    furthest = min(round(_MAX_DELAY / period), at.size // 10)
    power = float(velocity[at] @ velocity[at])
    if furthest < 2 or not power > 0.0:
        return None
    at = at[(at >= furthest) & (at < velocity.size - furthest)]
    # most velocities have no delay, and every lag costs a product
    if (now := _unexplained(velocity[at], differentiated[at])) < _UNEXPLAINED:
        return None
    lags = np.arange(-furthest, furthest + 1)
    left = np.array([_unexplained(velocity[at], differentiated[at - lag]) for lag in lags])
    k = int(left.argmin())
    if not 0 < k < lags.size - 1 or left[k] > 0.5 * now:
        return None
    bend = left[k - 1] - 2.0 * left[k] + left[k + 1]
    return float((lags[k] + 0.5 * (left[k - 1] - left[k + 1]) / bend) * period)


def _unexplained(x: Array, y: Array) -> float:
    """Return the share of a signal's power that no multiple of another explains."""
    powers = float(x @ x) * float(y @ y)
    return 1.0 - float(x @ y) ** 2 / powers if powers > 0.0 else 1.0


def between(factor: float) -> str:
    """Name the units that a factor lies between; empty for none."""
    size = max(abs(factor), 1.0 / abs(factor)) if factor else 0.0
    named = (words for words, times in _BETWEEN.items() if abs(size / times - 1.0) < _NEAR)
    return next((f" (the factor between {words})" for words in named), "")


def whole_numbers(values: Array) -> bool:
    """Whether a raw signal holds whole numbers only, and enough of them to be counts."""
    return bool(np.all(values == np.round(values))) and np.unique(values).size > _COUNTS


def feedback(
    torque: Array, position: Array, velocity: Array, usable: Flags
) -> tuple[Feedback, float] | None:
    """Detect a torque that a controller computes from the motion by a simple law.

    The joint's friction or gravity is then not identified. Returns the law, and the share of the
    samples or of the torque's variance that it explains.
    """
    t, q, v = torque[usable], position[usable], velocity[usable]
    if t.size < _LEAST_SAMPLES or not np.ptp(t) > 0.0:
        return None
    size = float(np.median(np.abs(t)))
    two_levels = float(np.mean(np.abs(np.abs(t) - size) < _LEVEL * size))
    same = float(np.mean(np.sign(t) == np.sign(v)))
    # a joint reverses some time after an open-loop torque, and together with one that follows it
    turns = np.flatnonzero(np.diff(np.sign(torque)) != 0)
    at_turns = np.minimum(np.abs(velocity[turns]), np.abs(velocity[turns + 1]))
    follows = turns.size and float(np.median(at_turns)) < _SLOW * float(np.sqrt(np.mean(v**2)))
    if min(two_levels, same) > _MOSTLY and follows:
        return "sign of speed", same
    columns = np.column_stack([np.ones_like(t), q, v])
    gains = np.linalg.lstsq(columns, t, rcond=None)[0]
    share = 1.0 - float(np.var(t - columns @ gains) / np.var(t))
    if share > _FOLLOWS and gains[1] < 0.0 and np.var(gains[1] * q) > 0.5 * np.var(t):
        return "position error", share
    return None
