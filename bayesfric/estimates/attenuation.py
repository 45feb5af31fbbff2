"""Whether a recording's band is so wide that what is taken for acceleration is partly noise.

Noise of the acceleration takes part of the inertia (attenuation, as errors in variables do), and
leaves torque unexplained where it is. What a position at rest shows of it is not all: time stamps
that are not those of the samples, or a torque of another instant, make noise that grows with speed.
It grows with frequency, too. So the same recording is looked at in narrower bands: where inertia
comes out larger and a hertz of the band holds less that is unexplained, the wider one is wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from bayesfric.base.errors import BadInput
from bayesfric.estimates.least_squares import totals_regressors
from bayesfric.estimates.torque_form import shortest
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import Observation, observe
from bayesfric.recordings.processing import Processing
from bayesfric.recordings.resolution import lowpass_above
from bayesfric.recordings.timing import filtered_rate, retimed

# From one band to the next, and how many narrower ones may contradict a band.
_NARROWER, _NEXT = 1.4, 2
# The inertia grows by so many sds, both bands' together, with less left per hertz; or at all, with
# so much less left, and where that is less often by chance than once in a thousand times. Bands
# share outputs, so that by chance it hardly ever grows by that. What the model's own
# errors leave per hertz is less in wider bands.
_SDS, _LESS, _SELDOM = 1.7, 2.0, 1e-3
# By a smaller share it grows where load losses bend the torque that totals are linear in.
_WORTH = 0.01
# An inertia below so many of its sds is none that could be lost.
_TOLD = 4.0
# Outputs more than what is fitted to them, or nothing is told.
_FREE = 20


@dataclass(frozen=True)
class Attenuated:
    """A recording's band in which part of the inertia is lost, and one without that."""

    recording: str  # Its name
    band: float  # Upper ends of the two bands, Hz
    narrower: float
    inertia: float  # Inertia seen by the motor, by least squares in either, kg m² or kg
    larger: float


@dataclass(frozen=True)
class _Seen:
    """Least squares of the totals in one band."""

    band: float  # Hz
    inertia: float  # Total inertia seen by the motor and its standard deviation
    sd: float
    left: float  # Unexplained variance of the torque per hertz of the band
    free: int  # Degrees of freedom of the residuals


def attenuations(
    chain: Joint,
    recordings: Sequence[Measurement],
    observations: Sequence[Observation],
    processing: Processing,
) -> list[Attenuated]:
    """Find recordings whose band is contradicted by a narrower one, and none narrower by that.

    Bands narrow by a factor of 1.4 until two in a row contradict no more. A narrower band
    contradicts a wider one where the inertia grows by more than 1 %, less variance is left per
    hertz, and either the inertia grows by 1.7 standard deviations or the variances differ by more
    than twofold and more than an F test at one in a thousand allows.
    """
    pairs = zip(recordings, observations, strict=True)
    found = [_attenuated(chain, r, o, processing) for r, o in pairs]
    return [one for one in found if one]


def _attenuated(
    chain: Joint, recording: Measurement, observation: Observation, processing: Processing
) -> Attenuated | None:
    """Narrow the band of one recording as long as that contradicts the best so far."""
    first = _seen(chain, recording, observation)
    # noise that takes a share of the inertia leaves at least that share of its torque unexplained
    if first is None or first.free * first.sd**2 < _WORTH * first.inertia**2:
        return None
    best, missed = first, 0
    for one in _narrower(chain, recording, observation, processing):
        best, missed = (one, 0) if _beats(one, best) else (best, missed + 1)
        if missed == _NEXT:
            break
    if best is first:
        return None
    return Attenuated(recording.name, first.band, best.band, first.inertia, best.inertia)


def _narrower(
    chain: Joint, recording: Measurement, observation: Observation, processing: Processing
) -> Iterator[_Seen]:
    """Least squares in ever narrower bands, low-pass and decimation going with them."""
    fs = 1.0 / recording.period
    factor = int(observation.settings["decimate"])
    share = 1.0
    while True:
        share *= _NARROWER
        wanted = round(share * factor)
        if wanted <= factor:
            continue
        changed = {
            "decimate": wanted,
            "lowpass": lowpass_above(fs / (2 * wanted), fs),
            "band": None,
        }
        try:
            narrower = observe(recording, processing.model_copy(update=changed))
            seen = _seen(chain, recording, narrower)
        except BadInput:  # it leaves no output
            return
        if seen is None:
            return
        yield seen


def _seen(chain: Joint, recording: Measurement, o: Observation) -> _Seen | None:
    """Least squares of the totals in a band; ``None`` where the inertia is not identified.

    What a delay would leave of the torque is taken off as one more regressor.
    """
    names, totals = totals_regressors(replace(chain, delay=False), [o])
    free = o.measured.size - len(names) - 1
    if "inertia" not in names or free < _FREE:
        return None
    # a delay leaves torque as well, and is another matter: what it would leave is taken off, too
    there = retimed(o, recording.segments, recording.period, 0.0, recording)
    regressors = np.column_stack([totals, filtered_rate(there)])
    _, shared, solution, _ = shortest(regressors)
    i = names.index("inertia")
    if shared[i]:
        return None
    values = solution @ o.measured
    left = o.measured - regressors @ values
    variance, half = float(left @ left) / free, 0.5 / o.period
    sd = float(np.sqrt(variance * (solution[i] @ solution[i])))
    return _Seen(half, float(values[i]), sd, variance / half, free)


def _beats(narrow: _Seen, wide: _Seen) -> bool:
    """Whether a narrower band contradicts a wider one as noise of the acceleration would."""
    if not narrow.inertia > _TOLD * narrow.sd:
        return False
    grows = narrow.inertia - wide.inertia
    if not (grows > _WORTH * abs(narrow.inertia) and wide.left > narrow.left):
        return False
    if grows > _SDS * np.hypot(narrow.sd, wide.sd):
        return True
    ratio = wide.left / narrow.left if narrow.left > 0.0 else np.inf
    return bool(ratio > max(_LESS, stats.f.isf(_SELDOM, wide.free, narrow.free)))
