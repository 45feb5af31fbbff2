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
from bayesfric.recordings.signals import Signals, observe, settled, window
from bayesfric.recordings.source import Processing


class Validation(Options):
    """The ``[validation]`` table."""

    recordings: tuple[str, ...] = Field(
        (),
        description="names of recordings that the fit does not see but predicts",
        examples=[("run-3",)],
    )
    hold_out: float | None = Field(
        None, gt=0, lt=1, description="share of every other one that is predicted", examples=[0.2]
    )


@dataclass(frozen=True, eq=False)
class Part:
    """A recording, or the beginning or end of one, that is fitted or predicted."""

    recording: Measurement  # as read; the name is that of the whole recording
    observation: Signals  # as prepared
    held_out: str = ""  # "whole recording", or "last 20 %"; empty for a fitted part

    @property
    def name(self) -> str:
        """Name of the recording."""
        return self.recording.name


def fitted(parts: Sequence[Part]) -> tuple[list[Measurement], list[Signals]]:
    """Return the recordings that are fitted, and their observations."""
    remaining = [part for part in parts if not part.held_out]
    return [part.recording for part in remaining], [part.observation for part in remaining]


def divide(
    recordings: Sequence[Measurement], processing: Processing, validation: Validation
) -> list[Part]:
    """Split recordings into what is fitted and what is held out, and prepare both.

    Ends are cut off before anything is filtered, behind a gap of one window and ten outputs, so
    that their torque does not leak into the fit. They get the dead zone of the fitted part.
    """
    names, where = [r.name for r in recordings], "validation.recordings"
    for name in validation.recordings:
        if name not in names:
            raise BadInput(where, f"no recording is called {name!r}", nearest(name, names))
    if set(names) == set(validation.recordings):
        raise BadInput(where, "holds out every recording", "leave one to fit")
    parts = list[Part]()
    for recording in recordings:
        if recording.name in validation.recordings:
            parts.append(Part(recording, observe(recording, processing), "whole recording"))
            _check(parts[-1], where, f"recording {recording.name!r}")
        elif validation.hold_out is not None:
            parts += _without_end(recording, processing, validation.hold_out)
        else:
            parts.append(Part(recording, observe(recording, processing)))
    return parts


def _without_end(
    recording: Measurement, processing: Processing, share: float, *, gap: int = 10
) -> list[Part]:
    """Hold out the last share, a window and ``gap`` outputs off, beyond the noise's correlation."""
    where, name = "validation.hold_out", recording.name
    n = recording.time.size
    begin = n - round(share * n)
    if begin > LEAST_SAMPLES:
        # only the fitted part determines the band; a remainder that is too short is refused below
        with suppress(BadInput):
            processing = settled(recording.within(((0, begin),)), processing)
    length, step = window(recording, processing)
    last = begin - length - gap * step
    part = f"last {100 * share:.3g} %"
    whose = f"the {part} of recording {name!r}"
    if last < 1:
        raise BadInput(where, f"leaves nothing of recording {name!r}", "hold out less")
    if begin >= n:
        raise BadInput(where, f"{whose} is not even one sample", "hold out more")

    def observed(recording: Measurement, processing: Processing, whose: str) -> Signals:
        try:
            return observe(recording, processing)
        except BadInput as error:
            problem = f"{whose}: {error.problem}"
            raise BadInput(where, problem, "hold out another share") from None

    rest, end = (recording.within((span,)) for span in ((0, last), (begin, n)))
    o = observed(rest, processing, f"what is left of recording {name!r}")
    note = f"held out: {whose}, from {end.time[0]:.4g} s on, and {begin - last} samples before it "
    o = replace(o, steps=(*o.steps, f"{note}as a gap"))
    # the dead zone of an end at standstill would be zero
    same = processing.model_copy(update={"dead_zone": float(o.settings["dead_zone"])})
    predicted = observed(end, same, whose)
    held_out = Part(end, replace(predicted, warnings=()), part)
    _check(held_out, where, whose)
    return [Part(rest, o), held_out]


def _check(part: Part, where: str, whose: str, *, least: int = 20) -> None:
    """Refuse what determines no coverage of a 90 % interval."""
    if not np.ptp(part.recording.position) > 0.0:
        raise BadInput(where, f"{whose}: the joint never moves", "hold out another part")
    if (count := part.observation.measured.size) < least:
        problem = f"{whose} is too short: {count} outputs after filtering, at least "
        raise BadInput(where, f"{problem}{least} are needed", "hold out more, or decimate less")
