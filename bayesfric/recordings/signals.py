"""Filter, differentiate and decimate a recording for its comparison with a model."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.recordings import arrays, checks, filters, units
from bayesfric.recordings.arrays import Array, Flags, Index, Segments, near, runs
from bayesfric.recordings.measurement import Inputs, Measurement, Signal
from bayesfric.recordings.source import Processing

# Delays in s, in both directions, between which a torque is about linear.
FAR_DELAYS = (0.03, 0.045, 0.07, 0.1, 0.15, 0.2)
# Every number actually used, in SI units.
Settings = dict[str, float | int | str]


@dataclass(frozen=True, eq=False)
class Signals:
    """Filtered signals that a model is compared with, and what it needs to predict them.

    Outputs may be missing; neighbours are those whose ``filter.starts`` differ by ``decimate``.
    """

    name: str  # of the recording
    q: Array  # (N,) of the joint, rad or m; so are the next two
    qd: Array
    qdd: Array
    torque: Array  # (N,) of the motor, see applied_torque, N m or N
    # (N,) the same corrected for a delay: compared, unfiltered, with the model's torque
    compared: Array
    filter: filters.ParallelFilter  # takes N samples of any signal to M outputs
    time: Array  # (M,) s since the file's first stamp at the windows' centres
    measured: Array  # (M,) filter.apply(as_position(compared, ...))
    speed: Array  # (M,) qd at the windows' centres
    period: float  # s from one output to the next of the same segment
    segment_of: Index  # (M,) segment of every output
    stamps: Array  # (N,) s since the file's first stamp
    inputs: Inputs
    steps: tuple[str, ...]  # a sentence for every choice made, reading included
    warnings: tuple[str, ...]
    settings: Settings
    position_step: float = 0.0  # encoder step, rad or m of the joint; 0 if unknown
    rest: checks.Rest | None = None  # outputs at standstill, where requested and detected
    left_out: tuple[tuple[float, float], ...] = ()  # spans that the user excluded, s as time
    # (N,) acceleration of the low-passed position, where qdd is the refined one
    smooth: Array | None = None

    @property
    def steady(self) -> bool:
        """Whether every output is a point at constant speed."""
        return bool(self.settings.get("steady"))

    @property
    def acceleration(self) -> Array:
        """Acceleration ``(M,)`` at the windows' centres, without the torque's noise."""
        return (self.qdd if self.smooth is None else self.smooth)[self.filter.centres]

    def excerpt(self, limit: int = 5_000, *, neighbours: int = 50) -> Signals:
        """Keep about ``limit`` outputs in runs of ``neighbours``, which share samples."""
        count = self.filter.n_outputs
        if count <= limit:
            return self
        begins = np.linspace(0, count - neighbours, max(limit // neighbours, 1)).astype(np.int64)
        outputs = np.unique(begins[:, None] + np.arange(neighbours))
        windows, samples = self.filter.excerpt(outputs)
        of_samples = ("q", "qd", "qdd", "torque", "compared", "stamps")
        of_outputs = ("time", "measured", "speed", "segment_of")
        return replace(
            self,
            filter=windows,
            smooth=None if self.smooth is None else self.smooth[samples],
            **{name: getattr(self, name)[samples] for name in of_samples},
            **{name: getattr(self, name)[outputs] for name in of_outputs},
        )

    @property
    def pace(self) -> float:
        """Frequency of the motion, Hz, to two digits; at least five cycles in all."""
        centres = self.filter.centres
        turns = np.count_nonzero(np.diff(np.sign(self.qd[centres])) != 0) / 2.0
        return float(f"{max(turns, 5.0) / max(self.period * centres.size, 1e-9):.2g}")


def observe(
    recording: Measurement, processing: Processing, resolution: filters.Resolution | None = None
) -> Signals:
    """Filter, differentiate and decimate a recording; defaults come from its ``resolution``.

    Settings that the sampling rate cannot carry, or that leave no output, are bad input.
    """
    if recording.steady:
        slow = processing.dead_zone or 0.0
        processing = Processing(lowpass=0.0, decimate=1, trim=0.0, dead_zone=slow)
    design, prepared = _prepare(recording, processing, resolution)
    q, qd, compared, still, windows, settings = prepared
    if windows.n_outputs == 0:
        problem = "the joint is never faster than the dead zone for a whole window"
        hint = "lower dead_zone (0 for none), or decimate less"
        raise BadInput(f"recording '{recording.name}', dead_zone", problem, hint)
    segments, period = recording.segments, recording.period
    warnings = [*recording.warnings, *_band_warnings(design, recording)]
    if law := checks.feedback(recording.torque, q, qd, compared):
        settings["feedback"] = law[0]
    if recording.velocity is not None:
        speed = filters.derivative(q, segments, period, design.reach)
        factor, late = checks.speed_mismatch(qd, speed, compared, period)
        warnings += _velocity_warnings(factor, late)
        # a smaller mismatch may come from filters
        if factor is not None and not 0.5 < factor < 2.0:
            settings["velocity_factor"] = factor
    if recording.steady:
        settings |= {"steady": True, "sampling_rate": 0.0}
    borders, time, excluded = [a for a, _ in segments], recording.time, runs(recording.excluded)
    torque = applied_torque(recording, design.reach)
    filtered_torque = as_position(torque, segments, period, settings)
    inputs, standstill = _filtered_inputs(recording, settings), None
    if processing.rest:
        standstill = checks.standstill_outputs(
            recording, filtered_torque, still, windows.taps, design.factor, design.guard
        )
        settings["rest_outputs"] = 0 if standstill is None else standstill.q.size
        if standstill is None:
            warnings.append("rest: the position is never constant for long enough; not used")
    return Signals(
        name=recording.name,
        q=q,
        qd=qd,
        qdd=filters.derivative(qd, segments, period, design.reach),
        torque=torque,
        compared=torque,
        filter=windows,
        time=time[windows.centres],
        measured=windows.apply(filtered_torque),
        speed=qd[windows.centres],
        period=design.factor * period,
        segment_of=np.searchsorted(borders, windows.starts, "right").astype(np.int64) - 1,
        stamps=time,
        inputs=inputs,
        steps=(*recording.steps, *_step_sentences(design, recording, settings)),
        warnings=tuple(warnings),
        settings=settings,
        position_step=0.0 if recording.integrated else filters.finest_step(recording.position),
        rest=standstill,
        left_out=tuple((float(time[a]), float(time[b - 1])) for a, b in excluded),
    )


def _filtered_inputs(recording: Measurement, settings: Settings) -> Inputs:
    """Filter the recorded load torque and further columns as the motor torque."""
    time, segments, period = recording.time, recording.segments, recording.period

    def filtered(signal: Signal) -> Signal:
        return Signal(time, as_position(signal.at(time), segments, period, settings))

    inputs = recording.inputs
    changed = inputs.each(filtered)
    return replace(changed, recording=recording.name, temperature=inputs.temperature)


# --- choice of filters and windows ----------------------------------------------------------------


def settled(recording: Measurement, processing: Processing) -> Processing:
    """Fix a recording's filters, so that another part of it gets the same."""
    design, _ = _prepare(recording, processing)
    return processing.model_copy(update={"lowpass": design.cutoff, "decimate": design.factor})


def window(recording: Measurement, processing: Processing) -> tuple[int, int]:
    """Return the samples of one window, and from one output to the next."""
    design = choose_filters(recording, processing)
    return filters.parallel_length(design.factor, design.band, design.fs), design.factor


@dataclass(frozen=True)
class _Design:
    """Filters of a recording, with all defaults resolved."""

    fs: float  # Hz, of the sampling
    cutoff: float  # Hz, of the position's low-pass; 0 for none
    factor: int  # samples an output
    band: float | None  # Hz, as given
    trim_samples: int
    reach: int  # neighbours on either side of a derivative
    guard: int  # samples left out next to a standstill
    resolution: filters.Resolution

    @property
    def used_band(self) -> float:
        """Hz of the parallel filter; 0 for none."""
        half = self.fs / (2 * self.factor) if self.factor > 1 else 0.0
        return half if self.band is None else self.band


# Position and speed (N,), flags (N,) of the samples to compare and of those at standstill where
# these are requested, the windows over them, and every number used.
_Prepared = tuple[Array, Array, Flags, Flags, filters.ParallelFilter, Settings]


def _prepare(
    recording: Measurement, processing: Processing, resolution: filters.Resolution | None = None
) -> tuple[_Design, _Prepared]:
    """Resolve the settings and lay the windows, so that enough of them remain."""
    design = choose_filters(recording, processing, resolution)
    prepared = _filter_and_lay_windows(recording, processing, design, filters.SMALL_SHARE)
    *_, windows, settings = prepared
    all_windows = windows.n_outputs + int(settings["dropped_dead_zone"])
    # the dead zone must leave a fifth of the windows, and sixty
    if windows.n_outputs < max(0.2 * all_windows, 60):
        # A narrow band's long windows nearly all touch a reversal: rather lose samples then. The
        # gaps they leave fold noise from above the band into it, which the low-pass must take off.
        if processing.lowpass is None:
            design = _lower_lowpass(recording, processing, design)
        prepared = _filter_and_lay_windows(recording, processing, design, filters.LARGE_SHARE)
    return design, prepared


def choose_filters(
    recording: Measurement, processing: Processing, resolution: filters.Resolution | None = None
) -> _Design:
    """Resolve the settings."""
    fs, least = 1 / recording.period, 10  # samples, at the ends of a segment and of a standstill
    where = f"recording '{recording.name}'"
    cutoff, factor, band = processing.lowpass, processing.decimate, processing.band
    if band is not None:
        filters.check_cutoff(band, fs, f"{where}, band")
    if cutoff is None and factor is None:
        # the band that is compared determines both
        resolution = filters.resolve(recording, band)
        if band is None:
            longest = max(b - a for a, b in recording.segments)
            # twenty windows and trims should fit into the longest segment
            limit = max(round(0.5 / filters.WIDEST), longest // 20)
            factor = int(np.clip(round(fs / (2.0 * resolution.band)), 1, limit))
        else:
            factor = min(filters.decimation(band, fs), len(recording.time))
        cutoff = filters.lowpass_above(band or fs / (2 * factor), fs)
    else:
        cutoff = fs / 10 if cutoff is None else cutoff
        if factor is None and band is not None:
            factor = filters.decimation(band, fs)
        elif factor is None:
            factor = max(1, round(fs / cutoff)) if cutoff else 1
        factor = min(factor, len(recording.time))  # larger ones leave no output either
        half = fs / (2 * factor) if factor > 1 else cutoff or fs / 2
        resolution = resolution or filters.resolve(recording, half if band is None else band)
    if cutoff:
        filters.check_cutoff(cutoff, fs, f"{where}, lowpass")
    reach = filters.reach_of(processing.differentiation, cutoff, fs)
    one_period = int(np.ceil(fs / cutoff - 1e-9)) if cutoff else 0
    if processing.trim is None:
        trim = max(least, 2 * reach, one_period)
    else:
        # more than there are would only cost memory
        trim = int(np.ceil(min(processing.trim * fs, len(recording.time)) - 1e-9))
    trim = max(trim, int(np.ceil(abs(recording.late) * fs - 1e-9)))
    return _Design(fs, cutoff, factor, band, trim, reach, max(least, one_period), resolution)


def _lower_lowpass(recording: Measurement, processing: Processing, design: _Design) -> _Design:
    """Lower the low-pass until the acceleration behind it is more than its noise."""
    band = design.used_band or design.fs / 2
    # higher above the band, so that the effect of samples left out reaches fewer neighbours
    cutoff, least = filters.lowpass_above(band, design.fs, 6.0), filters.LEAST_RATIO
    while cutoff > 2.0 * band and filters.resolve(recording, cutoff).acceleration_ratio < least:
        cutoff = max(cutoff / 1.5, 2.0 * band)
    lower = processing.model_copy(update={"lowpass": cutoff, "decimate": design.factor})
    return replace(choose_filters(recording, lower), resolution=design.resolution)


def _filter_and_lay_windows(
    recording: Measurement, processing: Processing, design: _Design, share: float
) -> _Prepared:
    """Filter the motion and lay the windows; ``share`` as in `lay_windows`."""
    segments, trim = recording.segments, design.trim_samples
    q, qd = filtered_motion(recording, design.cutoff, processing.order, design.reach)
    # nothing may be left of a segment
    trimmed = tuple((a + trim, max(b - trim, a + trim)) for a, b in segments)
    inside, dead_zone = arrays.in_segments(trimmed, len(q)), processing.dead_zone
    if isinstance(dead_zone, str):
        dead_zone = units.quantity(dead_zone, "angular_speed", "speed")
    elif dead_zone is None:
        dead_zone = 0.01 * float(np.percentile(np.abs(qd[inside]), 99)) if inside.any() else 0.0
    moving = checks.moving_samples(qd, segments, dead_zone, design.guard)
    still = np.zeros(len(q), dtype=np.bool_)
    if processing.rest:
        still = checks.standstill_samples(recording.position, segments, 2 * design.guard)
        moving &= ~near(still, design.guard)
    if share > filters.SMALL_SHARE and design.cutoff:
        # the low-pass smears the jolt of a reversal over a period on either side
        moving &= ~near(~moving, round(design.fs / design.cutoff))
    # the low-pass smears excluded samples past their borders, as past a segment's ends
    parts = arrays.without_excluded(trimmed, near(recording.excluded, trim))
    where = f"recording '{recording.name}'"
    length = filters.parallel_length(design.factor, design.band, design.fs)
    # before the weights are made: there may be more of them than memory
    if length > (longest := max(b - a for a, b in segments)):
        problem = f"decimate = {design.factor} needs {length} samples, a segment has {longest}"
        hint = "decimate less, raise band, or record longer"
        raise BadInput(f"{where}, decimate", problem, hint)
    taps = filters.parallel_taps(design.factor, design.band, design.fs)
    usable = np.ones(len(moving), dtype=np.bool_)
    of_ranges = (
        filters.lay_windows(taps, x, design.factor, usable) for x in (segments, trimmed, parts)
    )
    untrimmed, inner, included = (windows.n_outputs for windows in of_ranges)
    if inner == 0:
        problem = f"trim = {trim * recording.period:.3g} s leaves no segment of {length} samples"
        raise BadInput(f"{where}, trim", problem, "trim less, decimate less, or record longer")
    if included == 0:
        problem, hint = recording.lacking
        raise BadInput(f"{where}, exclude", f"{problem}: no output is left", hint)
    windows = filters.lay_windows(taps, parts, design.factor, moving, share)
    resolution = design.resolution
    # Torque and position then lose the same at the band's end. Not where every sample is an output,
    # as it would colour the noise, nor with central differences, as in published analyses.
    both = design.reach > 1 and design.used_band > 0.0
    settings: Settings = {
        "sampling_rate": design.fs,
        "lowpass": design.cutoff,
        "order": processing.order,
        "decimate": design.factor,
        "band": design.used_band,
        "filter_cutoff": filters.parallel_cutoff(design.factor, design.band, design.fs),
        "differentiation": processing.differentiation,
        "velocity": "differentiated" if recording.velocity is None else "measured",
        "reach": design.reach,
        "guard": design.guard,
        "band_by": resolution.reason,
        "noise_seen": resolution.noise,
        "dead_zone": float(dead_zone),
        "rest": processing.rest,
        "trim": trim * recording.period,
        "trim_samples": trim,
        "torque_lowpass": design.cutoff if both else 0.0,
        "motion": "encoder",
        "taps": len(taps),
        "n_samples": len(q),
        "n_segments": len(segments),
        "n_outputs": windows.n_outputs,
        "dropped_trim": untrimmed - inner,
        "dropped_excluded": inner - included,
        "dropped_dead_zone": included - windows.n_outputs,
    }
    if np.isfinite(resolution.acceleration_ratio):
        settings["acceleration_ratio"] = resolution.acceleration_ratio
    if recording.torque_constant is not None:
        settings["torque_constant"] = recording.torque_constant
    compared = inside & moving & ~recording.excluded
    return q, qd, compared, still & arrays.in_segments(parts, len(q)), windows, settings


# --- torque and motion ----------------------------------------------------------------------------


def applied_torque(recording: Measurement, reach: int) -> Array:
    """Return the torque ``(n,)`` that moves the joint, a maker's low-pass and a hold undone."""
    torque, segments = recording.torque, recording.segments
    if recording.feedback is not None:
        return target_torque(recording)
    if recording.torque_lag:
        return filters.inverse_lowpass(
            torque, segments, recording.period, recording.torque_lag, reach
        )
    return filters.delayed_command(torque, segments, 0.0, held=True) if recording.held else torque


def target_torque(recording: Measurement, delay: float = 0.0) -> Array:
    """Compute the torque ``(n,)`` of a drive whose target alone acts ``delay`` s late."""
    law, back_emf = recording.law, recording.back_emf
    assert law is not None
    command = unlimited_command(recording, delay)
    torque = law.scale * np.clip(command, -law.limit, law.limit)
    return np.asarray(torque if back_emf is None else torque - back_emf)


def unlimited_command(recording: Measurement, delay: float) -> Array:
    """Compute the command ``(n,)`` of such a drive before its limit."""
    law, samples = recording.law, delay / recording.period
    assert law is not None
    assert recording.feedback is not None
    command = filters.delayed_command(law.command, recording.segments, samples, held=bool(law.held))
    return np.asarray(command - recording.feedback)


def filtered_motion(
    recording: Measurement, cutoff: float, order: int, reach: int
) -> tuple[Array, Array]:
    """Low-pass position and speed of the joint ``(N,)``; differentiated if not recorded."""
    r, period = recording, recording.period
    q = filters.lowpass(r.position, r.segments, 1.0 / period, cutoff, order)
    if r.velocity is None:
        return q, filters.derivative(q, r.segments, period, reach)
    qd = filters.lowpass(r.velocity, r.segments, 1.0 / period, cutoff, order)
    if r.velocity_lag:
        qd = filters.inverse_lowpass(qd, r.segments, period, r.velocity_lag, reach)
    return q, qd


def as_position(torque: Array, segments: Segments, period: float, settings: Settings) -> Array:
    """Low-pass a measured torque ``(N,)`` where it passes the position's filter, too."""
    cutoff, order = float(settings.get("torque_lowpass", 0.0)), int(settings.get("order", 1))
    return filters.lowpass(torque, segments, 1.0 / period, cutoff, order)


def refinable(o: Signals) -> bool:
    """Whether the band ends well below the position's low-pass, so that a model may refine it."""
    band, cutoff = float(o.settings["band"]), float(o.settings["lowpass"])
    return o.settings["differentiation"] == "exact" and 0.0 < 2.0 * band <= cutoff


def with_motion(o: Signals, recording: Measurement, q: Array, qd: Array, qdd: Array) -> Signals:
    """Replace the low-passed motion by a refined one; the torque is then not low-passed."""
    settings = {**o.settings, "torque_lowpass": 0.0, "motion": "refined"}
    step = f"motion: above {float(settings['lowpass']):.4g} Hz the one with which the model takes "
    step += "the measured torque, which is not low-passed"
    raw = recording.inputs
    inputs = replace(o.inputs, load_torque=raw.load_torque, others=raw.others)
    speed, measured = qd[o.filter.centres], o.filter.apply(o.compared)
    unchanged = replace(o, inputs=inputs, steps=(*o.steps, step), settings=settings, smooth=o.qdd)
    return replace(unchanged, q=q, qd=qd, qdd=qdd, speed=speed, measured=measured)


# --- warnings and steps in words ----------------------------------------------------------------


def _band_warnings(design: _Design, recording: Measurement) -> Iterator[str]:
    """Warn of a band unlike the decimation, and of an acceleration that its noise drowns."""
    band, half, resolution = design.band, design.fs / (2 * design.factor), design.resolution
    low = filters.SHARING * half if design.factor > 1 else 0.0
    if band is not None and not low <= band <= filters.FOLDING * half * (1.0 + 1e-9):
        fitting = f"decimate = {filters.decimation(band, design.fs)} would fit"
        yield f"band: {band:.6g} Hz does not fit half the decimated rate, {half:.6g} Hz; {fitting}"
    if (ratio := resolution.acceleration_ratio) < filters.LEAST_RATIO:
        text = "position" if recording.velocity is None else "velocity"
        text += f": its noise or steps ({resolution.noise:.2g}, one sd) leave the acceleration only"
        text += f" {ratio:.2g} times its noise to {resolution.band:.3g} Hz, {filters.LEAST_RATIO:g}"
        text += " are needed: inertia comes out too small; lower band, or record a faster motion or"
        yield f"{text} a finer position"


def _velocity_warnings(factor: float | None, late: float | None) -> Iterator[str]:
    other, hint = "the differentiated position", "where a drive filters it, leave its line out"
    if factor is not None:
        text = f"velocity: is {factor:.3g} times {other}{checks.between(factor)}: are column, unit,"
        yield f"{text} sign and side of both right? {hint}"
    if late is not None:
        order = "after" if late > 0.0 else "before"
        yield f"velocity: comes {abs(late):.2g} s {order} {other}; {hint}"


def _step_sentences(design: _Design, recording: Measurement, settings: Settings) -> Iterator[str]:
    resolution, trim = design.resolution, design.trim_samples
    both = "both position and torque" if settings["torque_lowpass"] else "the position"
    how = f"zero-phase, of order {settings['order']} at {design.cutoff:.4g} Hz, of {both}"
    yield f"low-pass: {how if design.cutoff else 'none'} ({design.fs:.4g} Hz sampling)"
    end = design.used_band or design.cutoff or 0.25 * design.fs
    for signal, lag in ("torque", recording.torque_lag), ("velocity", recording.velocity_lag):
        if lag:
            times = math.hypot(1.0, (end / lag[0]) ** lag[1])
            text = f"{signal}: the low-pass at {lag[0]:.4g} Hz is undone; it and later noise are"
            yield f"{text} {times:.2g} times as large at the band's end"
    length = "rad" if recording.motion == "rotary" else "m"
    used, unit = "differentiated position", length
    if recording.velocity is not None:
        used, unit = "measured velocity", f"{length}/s"
    how = "central differences" if design.reach == 1 else f"{2 * design.reach + 1} points"
    yield f"velocity: {used}; acceleration: differentiated by {how}"
    if "acceleration_ratio" in settings:
        text = f"acceleration: {resolution.acceleration_ratio:.3g} times its noise (rms) to"
        text += f" {resolution.band:.3g} Hz; noise of a sample of the {used.split()[1]}"
        yield f"{text} {resolution.noise:.2g} {unit}"
    ended = {
        "sampling": "as wide as the sampling rate of the slowest signal allows",
        "position": "beyond which the position does not resolve the acceleration",
        "torque": "beyond which the torque has next to no power",
        "length": "the narrowest that leaves enough outputs of so short a recording",
        "model": "beyond which noise that grows with the motion takes from the inertia",
        "asked": "as set, or as the fitted part's",
    }
    yield f"band: ends at {end:.3g} Hz, {ended[resolution.reason]}"
    yield f"trim: {trim} samples off both ends of every segment"
    how = f"{settings['taps']} taps, cut-off {settings['filter_cutoff']:.4g} Hz"
    how = "none" if settings["taps"] == 1 else how
    yield f"parallel filter: {how}, one output in {design.factor} samples"
    slow = checks.too_slow(f"{settings['dead_zone']:.3g} {length}/s")
    dropped, left = int(settings["dropped_dead_zone"]), int(settings["n_outputs"])
    rest = f"; {n} at rest" if (n := settings.get("rest_outputs", 0)) else ""
    if dropped > left and "rest_outputs" not in settings:
        rest = "; rest = true under [processing] makes use of those at rest"
    yield f"dead zone: {dropped} outputs left out, {slow}; {left} remain{rest}"


# --- delay between torque and position ----------------------------------------------------------
#
# A position that is late by ``d`` belongs to the torque of ``d`` before, to first order near ``d0``
# ``y(t - d0) - (d - d0) y'(t - d0)``. So ``y(t - d0) + d0 y'(t - d0)`` is compared with a model
# that has the additional term ``d y'(t - d0)``, linear in the delay, up to second order.
# Of a torque from a target, the target acts late.


def timed(o: Signals, recording: Measurement, delay: float) -> Signals:
    """Use the torque of ``delay`` seconds earlier, up to the trimmed ends."""
    longest = longest_delay(o, recording.period)
    if abs(delay) > longest:
        problem = (
            f"the position comes {delay:.3g} s late, and {longest:.3g} s are trimmed off the ends"
        )
        hint = "correct the time stamps, or raise trim"
        raise BadInput(f"recording '{recording.name}', delay", problem, hint)
    corrected = retimed(o, recording.segments, recording.period, delay, recording)
    signal = "torque" if recording.feedback is None else "target"
    step = f"delay: {signal} of {delay:.3g} s before the position, and what it changes by"
    settings = {**o.settings, "delay": delay}
    return replace(corrected, steps=(*o.steps, step), settings=settings)


def longest_delay(o: Signals, period: float) -> float:
    """Longest delay, s, that the trimmed ends of a recording allow."""
    return float(o.settings.get("trim_samples", 0)) * period


def filtered_rate(o: Signals) -> Array:
    """Rate ``(M,)`` of the torque after :func:`retimed`, N m/s or N/s."""
    assert o.inputs.torque_rate is not None
    return o.filter.apply(o.inputs.torque_rate.values)


def retimed(
    o: Signals,
    segments: Segments,
    period: float,
    delay: float,
    recording: Measurement | None = None,
) -> Signals:
    """Correct as :func:`timed`, without checks; a back-EMF is computed from the position."""
    back_emf = None if recording is None else recording.back_emf
    if recording is not None and recording.feedback is not None:
        before, rate = target_torque(recording, delay), command_rate(o, recording, delay)
    else:
        emf = np.zeros_like(o.torque) if back_emf is None else back_emf
        before = filters.delayed_command(o.torque + emf, segments, delay / period, held=False) - emf
        rate = _rate(o, o.torque + emf, segments, period, delay)
    compared = before + delay * rate
    return replace(
        o,
        compared=compared,
        measured=o.filter.apply(as_position(compared, segments, period, o.settings)),
        inputs=replace(o.inputs, torque_rate=Signal(o.stamps, rate)),
    )


def command_rate(o: Signals, recording: Measurement, delay: float = 0.0) -> Array:
    """Rate ``(N,)`` of the torque by its late target alone, N m/s or N/s; 0 at its limit."""
    law = recording.law
    assert law is not None
    inside = np.abs(unlimited_command(recording, delay)) < law.limit
    late = delay + 0.5 * recording.period * bool(law.held)
    rate = _rate(o, law.command, recording.segments, recording.period, late)
    return np.asarray(law.scale * inside * rate)


def _rate(o: Signals, x: Array, segments: Segments, period: float, delay: float) -> Array:
    """Differentiate a delayed signal ``(N,)`` by time, low-passed as the position."""
    cutoff, order = float(o.settings.get("lowpass", 0.0)), int(o.settings.get("order", 1))
    # only noise is above the low-pass that the position has passed
    smooth = filters.lowpass(x, segments, 1.0 / period, cutoff, order)
    late = filters.delayed_command(smooth, segments, delay / period, held=False)
    return filters.derivative(late, segments, period, int(o.settings.get("reach", 1)))
