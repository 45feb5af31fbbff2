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
_HUGE = 1e15
# Latest that a velocity is looked for, s, and share of its power that it then must be off by.
_LATEST = 0.1
_COUNTS_AS = 0.01
# Correlation of a measured velocity with the differentiated position from which on they are
# taken for the same, and below which for strangers; and by how much their factor may differ from 1.
_ALIKE, _STRANGERS, _FACTOR = 0.9, 0.3, 0.1
# Factors of units that are taken for each other.
_NEAR = 0.05
_DEG = 180.0 / np.pi
_TAKEN = {
    "in deg/s and taken for rad/s, or the position in rad and taken for deg": _DEG,
    "in rpm and taken for rad/s": 30.0 / np.pi,
    "in turn/s and taken for rad/s": 0.5 / np.pi,
    "in rad/s and taken for deg/s, or the position in deg and taken for rad": 1.0 / _DEG,
    "in rad/s and taken for rpm": np.pi / 30.0,
    "in rad/s and taken for turn/s": 2.0 * np.pi,
    "in deg/s and taken for rpm": 6.0,
    "in thousandths and taken for whole, or the time in ms and taken for s": 1e3,
    "in whole and taken for thousandths, or the time in s and taken for ms": 1e-3,
}
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


def check_not_huge(values: Array, where: str, what: str) -> None:
    """Refuse a signal with a value, in SI, that no joint has, or that left floating point."""
    fine = np.abs(values) < _HUGE
    if not fine.all():
        raise BadInput(
            where,
            f"the {what} reaches {values[int(np.argmin(fine))]:.3g} in SI units",
            "check its unit",
        )


def check_size(values: Array, where: str, what: str) -> None:
    """Refuse a signal of a size that no joint has: its products would leave floating point."""
    largest = float(np.abs(values).max())
    if not 1 / _HUGE < largest < _HUGE:
        raise BadInput(where, f"the {what} is at most {largest:.3g} in SI units", "check its unit")


def clipped(values: Array, what: str) -> list[str]:
    """Warn of each limit of a raw signal at which 1 % of the samples lie, in runs of 4 and more."""
    most, least = float(values.max()), float(values.min())
    warnings = []
    for limits in [(most, least)] if most == -least else [(most,), (least,)]:
        share = sum(_in_runs(values == limit) for limit in limits) / len(values)
        # nearer to zero than half of all it is an idle drive, not a limited one
        if share >= _CLIPPED_SHARE and 2 * abs(limits[0]) >= max(abs(most), abs(least)):
            warnings.append(
                f"{what}: stays at {'±' * (len(limits) - 1)}{limits[0]:.6g} (raw) in this "
                f"recording, for {100 * share:.2g} % of the samples; does the drive or sensor "
                "saturate there? A drive that gives no more is measured right; of a sensor that "
                "shows no more leave those seconds out (exclude)"
            )
    return warnings


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


def taken_for(factor: float, ratio: float) -> str:
    """Say what a velocity would be that is so many times the differentiated position."""
    size = abs(factor)
    words = [word for word, times in _TAKEN.items() if abs(size / times - 1.0) < _NEAR]
    if abs(ratio) > 1.5 or abs(ratio) < 0.67:
        for side, times in (("the motor", abs(ratio)), ("the joint", 1.0 / abs(ratio))):
            if abs(size / times - 1.0) < _NEAR:
                words.append(f"that of {side}, or the position the other's (side)")
    turned = "with the sign turned around" if factor < 0.0 else ""
    if words:
        return f"is it {' or '.join(words)}{', ' + turned if turned else ''}"
    if turned and abs(size - 1.0) < _FACTOR:
        return "is its sign turned around (sign = -1)"
    return (
        "are its unit, sign and side right, and does no drive filter it (then leave its line out, "
        "and the position is differentiated)"
    )


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


def _in_runs(flags: Flags) -> int:
    return sum(b - a for a, b in runs(flags) if b - a >= _RUN)
