"""Whether a position of another time would explain a torque that is hardly explained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.filters import later
from bayesfric.recordings.observation import Observation
from bayesfric.report.summary.position_unit import FAR_LESS, best_share

# Times are tried up to this many s and steps to either side, and a tenth of a recording; a step is
# such a share of the time from one output to the next, in which no torque of the band changes much.
_LONGEST, _STEPS, _SHARE = 0.5, 40, 0.25
# And then with steps as much finer about the best.
_FINER = 8


def other_time(
    chain: Joint, observations: Sequence[Observation], explained: float, enough: float
) -> dict[str, Any] | None:
    """Give the ``delay`` of the position, s, by which totals explain most, and that ``share``.

    One for all recordings. ``None`` unless that is ``enough`` and leaves far less than what
    ``explained`` leaves: a swing at one frequency takes a quarter of its period for a spring.
    """
    step = _SHARE * min(o.period for o in observations)
    shortest = min(float(np.ptp(o.stamps)) for o in observations)
    steps = int(min(_STEPS, min(_LONGEST, 0.1 * shortest) / step))
    tried: dict[float, float] = {}
    for width, about in ((step, range(-steps, steps + 1)), (step / _FINER, range(-7, 8))):
        middle = max(tried, key=tried.__getitem__, default=0.0)
        for k in about:
            delay = middle + k * width
            if delay not in tried:
                tried[delay] = best_share(chain, [_earlier(o, delay) for o in observations])[0]
    delay = max(tried, key=tried.__getitem__)
    if tried[delay] < enough or 1.0 - tried[delay] > FAR_LESS * (1.0 - explained):
        return None
    return {"delay": delay, "share": tried[delay]}


def _earlier(o: Observation, delay: float) -> Observation:
    """Take the motion that is recorded so much later; the dead zone stays where it was."""
    samples = delay / float(np.median(np.diff(o.stamps)))
    q, qd, qdd = (later(one, -samples) for one in (o.q, o.qd, o.qdd))
    return replace(o, q=q, qd=qd, qdd=qdd, smooth=None, speed=qd[o.filter.centres])
