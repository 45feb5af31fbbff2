"""Whether a position in another unit would explain a torque that is hardly explained."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np

from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings import units
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

_ANGLES = ("rad", "deg", "turn")
# What another reading leaves of the torque at most, over what this one leaves. Of the measured
# pendulums that spin the right unit leaves 0.03 to 0.4, and none leaves less than a right one does.
FAR_LESS = 0.5


def best_share(chain: Joint, observations: Sequence[Observation]) -> tuple[float, Array]:
    """Give the share of the torque's variance that the best totals explain, and what they leave."""
    projection = TotalsProjection(chain, observations)
    measured = np.concatenate([o.measured for o in observations])
    left = measured - projection.regressors @ projection.solve(measured)
    return 1.0 - float(np.var(left) / np.var(measured)), left


def other_units(
    chain: Joint, observations: Sequence[Observation], explained: float | None = None
) -> list[dict[str, Any]]:
    """List units of the position that explain far more, the best first.

    Each ``is`` a unit that was ``taken`` for another, with the ``share`` of the torque that totals
    then explain; ``explained`` is that as it was read, where it is known already. Only what
    depends on the angle itself, such as gravity, tells: nothing else changes with its scale.
    """
    if chain.load.motion != "rotary":
        return []
    if explained is None:
        explained = best_share(chain, observations)[0]
    least = 1.0 - FAR_LESS * (1.0 - explained)
    found = [one for one in _tried(chain, observations) if one["share"] > least]
    return sorted(found, key=lambda one: -float(one["share"]))


def _tried(chain: Joint, observations: Sequence[Observation]) -> Iterator[dict[str, Any]]:
    for one, other in permutations(_ANGLES, 2):
        times = units.scale([one], "angle") / units.scale([other], "angle")
        scaled = [
            replace(
                o,
                q=times * o.q,
                qd=times * o.qd,
                qdd=times * o.qdd,
                smooth=None,
                speed=times * o.speed,
            )
            for o in observations
        ]
        yield {"is": one, "taken": other, "share": best_share(chain, scaled)[0]}
