"""Spans of a recording in which something else acted, such as a hand that pushed.

Looked for by a robust least squares of each recording alone, so that the span itself moves the fit
little, in three ways. A jolt, also in a reversal or next to a rest: at any sample the torque lacks
far more than friction, noise and errors of the model could take. A gentler push that lasts: at
what is compared the torque is off by several times what it is elsewhere. And one that is hardly
larger than residuals are, but goes one way for longer than they do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.estimates.torque_form import columns
from bayesfric.huber import HUBER, robust_sd, shares
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.filters import lowpass
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.moving import compared_parts, resting
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

# A jolt: s over which torques are averaged, at least so many samples; and in how many of them
_JOLT, _SAMPLES, _SUSTAINED = 0.1, 5, 3
# the torque lacks, beyond so many times the losses, so many times the usual residual and so large a
# share of the largest torque; and to where it may reach. Of the pendulum's pushes none has less
# than 44 times and 5 shares. What nobody touched has one or the other, never both: XL330 up to 20
# times and 0.35, the pendulum 5 times and 1.1, simulated without their Stribeck rise 30 and 0.21.
_LOSSES, _BEYOND, _SHARE, _FOOT = 2.0, 12.0, 0.7, 4.0
# Its ends are where that much of its largest torque is seen, before any average.
_RISEN = 0.05
# A gentle push: s over which residuals are averaged, at least so many outputs.
_WINDOW, _OUTPUTS = 0.4, 8
# How many times the usual residual is no chance and no lack of the model, in so many outputs of one
# span; and to where its ends reach. Of 16 untouched recordings of the XL330 the largest is 6.4.
_FAR, _LEAST, _ENDS = 7.5, 3, 2.5
# A smaller share of the largest torque, or more spans, are more often what the model lacks.
_GENTLE, _OFTEN = 0.25, 4
# A slow push: s over which residuals are averaged with their sign, at least so many outputs; how
# many robust sds of such averages are no chance; to where its ends reach; and how large a share of
# the largest torque it is. What nobody touched has up to 19 sds or 0.19 of that, never both.
_SLOW, _FEWEST, _ONE_WAY, _FADES, _LEAST_SLOW = 0.3, 3, 8.0, 4.0, 0.3
# A shorter recording does not tell what is usual; nor one of which more than this share is far.
_ENOUGH, _MOST = 40, 0.35
_STEPS = 30
# The largest torque but for what an outlier makes of it.
_LARGE = 0.95
# Share of the inertia of plain least squares that a joint keeps in a robust one.
_KEPT = 0.5
_TINY = 1e-30


@dataclass(frozen=True)
class Disturbance:
    """A span, s from the file's first stamp, and by how many times its residual is larger."""

    recording: str
    start: float
    stop: float
    times: float
    # by how much it is off at the worst moment, N m or N at the motor: at least, for it is averaged
    # over that moment, and what friction may be of it is taken off
    torque: float


def disturbances(
    chain: Joint, recordings: Sequence[Measurement], observations: Sequence[Observation]
) -> list[Disturbance]:
    """Find spans in which a recording's torque is far from what its motion explains elsewhere."""
    pairs = zip(recordings, observations, strict=True)
    return [one for recording, o in pairs for one in _found(chain, recording, o)]


def unlooked(
    chain: Joint, recordings: Sequence[Measurement], observations: Sequence[Observation]
) -> dict[str, float]:
    """Give seconds of each recording in which nothing tells a push; all where none is usual."""
    found = {}
    for recording, o in zip(recordings, observations, strict=True):
        judged = _judged(chain, o) is not None
        share = float(np.mean(~_looked(recording, o))) if judged else 1.0
        found[o.name] = share * recording.time.size * recording.period
    return found


def _judged(chain: Joint, o: Observation) -> tuple[TotalsProjection, Array] | None:
    """Fit robust totals to a recording alone, where these are its joint's."""
    if o.time.size < _ENOUGH:
        return None
    projection = TotalsProjection(chain, [o])
    if not projection.names:
        return None
    try:
        totals = _robust(projection.regressors, o.measured)
    except np.linalg.LinAlgError:  # numbers that no joint has: nothing is usual there
        return None
    return None if _of_controller(projection, o.measured, totals) else (projection, totals)


def _looked(recording: Measurement, o: Observation) -> Flags:
    """Flag samples that are looked at: what friction takes at rest, no model tells."""
    used = np.zeros(o.q.size, dtype=np.bool_)
    for a, b in compared_parts(recording, int(o.settings["trim_samples"])):
        used[a:b] = True
    dead_zone, guard = float(o.settings["dead_zone"]), int(o.settings["guard"])
    return used & ~resting(o.qd, recording.segments, dead_zone, guard)


def _found(chain: Joint, recording: Measurement, o: Observation) -> list[Disturbance]:
    judged = _judged(chain, o)
    if judged is None:
        return []
    projection, totals = judged
    jolts = list(_jolts(chain, recording, o, projection.names, totals))
    residual = o.measured - projection.regressors @ totals
    found = jolts
    # where several see one, all samples tell its ends better than averages do
    for others in (_gentle(o, residual), _slow(o, residual)):
        found += [g for g in others if all(g.stop < j.start or j.stop < g.start for j in found)]
    return sorted(found, key=lambda one: one.start)


def _of_controller(projection: TotalsProjection, torque: Array, totals: Array) -> bool:
    """Whether robust totals are a controller's law, such as torque by direction, and no joint's.

    They leave out what shows the inertia then. Whoever pushes rather hides inertia from all.
    """
    if "inertia" not in projection.names:
        return False
    i = projection.names.index("inertia")
    return bool(totals[i] < _KEPT * projection.solve(torque)[i])


def _jolts(
    chain: Joint, recording: Measurement, o: Observation, names: Sequence[str], totals: Array
) -> Iterator[Disturbance]:
    """Look at every sample that moves, also where none is compared with the model."""
    segments, rate = recording.segments, 1.0 / recording.period
    forth, back = (columns(chain, one, names) for one in (o, replace(o, qd=-o.qd)))
    # near a reversal friction may be anything up to that of either direction, from rest on more
    losses = np.abs(totals) @ np.abs(forth - back) / 2.0
    passed = lowpass(
        o.torque, segments, rate, float(o.settings["lowpass"]), int(o.settings["order"])
    )
    used = _looked(recording, o)
    moving = used & (np.abs(o.qd) >= float(o.settings["dead_zone"]))
    if np.count_nonzero(moving) < _ENOUGH:
        return
    length = max(round(_JOLT * rate), _SAMPLES)
    lossless = passed - totals @ (forth + back) / 2.0
    usual = float(np.median(np.abs(_averaged(passed - totals @ forth, used, length))[moving]))
    largest = float(np.quantile(np.abs(passed[used]), _LARGE))
    lacking = np.abs(_averaged(lossless, used, length))
    allowed = _averaged(losses, used, length)
    far = used & (lacking - _LOSSES * allowed > max(_BEYOND * usual, _SHARE * largest))
    for a, b in _runs(used & (lacking - allowed > _FOOT * usual)):
        if np.count_nonzero(far[a:b]) >= _SUSTAINED:
            # averages carry it to either side, and the low-pass a little of it
            beyond = np.abs(lossless[a:b]) - losses[a:b]
            inner = a + np.flatnonzero(beyond > max(_FOOT * usual, _RISEN * float(beyond.max())))
            start, stop = o.stamps[inner[[0, -1]]].tolist()
            # losses of either direction may be part of it, and are not what acted
            most = float((lacking - allowed)[a:b].max())
            yield Disturbance(o.name, start, stop, most / max(usual, _TINY), most)


def _averaged(values: Array, used: Flags, length: int) -> Array:
    """Average ``(n,)`` over ``length`` samples about each, of those that are used."""
    ones = np.ones(length)
    count = np.convolve(used, ones, "same")
    return np.asarray(np.convolve(values * used, ones, "same") / np.maximum(count, 1.0))


def _about(o: Observation, values: Array, length: float) -> tuple[Array, NDArray[np.intp]]:
    """Average ``(M,)`` over ``length`` s about each output; and of how many outputs."""
    first = np.searchsorted(o.time, o.time - 0.5 * length)
    last = np.searchsorted(o.time, o.time + 0.5 * length, "right")
    sums = np.concatenate([[0.0], np.cumsum(values)])
    return (sums[last] - sums[first]) / (last - first), last - first


def _gentle(o: Observation, residual: Array) -> list[Disturbance]:
    """Look at what is compared with the model, for as long as one push lasts."""
    length = max(_WINDOW, _OUTPUTS * o.period)
    local = np.sqrt(_about(o, residual**2, length)[0])
    usual = float(np.median(local))
    # what a model explains to the last digit is no usual residual
    if not usual > 1e-9 * float(np.abs(o.measured).max(initial=0.0)):
        return []
    times = local / usual
    enough = local > _GENTLE * float(np.quantile(np.abs(o.measured), _LARGE))
    if np.mean(times > _FAR) > _MOST:
        return []
    found = []
    for a, b in _runs(times > _ENDS):
        if np.count_nonzero(enough[a:b] & (times[a:b] > _FAR)) >= _LEAST:
            most = float(local[a:b].max())
            # the average has carried it to either side already
            start, stop = float(o.time[a]), float(o.time[b - 1])
            found.append(Disturbance(o.name, start, stop, most / usual, most))
    joined = _joined(found, length)
    return joined if len(joined) <= _OFTEN else []


def _slow(o: Observation, residual: Array) -> list[Disturbance]:
    """Look for averages with their sign, in which what goes to and fro cancels."""
    mean, count = _about(o, residual, max(_SLOW, _FEWEST * o.period))
    whole = count >= _FEWEST
    mean = np.where(whole, mean, 0.0)
    if not whole.any() or not (usual := robust_sd(mean[whole])) > 0.0:
        return []
    size = np.abs(mean)
    large = size > _LEAST_SLOW * float(np.quantile(np.abs(o.measured), _LARGE))
    found = []
    for a, b in _runs(size > _FADES * usual):
        if np.any(large[a:b] & (size[a:b] > _ONE_WAY * usual)):
            # an average is small where only part of it is pushed
            beside = np.sign(mean[a]) * residual > robust_sd(residual)
            while a > 0 and beside[a - 1]:
                a -= 1
            while b < beside.size and beside[b]:
                b += 1
            start, stop, most = float(o.time[a]), float(o.time[b - 1]), float(size[a:b].max())
            found.append(Disturbance(o.name, start, stop, most / usual, most))
    return found if len(found) <= _OFTEN else []


def _robust(regressors: Array, torque: Array) -> Array:
    """Return the totals of a fit in which what is far counts little."""
    size = np.linalg.norm(regressors, axis=0) + _TINY
    scaled, solution = regressors / size, np.zeros(size.size)
    weight = np.ones_like(torque)
    residual = torque
    for _ in range(_STEPS):
        root = np.sqrt(weight)
        solution = np.linalg.lstsq(scaled * root[:, None], torque * root, rcond=None)[0]
        residual = torque - scaled @ solution
        knee = HUBER * max(robust_sd(residual), _TINY)
        # squared: a long push would else still pull
        weight = shares(residual, knee) ** 2
    return np.asarray(solution / size)


def _runs(flags: Flags) -> list[tuple[int, int]]:
    change = np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8))
    begins, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1)
    return list(zip(begins.tolist(), ends.tolist(), strict=True))


def _joined(spans: Sequence[Disturbance], gap: float) -> list[Disturbance]:
    """Join spans that nearly touch."""
    out: list[Disturbance] = []
    for one in spans:
        if out and one.start - out[-1].stop <= gap:
            before = out.pop()
            times, torque = max(before.times, one.times), max(before.torque, one.torque)
            one = Disturbance(one.recording, before.start, one.stop, times, torque)
        out.append(one)
    return out
