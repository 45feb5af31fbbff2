"""Held-out recordings, and ends of recordings, that a fit predicts."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.options import Options
from bayesfric.recordings.measurement import LEAST_SAMPLES, Measurement
from bayesfric.recordings.observation import Observation, observe, settled, window
from bayesfric.recordings.source import Processing

# Outputs left out before a held-out end, in addition to one window of the parallel filter, for the
# autocorrelation of the noise to decay.
_GAP = 10
# Fewer outputs do not determine the coverage of a 90 % interval.
_LEAST = 20


class Validation(Options):
    """The ``[validation]`` table."""

    recordings: tuple[str, ...] = Field(
        (),
        description="names of recordings that the fit does not see; it predicts them instead, "
        "and reports how well",
        examples=[("run-3",)],
    )
    hold_out: float | None = Field(
        None,
        gt=0,
        lt=1,
        description="share of every fitted recording, at its end, that the fit does not see "
        "either; none if left out",
        examples=[0.2],
    )


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A recording, or the end of one, that is predicted and not fitted."""

    recording: Measurement  # as read; the name is that of the whole recording
    observation: Observation  # as prepared
    part: str  # "whole recording", or "last 20 %"

    @property
    def name(self) -> str:
        """Name of the recording."""
        return self.recording.name


@dataclass(frozen=True, eq=False)
class Divided:
    """Fitted recordings with their observations, and what is to be predicted."""

    recordings: list[Measurement]
    observations: list[Observation]
    held_out: tuple[HeldOut, ...]


def divide(
    recordings: Sequence[Measurement], processing: Processing, validation: Validation
) -> Divided:
    """Split recordings into what is fitted and what is held out, and prepare both.

    Ends are cut off before anything is filtered, behind a gap of one window and ten outputs, so
    that their torque does not leak into the fit. They get the dead zone of the fitted part.
    """
    names = [r.name for r in recordings]
    for name in validation.recordings:
        if name not in names:
            raise BadInput(
                "validation.recordings", f"no recording is called {name!r}", nearest(name, names)
            )
    if set(names) == set(validation.recordings):
        raise BadInput("validation.recordings", "holds out every recording", "leave one to fit")
    fitted: list[tuple[Measurement, Observation]] = []
    held_out: list[HeldOut] = []
    for recording in recordings:
        if recording.name in validation.recordings:
            o = observe(recording, processing)
            _check(recording, o, "validation.recordings", f"recording {recording.name!r}")
            held_out.append(HeldOut(recording, o, "whole recording"))
        elif validation.hold_out is not None:
            rest, o, end = _without_end(recording, processing, validation.hold_out)
            fitted.append((rest, o))
            held_out.append(end)
        else:
            fitted.append((recording, observe(recording, processing)))
    return Divided([r for r, _ in fitted], [o for _, o in fitted], tuple(held_out))


def _without_end(
    recording: Measurement, processing: Processing, share: float
) -> tuple[Measurement, Observation, HeldOut]:
    """Hold out the last share of the samples, with a gap before it."""
    where = "validation.hold_out"
    n = recording.time.size
    begin = n - round(share * n)
    if begin > LEAST_SAMPLES:
        # only the fitted part determines the band
        first = _piece(recording, 0, begin)
        with suppress(BadInput):  # a remainder that is too short is refused below
            processing = settled(first, processing)
    length, step = window(recording, processing)
    last = begin - length - _GAP * step
    part = f"last {100 * share:.3g} %"
    whose = f"the {part} of recording {recording.name!r}"
    if last < 1:
        raise BadInput(where, f"leaves nothing of recording {recording.name!r}", "hold out less")
    if begin >= n:
        raise BadInput(where, f"{whose} is not even one sample", "hold out more")
    rest, end = _piece(recording, 0, last), _piece(recording, begin, n)
    o = _observed(rest, processing, f"what is left of recording {recording.name!r}")
    step_sentence = (
        f"held out: {whose}, from {end.time[0]:.4g} s on, "
        f"and {begin - last} samples before it as a gap"
    )
    o = replace(o, steps=(*o.steps, step_sentence))
    # the dead zone of an end at standstill would be zero
    same = processing.model_copy(update={"dead_zone": float(o.settings["dead_zone"])})
    predicted = _observed(end, same, whose)
    _check(end, predicted, where, whose)
    return rest, o, HeldOut(end, replace(predicted, warnings=()), part)


def _observed(recording: Measurement, processing: Processing, whose: str) -> Observation:
    try:
        return observe(recording, processing)
    except BadInput as error:
        problem = f"{whose}: {error.what}"
        raise BadInput("validation.hold_out", problem, "hold out another share") from None


def _check(recording: Measurement, o: Observation, where: str, whose: str) -> None:
    if not np.ptp(recording.position) > 0.0:
        raise BadInput(where, f"{whose}: the joint never moves", "hold out another part")
    if o.measured.size < _LEAST:
        raise BadInput(
            where,
            f"{whose} is too short: {o.measured.size} outputs after filtering, at least "
            f"{_LEAST} are needed",
            "hold out more, or decimate less",
        )


def _piece(r: Measurement, begin: int, end: int) -> Measurement:
    """Cut a recording to samples ``begin`` to ``end``; too short segments go, as in reading."""
    cut = [(max(a, begin), min(b, end)) for a, b in r.segments if a < end and b > begin]
    segments = [(a, b) for a, b in cut if b - a >= LEAST_SAMPLES] or cut
    begin, end = segments[0][0], segments[-1][1]
    return r.part(slice(begin, end), tuple((a - begin, b - begin) for a, b in segments))
