"""Filtered, differentiated, decimated: what a model is compared with."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput
from bayesfric.recordings import checks, units
from bayesfric.recordings.acting import acting, filtered_motion
from bayesfric.recordings.arrays import Array, Flags, Segments, runs
from bayesfric.recordings.filters import (
    FOLDING,
    LARGE_SHARE,
    SHARING,
    SMALL_SHARE,
    ParallelFilter,
    check_cutoff,
    decimation,
    derivative,
    lay_windows,
    lowpass,
    parallel_cutoff,
    parallel_length,
    parallel_taps,
    reach_of,
)
from bayesfric.recordings.measurement import Inputs, Measurement, Signal
from bayesfric.recordings.moving import (
    Rest,
    at_rest,
    moving_samples,
    near,
    rests,
    too_slow,
    without_excluded,
)
from bayesfric.recordings.resolution import (
    ABOVE_GAPS,
    LEAST_RATIO,
    WIDEST,
    Reason,
    Resolution,
    finest_step,
    lowpass_above,
    resolve,
    too_coarse,
)
from bayesfric.recordings.source import Processing

_DEAD_SHARE = 0.01
_TRIM_SAMPLES = 10
# Samples beside a rest that are not used, at least; and of a rest.
_GUARD = 10
# Share of the windows, and number, that the dead zone must leave before it takes samples instead.
_LEFT, _LEAST_LEFT = 0.2, 60
# Windows and trims that should fit into the longest segment where the band is chosen.
_FITTING = 20
# Outputs of an excerpt: enough to search, to rank and to shape what every sample is asked of then.
# And neighbouring ones that it keeps together, as their windows overlap.
_SOME, _TOGETHER = 5_000, 50
# Every number actually used, in SI units.
Settings = dict[str, float | int | str]
# What ends a band.
_ENDED: dict[Reason, str] = {
    "sampling": "as wide as the sampling rate allows",
    "position": "beyond which the position does not resolve the acceleration",
    "torque": "beyond which the torque has next to no power",
    "length": "the narrowest that leaves enough outputs of so short a recording; its position or "
    "torque asked for a narrower one",
    "model": "as in a wider one the inertia comes out smaller and more torque is unexplained: "
    "there is noise in the acceleration that grows with the motion, such as of time stamps",
    "asked": "as set, or as the fitted part's",
}


@dataclass(frozen=True, eq=False)
class Observation:
    """What a model is compared with, and what it needs to predict it.

    Inside a segment outputs may be missing (dead zone, excluded spans); neighbours are those whose
    ``filter.starts`` differ by ``decimate``.
    """

    name: str  # of the recording
    q: Array  # (N,) of the joint, rad or m; so are the next two
    qd: Array
    qdd: Array
    torque: Array  # (N,) of the motor as it acts at the samples, N m or N; see acting
    # (N,) what the model's torque is compared with, unfiltered: the same, put right for a delay
    compared: Array
    filter: ParallelFilter  # takes N samples of any signal to M outputs
    time: Array  # (M,) s since the file's first stamp at the windows' centres
    measured: Array  # (M,) filter.apply(as_position(compared, ...))
    speed: Array  # (M,) qd at the windows' centres
    period: float  # s from one output to the next of the same segment
    segment_of: NDArray[np.int64]  # (M,) segment of every output
    stamps: Array  # (N,) s since the file's first stamp
    inputs: Inputs  # what the joint feels besides its motion
    steps: tuple[str, ...]  # one sentence for every choice made, reading included
    warnings: tuple[str, ...]  # one sentence for everything a user should look at
    settings: Settings
    # smallest difference of positions as read, rad or m of the joint; 0 where it is not known
    position_step: float = 0.0
    # what samples at rest say, where they are asked and the position tells rest
    rest: Rest | None = None
    left_out: tuple[tuple[float, float], ...] = ()  # spans that the user excluded, s as time
    # (N,) acceleration that the encoder tells, where qdd is finer
    smooth: Array | None = None

    @property
    def acceleration(self) -> Array:
        """Acceleration ``(M,)`` at the windows' centres, without the torque's noise."""
        return (self.qdd if self.smooth is None else self.smooth)[self.filter.centres]

    def excerpt(self, most: int = _SOME) -> Observation:
        """Keep about so many outputs at most, in stretches all over the recording.

        Each is what it was: the samples of its window are kept as they are.
        """
        count = self.filter.n_outputs
        if count <= most:
            return self
        begins = np.linspace(0, count - _TOGETHER, max(most // _TOGETHER, 1)).astype(np.int64)
        outputs = np.unique(begins[:, None] + np.arange(_TOGETHER))
        chosen, samples = self.filter.excerpt(outputs)
        of_samples = ("q", "qd", "qdd", "torque", "compared", "stamps")
        of_outputs = ("time", "measured", "speed", "segment_of")
        return replace(
            self,
            filter=chosen,
            smooth=None if self.smooth is None else self.smooth[samples],
            **{name: getattr(self, name)[samples] for name in of_samples},
            **{name: getattr(self, name)[outputs] for name in of_outputs},
        )

    @property
    def pace(self) -> float:
        """How often the joint goes to and fro, Hz, two digits; at least five times in all."""
        centres = self.filter.centres
        turns = np.count_nonzero(np.diff(np.sign(self.qd[centres])) != 0) / 2.0
        return float(f"{max(turns, 5.0) / max(self.period * centres.size, 1e-9):.2g}")


@dataclass(frozen=True)
class _Numbers:
    """The processing numbers once every default is settled."""

    fs: float
    cutoff: float
    factor: int
    band: float | None
    trim_samples: int
    reach: int
    guard: int
    resolution: Resolution

    @property
    def alike(self) -> bool:
        """Whether the torque passes the position's low-pass, too.

        So what that takes off at the end of the band it takes from both. Not where every sample is
        an output, whose noise it would colour, nor in what published analyses did.
        """
        return self.reach > 1 and self.cutoff > 0.0 and self.used_band > 0.0

    @property
    def used_band(self) -> float:
        """Hz of the parallel filter; 0 for none."""
        if self.band is not None:
            return self.band
        return self.fs / (2 * self.factor) if self.factor > 1 else 0.0


def observe(
    recording: Measurement, processing: Processing, resolution: Resolution | None = None
) -> Observation:
    """Filter, differentiate and decimate a recording.

    What is None in ``processing`` is settled from the recording, whose ``resolution`` is looked at
    where it is not given. A cut-off that the sampling rate
    cannot carry, and settings that leave no output, are bad input.
    """
    numbers, made = _laid(recording, processing, resolution)
    if made.filter.n_outputs == 0:
        raise BadInput(
            f"recording '{recording.name}', dead_zone",
            "the joint is never faster than the dead zone for a whole window",
            "lower dead_zone (0 for none), or decimate less",
        )
    q, qd, chosen = made.q, made.qd, made.filter
    segments, period, found = recording.segments, recording.period, numbers.resolution
    compared = made.compared & ~recording.excluded
    warnings = [*recording.warnings, *_band_warnings(numbers), *too_coarse(found, recording)]
    settings = _settings(recording, processing, numbers, made)
    if law := checks.feedback(recording.torque, q, qd, compared):
        settings["feedback"] = law[0]
    if recording.velocity is not None:
        speed = derivative(q, segments, period, numbers.reach)
        factor = checks.speed_mismatch(qd, speed, compared)
        warnings += _velocity_warnings(factor, checks.speed_delay(qd, speed, compared, period))
        # a smaller one may come of filters
        if factor is not None and not 0.5 < factor < 2.0:
            settings["velocity_factor"] = factor
    borders = np.array([a for a, _ in segments], dtype=np.int64)
    torque = acting(recording, numbers.reach)
    passed = as_position(torque, segments, period, settings)
    inputs, resting = _smoothed(recording, settings), None
    if processing.rest:
        still = (recording.position, passed, recording.time, chosen.taps, made.parts)
        resting = rests(*still, numbers.factor, made.still, numbers.guard)
        settings["rest_outputs"] = 0 if resting is None else resting.q.size
        if resting is None:
            warnings.append(
                "rest: the position is never read the same for long enough to tell rest; "
                "samples at rest say nothing"
            )
    return Observation(
        name=recording.name,
        q=q,
        qd=qd,
        qdd=derivative(qd, segments, period, numbers.reach),
        torque=torque,
        compared=torque,
        filter=chosen,
        time=recording.time[chosen.centres],
        measured=chosen.apply(passed),
        speed=qd[chosen.centres],
        period=numbers.factor * period,
        segment_of=np.searchsorted(borders, chosen.starts, side="right").astype(np.int64) - 1,
        stamps=recording.time,
        inputs=inputs,
        steps=(*recording.steps, *_told(numbers, recording, settings)),
        warnings=tuple(warnings),
        settings=settings,
        position_step=finest_step(recording.position),
        rest=resting,
        left_out=tuple(
            (float(recording.time[a]), float(recording.time[b - 1]))
            for a, b in runs(recording.excluded)
        ),
    )


def _settings(
    recording: Measurement, processing: Processing, numbers: _Numbers, made: _Prepared
) -> Settings:
    found = numbers.resolution
    settings: Settings = {
        "sampling_rate": numbers.fs,
        "lowpass": numbers.cutoff,
        "order": processing.order,
        "decimate": numbers.factor,
        "band": numbers.used_band,
        "filter_cutoff": parallel_cutoff(numbers.factor, numbers.band, numbers.fs),
        "differentiation": processing.differentiation,
        "velocity": "differentiated" if recording.velocity is None else "measured",
        "reach": numbers.reach,
        "guard": numbers.guard,
        "band_by": found.reason,
        "noise_seen": found.noise,
        "dead_zone": made.dead_zone,
        "rest": processing.rest,
        "trim": numbers.trim_samples * recording.period,
        "trim_samples": numbers.trim_samples,
        "torque_lowpass": numbers.cutoff if numbers.alike else 0.0,
        "motion": "encoder",
        "taps": len(made.filter.taps),
        "n_samples": len(made.q),
        "n_segments": len(recording.segments),
        "n_outputs": made.filter.n_outputs,
        **made.dropped,
    }
    if np.isfinite(found.acceleration_ratio):
        settings["acceleration_ratio"] = found.acceleration_ratio
    if recording.torque_constant is not None:
        settings["torque_constant"] = recording.torque_constant
    return settings


def _smoothed(recording: Measurement, settings: Settings) -> Inputs:
    """Let the torques that the recording gives pass what the measured one has passed."""
    own = recording.inputs

    def passed(signal: Signal) -> Signal:
        values = signal.at(recording.time)
        values = as_position(values, recording.segments, recording.period, settings)
        return Signal(recording.time, values)

    return replace(
        own,
        recording=recording.name,
        load_torque=None if own.load_torque is None else passed(own.load_torque),
        others={name: passed(signal) for name, signal in own.others.items()},
    )


def as_position(torque: Array, segments: Segments, period: float, settings: Settings) -> Array:
    """Low-pass a measured torque ``(N,)`` where the position's filter is the torque's too."""
    cutoff, order = float(settings.get("torque_lowpass", 0.0)), int(settings.get("order", 1))
    return lowpass(torque, segments, 1.0 / period, cutoff, order)


def refinable(o: Observation) -> bool:
    """Whether what is compared ends well below the position's low-pass: a model may tell the rest.

    See :mod:`bayesfric.estimates.fine_motion`. Not in what published analyses did.
    """
    told = o.settings
    return told["differentiation"] == "exact" and 0.0 < 2.0 * float(told["band"]) <= float(
        told["lowpass"]
    )


def with_motion(
    o: Observation, recording: Measurement, q: Array, qd: Array, qdd: Array
) -> Observation:
    """Give an encoder's observation a motion beyond the low-pass, which then filters nothing."""
    settings = {**o.settings, "torque_lowpass": 0.0, "motion": "refined"}
    told = (
        f"motion: above {float(settings['lowpass']):.4g} Hz the one with which the model takes the "
        "measured torque, which is not low-passed"
    )
    return replace(
        o,
        q=q,
        qd=qd,
        qdd=qdd,
        smooth=o.qdd,
        speed=qd[o.filter.centres],
        measured=o.filter.apply(o.compared),
        inputs=replace(
            o.inputs,
            load_torque=recording.inputs.load_torque,
            others=recording.inputs.others,
        ),
        steps=(*o.steps, told),
        settings=settings,
    )


def settled(recording: Measurement, processing: Processing) -> Processing:
    """Write down what a recording's filters are, so that another part is treated alike."""
    numbers, _ = _laid(recording, processing)
    return processing.model_copy(update={"lowpass": numbers.cutoff, "decimate": numbers.factor})


def window(recording: Measurement, processing: Processing) -> tuple[int, int]:
    """Count the samples that one output is made of, and from one output to the next."""
    numbers = _settle(recording, processing)
    return parallel_length(numbers.factor, numbers.band, numbers.fs), numbers.factor


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A motion ``(N,)``, filtered and differentiated, and the windows laid over it."""

    q: Array
    qd: Array
    compared: Flags
    dead_zone: float
    filter: ParallelFilter
    dropped: dict[str, int]
    still: Flags  # (N,) at rest, where that is asked for
    parts: Segments  # of the recording, without its ends and what is excluded


def _laid(
    recording: Measurement, processing: Processing, resolution: Resolution | None = None
) -> tuple[_Numbers, _Prepared]:
    """Settle the filters and lay the windows, in whichever way leaves enough of them."""
    numbers = _settle(recording, processing, resolution)
    made = _prepared(recording, processing, numbers, SMALL_SHARE)
    count = made.filter.n_outputs
    if count < max(_LEFT * (count + made.dropped["dropped_dead_zone"]), _LEAST_LEFT):
        # A narrow band's long windows nearly all touch a reversal: rather lose samples then. The
        # gaps they leave fold noise from above the band into it, which the low-pass must take off.
        if processing.lowpass is None:
            numbers = _quieter(recording, processing, numbers)
        made = _prepared(recording, processing, numbers, LARGE_SHARE)
    return numbers, made


def _settle(
    recording: Measurement, processing: Processing, resolution: Resolution | None = None
) -> _Numbers:
    fs = 1 / recording.period
    where = f"recording '{recording.name}'"
    cutoff, factor, band = processing.lowpass, processing.decimate, processing.band
    if band is not None:
        check_cutoff(band, fs, f"{where}, band")
    if cutoff is None and factor is None:
        # one number settles the others: the band that is compared
        resolution = resolve(recording, band)
        if band is None:
            longest = max(b - a for a, b in recording.segments)
            most = max(round(0.5 / WIDEST), longest // _FITTING)
            factor = int(np.clip(round(fs / (2.0 * resolution.band)), 1, most))
        else:
            factor = min(decimation(band, fs), len(recording.time))
        cutoff = lowpass_above(band or fs / (2 * factor), fs)
    else:
        cutoff = fs / 10 if cutoff is None else cutoff
        if factor is None and band is not None:
            factor = decimation(band, fs)
        elif factor is None:
            factor = max(1, round(fs / cutoff)) if cutoff else 1
        factor = min(factor, len(recording.time))  # larger ones leave no output either
        half = fs / (2 * factor) if factor > 1 else cutoff or fs / 2
        resolution = resolution or resolve(recording, half if band is None else band)
    if cutoff:
        check_cutoff(cutoff, fs, f"{where}, lowpass")
    reach = reach_of(processing.differentiation, cutoff, fs)
    one_period = int(np.ceil(fs / cutoff - 1e-9)) if cutoff else 0
    if processing.trim is None:
        trim = max(_TRIM_SAMPLES, 2 * reach, one_period)
    else:
        # more than there are would only cost memory
        trim = int(np.ceil(min(processing.trim * fs, len(recording.time)) - 1e-9))
    trim = max(trim, int(np.ceil(abs(recording.late) * fs - 1e-9)))
    return _Numbers(fs, cutoff, factor, band, trim, reach, max(_GUARD, one_period), resolution)


def _quieter(recording: Measurement, processing: Processing, numbers: _Numbers) -> _Numbers:
    """Lower the low-pass until the acceleration behind it is more than its noise."""
    band = numbers.used_band or numbers.fs / 2
    cutoff = lowpass_above(band, numbers.fs, ABOVE_GAPS)
    while cutoff > 2.0 * band and resolve(recording, cutoff).acceleration_ratio < LEAST_RATIO:
        cutoff = max(cutoff / 1.5, 2.0 * band)
    lower = processing.model_copy(update={"lowpass": cutoff, "decimate": numbers.factor})
    return replace(_settle(recording, lower), resolution=numbers.resolution)


def _prepared(
    recording: Measurement, processing: Processing, numbers: _Numbers, share: float
) -> _Prepared:
    """Filter the motion and lay the windows; ``share`` as in `lay_windows`."""
    segments, trim = recording.segments, numbers.trim_samples
    q, qd = filtered_motion(recording, numbers.cutoff, processing.order, numbers.reach)
    # nothing may be left of a segment
    kept = tuple((a + trim, max(b - trim, a + trim)) for a, b in segments)
    inside = np.zeros(len(q), dtype=np.bool_)
    for a, b in kept:
        inside[a:b] = True
    dead_zone = processing.dead_zone
    if isinstance(dead_zone, str):
        dead_zone = units.quantity(dead_zone, "angular_speed", "speed")
    elif dead_zone is None:
        speeds = np.abs(qd[inside])
        dead_zone = _DEAD_SHARE * float(np.percentile(speeds, 99)) if speeds.size else 0.0
    moving = moving_samples(qd, segments, dead_zone, numbers.guard)
    still = np.zeros(len(q), dtype=np.bool_)
    if processing.rest:
        still = at_rest(recording.position, segments, 2 * numbers.guard)
        moving &= ~near(still, numbers.guard)
    if share > SMALL_SHARE and numbers.cutoff:
        # the low-pass smears the jolt of a reversal over a period on either side
        moving &= ~near(~moving, round(numbers.fs / numbers.cutoff))
    # the low-pass carries what is excluded a little way past its borders, as past a segment's
    parts = without_excluded(kept, near(recording.excluded, trim))
    chosen, dropped = _windows(recording, numbers, kept, parts, moving, share)
    return _Prepared(q, qd, inside & moving, float(dead_zone), chosen, dropped, still, parts)


def _windows(
    recording: Measurement,
    numbers: _Numbers,
    kept: Segments,
    parts: Segments,
    moving: Flags,
    share: float,
) -> tuple[ParallelFilter, dict[str, int]]:
    """Lay the windows, and count what every setting took away.

    ``kept`` are segments without their ends, ``parts`` without what is excluded either.
    """
    everything = np.ones(len(moving), dtype=np.bool_)
    where = f"recording '{recording.name}'"
    length = parallel_length(numbers.factor, numbers.band, numbers.fs)
    longest = max(b - a for a, b in recording.segments)
    # before the weights are made: there may be more of them than memory
    if length > longest:
        raise BadInput(
            f"{where}, decimate",
            f"decimate = {numbers.factor} needs windows of {length} samples, and the longest "
            f"segment has {longest}",
            "decimate less, raise band, or record longer",
        )
    taps = parallel_taps(numbers.factor, numbers.band, numbers.fs)

    def lay(segments: Segments, usable: Flags) -> ParallelFilter:
        return lay_windows(taps, segments, numbers.factor, usable, share)

    whole = lay(recording.segments, everything).n_outputs
    inner = lay(kept, everything).n_outputs
    included = lay(parts, everything).n_outputs
    if inner == 0:
        raise BadInput(
            f"{where}, trim",
            f"trim = {numbers.trim_samples * recording.period:.3g} s leaves no segment of {length} "
            "samples",
            "trim less, decimate less, or record longer",
        )
    if included == 0:
        raise BadInput(f"{where}, exclude", "the excluded spans leave no output", "exclude less")
    final = lay(parts, moving)
    return final, {
        "dropped_trim": whole - inner,
        "dropped_excluded": inner - included,
        "dropped_dead_zone": included - final.n_outputs,
    }


def _band_warnings(numbers: _Numbers) -> Iterator[str]:
    band, half = numbers.band, numbers.fs / (2 * numbers.factor)
    if band is None:
        return
    mend = f"decimate = {decimation(band, numbers.fs)} would fit"
    # the small share is rounding
    if band > FOLDING * half * (1.0 + 1e-9):
        yield (
            f"band: {band:.6g} Hz is above half the decimated rate ({half:.6g} Hz), "
            f"so higher frequencies fold back; {mend}"
        )
    if numbers.factor > 1 and band < SHARING * half:
        yield (
            f"band: {band:.6g} Hz is below half the decimated rate ({half:.6g} Hz), so "
            f"neighbouring outputs share noise and intervals come out too narrow; {mend}"
        )


def _velocity_warnings(factor: float | None, late: float | None) -> Iterator[str]:
    mend = "leave its line out, and the position is differentiated"
    if late is not None:
        yield (
            f"velocity: comes {abs(late):.2g} s {'after' if late > 0.0 else 'before'} the "
            f"differentiated position, as where a drive filters it: {mend}"
        )
    elif factor is not None:
        yield (
            f"velocity: is {factor:.3g} times the differentiated position"
            f"{checks.between(factor)}, and inertia and speed losses come out wrong by as much: "
            f"are column, unit, sign and side of both right? If a drive filters it, {mend}"
        )


def _told(numbers: _Numbers, recording: Measurement, settings: Settings) -> Iterator[str]:
    both = ", of position and torque alike" if settings["torque_lowpass"] else ""
    yield (
        f"low-pass: zero-phase Butterworth of order {settings['order']} at "
        f"{numbers.cutoff:.4g} Hz ({numbers.fs:.4g} Hz sampling){both}"
        if numbers.cutoff
        else "low-pass: none"
    )
    end = numbers.used_band or numbers.cutoff or 0.25 * numbers.fs
    for what, lag in ("torque", recording.torque_lag), ("velocity", recording.velocity_lag):
        if lag:
            times = math.hypot(1.0, (end / lag.cutoff) ** lag.order)
            yield (
                f"{what}: what a low-pass at {lag.cutoff:.4g} Hz took is given back; at the end of "
                f"the band that makes it, and what noise came after the filter, {times:.2g} times "
                "as large"
            )
    of, length = "position", "rad" if recording.motion == "rotary" else "m"
    unit, used = length, "differentiated position"
    if recording.velocity is not None:
        of, unit, used = "speed", f"{length}/s", "measured velocity"
    how = "central differences" if numbers.reach == 1 else f"{2 * numbers.reach + 1} points"
    yield f"velocity: {used}; acceleration: differentiated by {how}"
    found = numbers.resolution
    if "acceleration_ratio" in settings:
        yield (
            f"signal to noise of the acceleration in the band to {found.band:.3g} Hz (rms): "
            f"{found.acceleration_ratio:.3g}; noise of a sample of the {of} {found.noise:.2g} "
            f"{unit}"
        )
    yield f"band: ends at {end:.3g} Hz, {_ENDED[found.reason]}"
    yield f"trim: {numbers.trim_samples} samples off both ends of every segment"
    yield (
        "parallel filter: none, every sample is an output"
        if settings["taps"] == 1
        else f"parallel filter: {settings['taps']} taps, cut-off "
        f"{settings['filter_cutoff']:.4g} Hz, one output in {numbers.factor} samples"
    )
    slow = too_slow(f"{settings['dead_zone']:.3g} {length}/s")
    dropped, left = int(settings["dropped_dead_zone"]), int(settings["n_outputs"])
    rest = f"; {n} at rest" if (n := settings.get("rest_outputs", 0)) else ""
    if dropped > left and "rest_outputs" not in settings:
        rest = "; rest = true under [processing] makes use of those at rest"
    yield f"dead zone: {dropped} outputs left out, {slow}; {left} remain{rest}"
