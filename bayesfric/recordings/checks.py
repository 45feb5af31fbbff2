"""Checks of signals: motion and standstill, limits, encoder steps, and signals that disagree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from bayesfric.base.errors import BadInput
from bayesfric.recordings import arrays
from bayesfric.recordings.arrays import Array, Flags, Index, Segments, near, rms, runs
from bayesfric.recordings.filters import finest_step, lay_windows
from bayesfric.recordings.measurement import Measurement

Feedback = Literal["sign of speed", "position error"]

# --- raw signals --------------------------------------------------------------------------------


def check_moves(values: Array, where: str, signal: str) -> None:
    """Refuse a signal that never changes."""
    if np.ptp(values) == 0:
        problem = f"the {signal} is {values[0]:.6g} in every sample"
        raise BadInput(where, problem, "check that this is the right column and the joint moved")


def clipped(values: Array, signal: str, *, least: float = 0.01, run: int = 4) -> list[str]:
    """Warn of limits of a raw signal where a share ``least`` lies, in runs of ``run`` or more."""
    ends = {float(values.max()), float(values.min())}
    # a value below half of the largest is an idle drive, not a limited one
    limits = [end for end in sorted(ends) if 2 * abs(end) >= max(map(abs, ends))]
    share = sum(b - a for end in limits for a, b in runs(values == end) if b - a >= run)
    if share < least * len(values) or len(ends) == 1:  # a constant is an input
        return []
    if signal == "voltage" and np.unique(values).size < 4:  # switched
        return []
    text = f"{signal}: stays at {' or '.join(f'{end:.6g}' for end in limits)} (raw) for"
    text += f" {100 * share / len(values):.2g} % of the samples; where a sensor saturates there"
    return [f"{text}, exclude those seconds; a drive that gives no more is measured right"]


def quantisation(values: Array) -> float | None:
    """Return the quantisation step of a signal; None where there is none, or no value repeats."""
    if np.unique(values).size == values.size:
        return None
    step = finest_step(values)
    # smaller ones are rounding of numbers
    return step if step > 1e-6 * float(np.ptp(values)) else None


def unwrapped(values: Array, turn: float | None = None) -> tuple[Array, float, int]:
    """Undo the jumps of a counter ``(n,)``, NaN in holes; returns where it wraps, and how often.

    It wraps at a ``turn``, whole numbers at 2^8 to 2^32, or where it jumps against its motion.
    Jumps that remain have no modulus (0).
    """
    at = np.flatnonzero(np.isfinite(values))
    finite = values[at]
    steps, span = np.diff(finite), float(np.ptp(finite)) if at.size else 0.0
    if not steps.size or np.abs(steps).max() <= 0.5 * span:
        return values, 0.0, 0
    rows, is_integer = np.diff(at), bool(np.all(finite == np.round(finite)))
    # a counter jumps against the motion, by a modulus less a step of it
    is_jump = np.abs(steps) > 0.5 * span
    usual = float((np.abs(steps) / rows)[~is_jump].max(initial=0.0))
    inner = np.where(is_jump, np.nan, steps / rows)
    around = np.nan_to_num([np.append(np.nan, inner[:-1]), np.append(inner[1:], np.nan)]).T
    motion = around[is_jump].sum(axis=1) / np.maximum((around[is_jump] != 0.0).sum(axis=1), 1)
    jumped = steps[is_jump]
    sizes = np.abs(jumped - motion * rows[is_jump])
    reset = max(float(np.median(sizes)), span)
    # the roundest number that is no further away than a step
    tens = (10.0**k for k in range(int(np.log10(reset)), int(np.log10(reset)) - 8, -1))
    round_numbers = (np.ceil(span / ten - 1e-9) * ten for ten in tens)
    reset = next((x for x in round_numbers if abs(x - reset) <= usual), reset)
    against = np.mean(jumped * motion < 0.0) > 0.75
    # one jump may be of a clock that was started again, but by a decade, a minute, an hour or a day
    digits = float(f"{reset:.6e}".partition("e")[0])
    against = against and (jumped.size > 1 or digits in (1.0, 6.0, 3.6, 8.64))
    moduli = [*([turn] if turn else []), *(2.0 ** np.arange(8, 33) if is_integer else ())]
    for modulus in [*moduli, *([reset] if against else [])]:
        jumps = np.abs(steps) > modulus / 2.0
        if not jumps.any() or span > modulus * (1.0 + 1e-6):
            continue
        # an undone jump must leave a step as small as the others
        turns = np.round(steps / modulus)
        largest = float((np.abs(steps) / rows)[~jumps].max(initial=0.0))
        if np.all((np.abs(steps - modulus * turns) / rows)[jumps] <= 2.0 * largest):
            undone = values.copy()
            undone[at[1:]] -= modulus * np.cumsum(turns)
            return undone, float(modulus), int(np.count_nonzero(jumps))
    return values, 0.0, jumped.size if np.abs(jumped).min() > 4.0 * usual else 0


def failed_reads(values: Array, longest: int | None) -> tuple[Flags, float]:
    """Flag rows ``(n,)`` of failed reads, up to ``longest`` in a row; returns also their value.

    Zeros between values far from zero, or a whole number further from all others than these lie
    from each other.
    """
    at = np.flatnonzero(np.isfinite(values))
    finite, flags = values[at], np.zeros(values.size, dtype=np.bool_)
    low, high = finite.min(initial=np.inf), finite.max(initial=-np.inf)
    inner = finite[(finite > low) & (finite < high)]
    # an end, and the ends of all other values, of which there are three at least
    ends = [(high, inner.max(), low), (low, inner.min(), high)] if inner.size else []
    ends = ends if inner.size and np.ptp(inner) else []
    codes = [x for x, a, b in ends if abs(x - a) > abs(a - b) and x == np.round(x)]
    del inner
    for code in (*codes, 0.0):
        shifted = finite - code
        failed = [x for x in runs(shifted == 0.0) if longest is None or x[1] - x[0] <= longest]
        # one row may be a shock
        if not failed or not shifted.any() or (code and not 1 < len(failed) < 0.1 * at.size):
            continue
        begin, end = np.array(failed).T
        # at an end the neighbour on the other side counts twice
        before = shifted[np.where(begin > 0, begin - 1, end % at.size)]
        after = shifted[np.where(end < at.size, end, begin - 1)]
        same = before * after > 0.0
        begin, end, near_by = begin[same], end[same], np.minimum(abs(before), abs(after))[same]
        steps = np.append(np.abs(np.diff(shifted)), 0.0)
        steps[begin - 1] = steps[end - 1] = 0.0
        far = near_by > 2.0 * steps.max(initial=0.0)
        for a, b in zip(begin[far].tolist(), end[far].tolist(), strict=True):
            flags[at[a:b]] = True
        if flags.any():
            return flags, code
    return flags, 0.0


def sign_code(values: Array) -> tuple[str, int, str] | None:
    """Return key and bit that decode whole numbers ``(n,)`` with a sign bit, and what shows it."""
    values = values[np.isfinite(values)]
    highest = float(values.max(initial=0.0))
    if values.min(initial=0.0) < 0.0 or highest < 2.0 or np.any(values != np.round(values)):
        return None
    bits = int(np.log2(highest)) + 1
    half = 2.0 ** (bits - 1)
    negative = values >= half
    if negative.all():
        return None
    low, high = float(values[~negative].max()), float(values[negative].min())
    spread = max(low - float(values.min()), highest - high)
    jumps = float(np.sum(np.diff(values) ** 2))
    for key, bit, decoded, gap in (
        ("sign_bit", bits - 1, half - values, high - half),
        ("twos_complement", bits, values - 2.0 * half, 2.0 * half - highest),
    ):
        left = float(np.sum(np.diff(np.where(negative, decoded, values)) ** 2))
        if left < 0.25 * jumps and gap <= spread:
            sentence = f"it is {low:.6g} or less, or {high:.6g} and more in "
            return key, bit, f"{sentence}{100.0 * float(np.mean(negative)):.2g} % of the rows"
    return None


def unsigned(values: Array, position: Array, where: str) -> list[str]:
    """Warn of a magnitude: never negative, back from zero again and again, and without power."""
    size = float(np.quantile(np.abs(values), 0.95))
    folds = runs(values <= 0.05 * size)
    directions = np.sign(np.diff(position, append=position[-1]))
    turns = np.count_nonzero(np.diff(directions[directions != 0.0]))
    rests = np.mean(values[1:] == 0.0) > 0.2
    if values.min() < 0.0 or turns < 2 or len(folds) < 3 or rests:
        return []
    power = values * np.diff(position, append=position[-1])
    if abs(power.mean()) > 0.1 * np.abs(power).mean():
        return []
    return [f"{where}: never negative: a magnitude; record its sign"]


def fresh_rows(signals: Sequence[Array]) -> tuple[Index, Flags, int] | None:
    """Return the rows of signals ``(n,)`` with new values, if values are held over several rows.

    Also flags of these rows, and over how many values are held. Held values change together, others
    repeat by chance. Where they last twice as long rows remain at the same pace, with a flag.
    """
    changes = np.array([np.append(True, np.diff(x) != 0.0) for x in signals])
    together, new = changes.all(axis=0), changes.any(axis=0)
    first = np.flatnonzero(new)
    hold = int(np.median(np.diff(first))) if first.size > 1 else 1
    if hold < 2 or together.sum() < 0.9 * changes.sum(axis=1).min():
        return None
    last = np.cumsum(new) - 1
    since, lasts = np.arange(new.size) - first[last], np.diff(np.append(first, new.size))[last]
    stale = ~new & (lasts > 2 * hold)
    rows = np.flatnonzero(new | stale & (since % hold == 0))
    return rows, stale[rows], hold


def own_rows(values: Array, time: Array) -> tuple[Index, str] | None:
    """Return the rows that measure a signal ``(n,)``, if others hold a value or lie between.

    Unlike steps of an encoder or commands, measured rows come at one pace, differ in many sizes,
    and each by less than the signal varies.
    """
    finest = finest_step(values)
    slopes = np.diff(values) / np.diff(time)
    ahead, behind = np.diff(time)[1:], np.diff(time)[:-1]
    bend = np.diff(slopes) * ahead * behind / (ahead + behind)
    # a decimal or two of the numbers in a file
    smallest = max(finest, 1e-9 * float(np.abs(values).max(initial=0.0)))
    for how, change in (("held over", np.diff(values)), ("drawn through", bend)):
        rows = np.flatnonzero(np.abs(change) > smallest * (how != "held over")) + 1
        gaps = np.diff(rows)
        count = int(np.median(gaps)) if rows.size > 20 else 1
        if count < 2 or np.mean(gaps % count == 0) < 0.9:
            continue
        steps = np.diff(values[rows])
        if np.median(np.abs(change[rows - 1])) >= 3.0 * smallest and rms(steps) < values.std():
            # and again where a value lasts longer
            row = np.arange(values.size)
            since = row - rows[np.searchsorted(rows, row, "right") - 1]
            return np.flatnonzero(since % count == 0), f"{how} {count} rows"
    return None


# --- motion and standstill ----------------------------------------------------------------------


def moving_samples(qd: Array, segments: Segments, dead_zone: float, guard: int) -> Flags:
    """Flag the samples of speeds from the dead zone up, not within ``guard`` of a standstill."""
    moving = np.abs(qd) >= dead_zone
    still = resting(qd, segments, dead_zone, guard)
    return moving if not still.any() else moving & ~near(still, guard)


def too_slow(limit: str = "the dead zone") -> str:
    """Say why outputs are left out for their speed."""
    return f"at joint speeds below {limit}, or filtered together with such samples"


def resting(qd: Array, segments: Segments, dead_zone: float, guard: int) -> Flags:
    """Flag samples below the dead zone, ``guard`` or more in a row."""
    flags = np.zeros(len(qd), dtype=np.bool_)
    for a, b in arrays.without_excluded(segments, np.abs(qd) >= dead_zone):
        flags[a:b] = b - a >= guard
    return flags


@dataclass(frozen=True, eq=False)
class Rest:
    """Outputs whose whole window lies in a standstill."""

    q: Array  # (M,) rad or m of the joint
    torque: Array  # (M,) of the motor, filtered as outputs in motion are, N m or N
    stamps: Array  # (M,) s since the file's first stamp


def standstill_samples(
    position: Array, segments: Segments, least: int, *, uneven: float = 0.05
) -> Flags:
    """Flag samples ``(N,)`` of runs of ``least`` or more within one encoder step, ±1 count.

    The step is the finest between positions read twice in a row: resampled ones lie between steps.
    """
    flags = np.zeros(position.size, dtype=np.bool_)
    rounding = 1e-9 * float(np.abs(position).max(initial=0.0))
    repeated = np.abs(np.diff(position)) <= rounding
    if not repeated.any():
        return flags
    step = finest_step(position[1:][repeated]) * (1.0 + uneven) + rounding
    for a, b in segments:
        if b - a < least:
            continue
        part = sliding_window_view(position[a:b], least)
        begins = part.max(axis=1) - part.min(axis=1) <= step
        flags[a:b] = near(np.pad(begins, (0, least - 1)), least - 1, ahead=0)
    return flags


def standstill_outputs(
    recording: Measurement, torque: Array, still: Flags, taps: Array, factor: int, guard: int
) -> Rest | None:
    """Lay windows over standstills, ``guard`` samples off their ends; ``None`` where none fits."""
    inner = tuple((a + guard, b - guard) for a, b in runs(still) if b - a > 2 * guard)
    windows = lay_windows(taps, inner, factor, np.ones(still.size, dtype=np.bool_))
    if windows.n_outputs == 0:
        return None
    # more than 200, evenly spaced, hold no more information
    chosen = np.unique(np.linspace(0, windows.n_outputs - 1, 200).astype(int))
    centres = windows.centres[chosen]
    torque = windows.apply(torque)[chosen]
    return Rest(recording.position[centres], torque, recording.time[centres])


# --- signals that disagree, or follow each other ------------------------------------------------


def speed_mismatch(
    velocity: Array, differentiated: Array, usable: Flags, period: float, *, longest: float = 0.1
) -> tuple[float | None, float | None]:
    """Compare a measured velocity with the differentiated position, with the same filter.

    Returns their ratio where it is off by 10 % or more, 0 where they are unrelated; and the delay,
    s, of the velocity, where that explains half of what the two differ by.
    """
    at, late = np.flatnonzero(usable), None
    furthest = min(round(longest / period), at.size // 10)
    inner = at[(at >= furthest) & (at < velocity.size - furthest)]

    def compared(lag: int, at: Index) -> tuple[float, float]:
        """Return the correlation of the two and their ratio, at a lag in samples."""
        v, d = velocity[at], differentiated[at - lag]
        power, other, both = float(v @ v), float(d @ d), float(v @ d)
        if not power > 0.0 or not other > 0.0:
            return 1.0, 1.0
        return both / np.sqrt(power * other), both / other

    correlation, factor = compared(0, at)
    # most velocities have no delay, and every lag costs a product
    if furthest >= 2 and (now := 1.0 - compared(0, inner)[0] ** 2) >= 0.01:
        lags = np.arange(-furthest, furthest + 1)
        left = np.array([1.0 - compared(lag, inner)[0] ** 2 for lag in lags.tolist()])
        k = int(left.argmin())
        if 0 < k < lags.size - 1 and left[k] <= 0.5 * now:
            bend = left[k - 1] - 2.0 * left[k] + left[k + 1]
            late = float((lags[k] + 0.5 * (left[k - 1] - left[k + 1]) / bend) * period)
            correlation, factor = compared(int(lags[k]), inner)
    if abs(correlation) < 0.9:
        return (0.0 if abs(correlation) < 0.3 else None), late
    return (factor if abs(factor - 1.0) > 0.1 else None), late


def between(factor: float) -> str:
    """Name the units that a factor lies between; empty for none."""
    pi = np.pi
    confused = {"deg and rad": 180 / pi, "rpm and rad/s": 30 / pi, "turn and rad": 2 * pi}
    confused |= {"rpm and deg/s": 6.0, "thousandths and whole": 1e3}
    size = max(abs(factor), 1.0 / abs(factor)) if factor else 0.0
    named = (words for words, times in confused.items() if abs(size / times - 1.0) < 0.02)
    return next((f" (the factor between {words})" for words in named), "")


def feedback(
    torque: Array, position: Array, velocity: Array, usable: Flags, *, least_samples: int = 50
) -> tuple[Feedback, float] | None:
    """Detect a torque that follows the motion by a simple law; returns it and what it explains."""
    t, q, v = torque[usable], position[usable], velocity[usable]
    if t.size < least_samples or not np.ptp(t) > 0.0:
        return None
    size = float(np.median(np.abs(t)))
    two_levels = float(np.mean(np.abs(np.abs(t) - size) < 0.05 * size))
    # in both directions: of one, any torque with an offset has the sign
    ways = [np.sign(t[way * v > 0.0]) == way for way in (1.0, -1.0)]
    same = min(float(np.mean(way)) if way.size else 0.0 for way in ways)
    # a joint reverses some time after an open-loop torque, and together with one that follows it
    turns = np.flatnonzero(np.diff(np.sign(torque)) != 0)
    at_turns = np.minimum(np.abs(velocity[turns]), np.abs(velocity[turns + 1]))
    follows = turns.size and float(np.median(at_turns)) < 0.2 * rms(v)
    if min(two_levels, same) > 0.9 and follows:
        return "sign of speed", same
    columns = np.column_stack([np.ones_like(t), q, v])
    gains = np.linalg.lstsq(columns, t, rcond=None)[0]
    share = 1.0 - float(np.var(t - columns @ gains) / np.var(t))
    if share > 0.98 and gains[1] < 0.0 and np.var(gains[1] * q) > 0.5 * np.var(t):
        return "position error", share
    return None


def target_fault(
    target: Array, position: Array, used: Flags, *, lags: int = 40, most: int = 100_000
) -> tuple[str, str] | None:
    """Say why a position ``(n,)`` cannot follow a target where ``used``, and what to do."""
    if not np.ptp(target):
        return "never moves", "record a motion, or name the column of targets"
    lags = min(lags, target.size // 4)
    middle = np.flatnonzero(used)[:most]
    middle = middle[(middle >= lags) & (middle < target.size - lags)]
    if middle.size < 2:
        return None
    q, correlation = position[middle], np.zeros(2 * lags + 1)
    q = (q - q.mean()) / max(float(np.std(q)), 1e-300) / middle.size
    for k in range(-lags, lags + 1):
        goal = target[middle - k]
        correlation[lags + k] = (goal @ q) / max(float(np.std(goal)), 1e-300)
    best = int(np.argmax(correlation))
    ratio = float(np.std(target)) / max(float(np.std(position)), 1e-300)
    if correlation[best] < 0.2 and correlation.min() < -0.7:
        return "the position runs against this target", "turn its sign, or take this joint's own"
    if correlation[best] > 0.7 and not 0.1 < ratio < 10.0:
        return f"the target moves {ratio:.3g} times as far as the position", "correct its unit"
    left, steps = 1.0 - correlation**2, np.diff(target[middle])
    turns = int(np.count_nonzero(np.diff(np.sign(steps[steps != 0.0]))))
    # two slow moves have no lag to speak of
    if turns >= 4 and 0 < best < lags and correlation[best] > 0.9 and left[best] < 0.8 * left[lags]:
        problem = f"the position comes {lags - best} samples before this target"
        return problem, "swap the two columns, or log targets when they are sent"
    return None
