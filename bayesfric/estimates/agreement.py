"""Whether input and output error agree, and which to believe where they do not."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesfric.estimates.point_estimate import Estimate
from bayesfric.estimates.torque import filtered_torque
from bayesfric.estimates.torque_near import larger
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.observation import Observation
from bayesfric.recordings.resolution import LEAST_RATIO

# Standard deviations of both, the larger ones, that are no chance.
_FAR = 3.0
# How many times as much torque another minimum leaves, where noise alone makes hardly a hundredth.
_MORE = 1.2
# And though its sds are so wide that numbers do not differ beyond them.
_MUCH_MORE = 2.0
# Robust sds over plain ones beyond which the plain one means nothing.
TOO_SMALL = 2.0


@dataclass(frozen=True)
class Agreement:
    """What parts input and output error."""

    apart: tuple[str, ...]  # numbers that differ by more than their sds, the worst first
    # numbers that one of them has on a bound, the other far from it
    on_bound: tuple[str, ...]
    torque: tuple[float, float]  # rms that the values of each leave of the torque
    unit: str  # of these
    ratio: float  # the least of the acceleration over its noise; infinite where that is not known
    # how many times as large the output error's sds are, the larger ones, in the middle; 1 where
    # nothing is determined
    wider: float

    @property
    def agree(self) -> bool:
        """Whether there is nothing to choose."""
        elsewhere = self.torque[1] > _MUCH_MORE * self.torque[0]
        return not self.apart and not self.on_bound and not elsewhere

    @property
    def believed(self) -> Literal["input-error", "output-error"] | None:
        """Which the data speak for; ``None`` where they do not say."""
        if self.torque[1] > _MORE * self.torque[0]:
            return "input-error"
        return "output-error" if self.ratio < LEAST_RATIO else None


def agreement(
    found: Sequence[Estimate], chain: Joint, observations: Sequence[Observation]
) -> Agreement | None:
    """Compare both, where both were made and converged."""
    by = {one.method: one for one in found if one.converged}
    if not {"input-error", "output-error"} <= by.keys():
        return None
    torque, motion = by["input-error"], by["output-error"]
    off: dict[str, float] = {}
    bound, narrower = [], []
    for value in torque.values:
        if value.name not in motion:
            continue
        other = motion[value.name]
        sds = larger(value.sd, value.sd_robust), larger(other.sd, other.sd_robust)
        away = abs(other.value - value.value)
        if value.at_bound != other.at_bound:
            # the one on a bound has no sd
            told = [s for s, v in zip(sds, (value, other), strict=True) if not v.at_bound]
            if any(math.isfinite(sd) and away > _FAR * sd for sd in told):
                bound.append(value.name)
        elif value.at_bound is None and np.isfinite(sds).all() and (both := math.hypot(*sds)):
            off[value.name] = away / both
            narrower.append(sds[1] / sds[0] if sds[0] else math.inf)
    apart = sorted((name for name, by in off.items() if by > _FAR), key=lambda name: -off[name])
    left = [_left(dict(one.point), chain, observations) for one in (torque, motion)]
    ratio = min(float(o.settings.get("acceleration_ratio", math.inf)) for o in observations)
    wider = float(np.median(narrower)) if narrower else 1.0
    parts = tuple(apart), tuple(bound), (left[0], left[1])
    return Agreement(*parts, torque.residual_unit, ratio, wider)


def _left(point: Mapping[str, float], chain: Joint, observations: Sequence[Observation]) -> float:
    values = chain.vector(point)[None]
    left = [o.measured - filtered_torque(chain, o, values)[0] for o in observations]
    return float(np.sqrt(np.mean(np.concatenate(left) ** 2)))
