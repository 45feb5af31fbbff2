"""Checks of a signal: that it moves, is not clipped, and how coarse it is."""

from __future__ import annotations

from typing import Literal

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.recordings.arrays import Array, Flags, runs
from bayesfric.recordings.resolution import finest_step

# A step below this share of the range is rounding of numbers.
_NO_STEP = 1e-6
# Shorter runs of one value are chance in a quantised signal
_RUN = 4
_CLIPPED_SHARE = 0.01
# What no signal reaches, and what it is to reach for its products to stay in floating point.
_HUGE, TINY = 1e15, 1e-15
# Latest that a velocity is looked for, s, and share of its power that it then must be off by.
_LATEST = 0.1
_COUNTS_AS = 0.01
# Correlation of a measured velocity with the differentiated position from which on they are
# taken for the same, and below which for strangers; and by how much their factor may differ from 1.
_ALIKE, _STRANGERS, _FACTOR = 0.9, 0.3, 0.1
# Factors between units that are taken for each other, and how near to one of them a factor is it.
_BETWEEN = {
    "deg and rad": 180.0 / np.pi,
    "rpm and rad/s": 30.0 / np.pi,
    "turn and rad": 2.0 * np.pi,
    "rpm and deg/s": 6.0,
    "thousandths and whole": 1e3,
}
_NEAR = 0.02
# Whole numbers of fewer kinds may be a torque that is switched.
_COUNTS = 20
# A torque of two levels: their width, and the share of samples on them and in step with speed.
_LEVEL, _MOSTLY = 0.05, 0.9
# Speed, over its root mean square, below which a torque turns that follows the speed.
_SLOW = 0.2
# Share of a torque's variance that position and speed explain where a controller makes it of them.
_FOLLOWS = 0.98
_LEAST_SEEN = 50

Feedback = Literal["sign of speed", "position error"]


def check_moves(values: Array, where: str, what: str) -> None:
    """Refuse a signal that never changes; ``where`` names it, ``what`` says what it is."""
    if np.ptp(values) == 0:
        raise BadInput(
            where,
            f"the {what} is {values[0]:.6g} in every sample",
            "check that this is the right column and that the joint moved",
        )


def check_size(values: Array, where: str, what: str, least: float = 0.0) -> None:
    """Refuse a signal of a size, in SI units, that no joint has, or that left floating point."""
    largest = float(np.abs(values).max(initial=0.0))
    if not least <= largest < _HUGE:
        raise BadInput(where, f"the {what} is at most {largest:.3g} in SI units", "check its unit")


def clipped(values: Array, what: str) -> list[str]:
    """Warn of limits of a raw signal at which 1 % of the samples lie, in runs of 4 and more."""
    ends = {float(values.max()), float(values.min())}
    # nearer to zero than half of all it is an idle drive, not a limited one
    limits = [end for end in sorted(ends) if 2 * abs(end) >= max(map(abs, ends))]
    share = sum(b - a for end in limits for a, b in runs(values == end) if b - a >= _RUN)
    if share < _CLIPPED_SHARE * len(values):
        return []
    return [
        f"{what}: stays at {' or '.join(f'{end:.6g}' for end in limits)} (raw) for "
        f"{100 * share / len(values):.2g} % of the samples; does the drive or sensor saturate "
        "there? A drive that gives no more is measured right; of a sensor that shows no more "
        "leave those seconds out (exclude)"
    ]


def quantisation(values: Array) -> float | None:
    """Return the step in which a signal is read; None where no reading repeats, or for none.

    However long the recording is: the same sensor has the same step.
    """
    if np.unique(values).size == values.size:
        return None
    step = finest_step(values)
    return step if step > _NO_STEP * float(np.ptp(values)) else None


def unwrapped(angle: Array) -> tuple[Array, int]:
    """Undo the jumps of an angle in rad that is told within one turn, and count them.

    It is that of the shaft the encoder is on, and begins where it began.
    """
    steps = np.diff(angle)
    jumps = np.abs(steps) > np.pi
    # an angle that covers more than a turn is counted through already
    if not jumps.any() or np.ptp(angle) > 2.0 * np.pi * (1.0 + 1e-6):
        return angle, 0
    # what stays after a jump is undone must be a motion: as small as the other steps
    turns = np.round(steps / (2.0 * np.pi))
    usual = float(np.abs(steps[~jumps]).max(initial=0.0))
    if np.abs(steps - 2.0 * np.pi * turns)[jumps].max() > 2.0 * usual:
        return angle, 0
    values = angle.copy()
    values[1:] -= 2.0 * np.pi * np.cumsum(turns)
    return values, int(np.count_nonzero(jumps))


def speed_mismatch(velocity: Array, differentiated: Array, usable: Flags) -> float | None:
    """Compare a measured velocity with the differentiated position, filtered alike.

    Returns the factor between them where it is no factor of one: beyond 10 %, and more than the two
    series' own scatter explains. 0 where they have nothing to do with each other.
    """
    v, d = velocity[usable], differentiated[usable]
    power, other = float(v @ v), float(d @ d)
    if not power > 0.0 or not other > 0.0:
        return None
    alike = float(v @ d) / np.sqrt(power * other)
    if abs(alike) < _ALIKE:
        return 0.0 if abs(alike) < _STRANGERS else None
    factor = float(v @ d) / other
    return factor if abs(factor - 1.0) > _FACTOR else None


def speed_delay(
    velocity: Array, differentiated: Array, usable: Flags, period: float
) -> float | None:
    """Tell by how many seconds a measured velocity comes after the differentiated position.

    ``None`` where that is next to nothing, or no delay makes them alike: as much of the velocity
    as counts is not the differentiated position's, and half of it is that of another time.
    """
    at = np.flatnonzero(usable)
    most = min(round(_LATEST / period), at.size // 10)
    power = float(velocity[at] @ velocity[at])
    if most < 2 or not power > 0.0:
        return None
    at = at[(at >= most) & (at < velocity.size - most)]
    # most velocities are alike as they are, and the others' lags cost a product each
    if (now := _not_alike(velocity[at], differentiated[at])) < _COUNTS_AS:
        return None
    lags = np.arange(-most, most + 1)
    left = np.array([_not_alike(velocity[at], differentiated[at - lag]) for lag in lags])
    k = int(left.argmin())
    if not 0 < k < lags.size - 1 or left[k] > 0.5 * now:
        return None
    bend = left[k - 1] - 2.0 * left[k] + left[k + 1]
    return float((lags[k] + 0.5 * (left[k - 1] - left[k + 1]) / bend) * period)


def _not_alike(x: Array, y: Array) -> float:
    """Give the share of one's power that no multiple of the other makes up."""
    powers = float(x @ x) * float(y @ y)
    return 1.0 - float(x @ y) ** 2 / powers if powers > 0.0 else 1.0


def between(factor: float) -> str:
    """Say between which units a factor is that of them; empty for none."""
    size = max(abs(factor), 1.0 / abs(factor)) if factor else 0.0
    named = (words for words, times in _BETWEEN.items() if abs(size / times - 1.0) < _NEAR)
    return next((f" (the factor between {words})" for words in named), "")


def whole_numbers(values: Array) -> bool:
    """Whether a raw signal holds whole numbers only, and enough of them to be counts."""
    return bool(np.all(values == np.round(values))) and np.unique(values).size > _COUNTS


def feedback(
    torque: Array, position: Array, velocity: Array, usable: Flags
) -> tuple[Feedback, float] | None:
    """Look for a torque that a controller makes of the motion by a simple law.

    Such a law and the joint's own cannot be told apart: a torque that is a constant times the
    sign of speed looks like Coulomb friction, one that falls with position like negative gravity.
    Returns the law, and the share of the samples or of the torque's variance that it explains.
    """
    t, q, v = torque[usable], position[usable], velocity[usable]
    if t.size < _LEAST_SEEN or not np.ptp(t) > 0.0:
        return None
    size = float(np.median(np.abs(t)))
    two_levels = float(np.mean(np.abs(np.abs(t) - size) < _LEVEL * size))
    same = float(np.mean(np.sign(t) == np.sign(v)))
    # a joint turns some time after a torque that is played, and with one that follows it
    turns = np.flatnonzero(np.diff(np.sign(torque)) != 0)
    at_turns = np.minimum(np.abs(velocity[turns]), np.abs(velocity[turns + 1]))
    follows = turns.size and float(np.median(at_turns)) < _SLOW * float(np.sqrt(np.mean(v**2)))
    if min(two_levels, same) > _MOSTLY and follows:
        return "sign of speed", same
    columns = np.column_stack([np.ones_like(t), q, v])
    found = np.linalg.lstsq(columns, t, rcond=None)[0]
    left = t - columns @ found
    share = 1.0 - float(np.var(left) / np.var(t))
    if share > _FOLLOWS and found[1] < 0.0 and np.var(found[1] * q) > 0.5 * np.var(t):
        return "position error", share
    return None
