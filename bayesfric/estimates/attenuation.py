"""Whether a recording's band is so wide that noise of the acceleration attenuates the inertia.

Errors in a regressor lower its coefficient (attenuation) and leave torque unexplained. Noise at
standstill is not all of it: wrong time stamps make noise that grows with speed and frequency. So
the recording is fitted in narrower bands: where the inertia grows and less torque is unexplained
per hertz, the wider band is wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from bayesfric.base.errors import BadInput
from bayesfric.estimates.least_squares import totals_regressors
from bayesfric.estimates.torque_form import minimum_norm
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.filters import lowpass_above
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import Observation, filtered_rate, observe, retimed
from bayesfric.recordings.source import Processing

# Ratio of one band to the next, and narrower ones without a contradiction that end the search.
_STEP, _MISSES = 1.4, 2
# A narrower band contradicts a wider one by growth of the inertia, in sds of both together, or by
# the ratio of unexplained variances per hertz and its p value. Bands share outputs, so chance alone
# hardly ever reaches that; errors of the model leave less per hertz in wider bands.
_GROWTH, _VARIANCE_RATIO, _P_VALUE = 1.7, 2.0, 1e-3
# Least relative growth: load-dependent friction, which totals leave out, makes as much.
_LEAST_GROWTH = 0.01
# Least inertia, in its sds, that can be attenuated.
_LEAST_INERTIA = 4.0
# Least degrees of freedom of a fit.
_LEAST_FREEDOM = 20


@dataclass(frozen=True)
class Attenuated:
    """A recording's band that attenuates the inertia, and a narrower one that does not."""

    recording: str  # Its name
    band: float  # Upper ends of the two bands, Hz
    narrower: float
    inertia: float  # Inertia seen by the motor, by least squares in either, kg m² or kg
    larger: float


@dataclass(frozen=True)
class _BandFit:
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
    """List the recordings whose band is contradicted by a narrower one.

    Bands narrow by a factor of 1.4 until two in a row contradict no more. A narrower band
    contradicts a wider one where the inertia grows by more than 1 %, less variance is left per
    hertz, and either the inertia grows by 1.7 standard deviations or the variances differ by more
    than twofold and more than an F test at one in a thousand allows.
    """
    pairs = zip(recordings, observations, strict=True)
    checked = [_attenuated(chain, r, o, processing) for r, o in pairs]
    return [attenuated for attenuated in checked if attenuated]


def _attenuated(
    chain: Joint, recording: Measurement, observation: Observation, processing: Processing
) -> Attenuated | None:
    """Narrow the band of one recording as long as narrower ones contradict the best so far."""
    first = _fit_band(chain, recording, observation)
    # noise that takes a share of the inertia leaves at least that share of its torque unexplained
    if first is None or first.free * first.sd**2 < _LEAST_GROWTH * first.inertia**2:
        return None
    best, missed = first, 0
    for fit in _narrower_bands(chain, recording, observation, processing):
        best, missed = (fit, 0) if _beats(fit, best) else (best, missed + 1)
        if missed == _MISSES:
            break
    if best is first:
        return None
    return Attenuated(recording.name, first.band, best.band, first.inertia, best.inertia)


def _narrower_bands(
    chain: Joint, recording: Measurement, observation: Observation, processing: Processing
) -> Iterator[_BandFit]:
    """Fit the totals in ever narrower bands, low-pass and decimation going with them."""
    fs = 1.0 / recording.period
    factor = int(observation.settings["decimate"])
    share = 1.0
    while True:
        share *= _STEP
        decimation = round(share * factor)
        if decimation <= factor:
            continue
        settings = {
            "decimate": decimation,
            "lowpass": lowpass_above(fs / (2 * decimation), fs),
            "band": None,
        }
        try:
            filtered = observe(recording, processing.model_copy(update=settings))
            fit = _fit_band(chain, recording, filtered)
        except BadInput:  # it leaves no output
            return
        if fit is None:
            return
        yield fit


def _fit_band(chain: Joint, recording: Measurement, o: Observation) -> _BandFit | None:
    """Fit the totals in a band; ``None`` where the inertia is not identified.

    The torque's rate is one more regressor: a delay leaves torque as well, and is another matter.
    """
    names, totals = totals_regressors(replace(chain, delay=False), [o])
    free = o.measured.size - len(names) - 1
    if "inertia" not in names or free < _LEAST_FREEDOM:
        return None
    undelayed = retimed(o, recording.segments, recording.period, 0.0, recording)
    regressors = np.column_stack([totals, filtered_rate(undelayed)])
    _, shared, solution, _ = minimum_norm(regressors)
    i = names.index("inertia")
    if shared[i]:
        return None
    values = solution @ o.measured
    residual = o.measured - regressors @ values
    variance, band = float(residual @ residual) / free, 0.5 / o.period
    sd = float(np.sqrt(variance * (solution[i] @ solution[i])))
    return _BandFit(band, float(values[i]), sd, variance / band, free)


def _beats(narrow: _BandFit, wide: _BandFit) -> bool:
    """Whether a narrower band contradicts a wider one, as noise of the acceleration makes it."""
    if not narrow.inertia > _LEAST_INERTIA * narrow.sd:
        return False
    grows = narrow.inertia - wide.inertia
    if not (grows > _LEAST_GROWTH * abs(narrow.inertia) and wide.left > narrow.left):
        return False
    if grows > _GROWTH * np.hypot(narrow.sd, wide.sd):
        return True
    ratio = wide.left / narrow.left if narrow.left > 0.0 else np.inf
    return bool(ratio > max(_VARIANCE_RATIO, stats.f.isf(_P_VALUE, wide.free, narrow.free)))
