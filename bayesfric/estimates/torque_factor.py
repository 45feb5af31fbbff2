"""One factor of the whole torque by which it would agree with what is taken as known."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

from bayesfric.errors import BadInput
from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.methods import Given
from bayesfric.estimates.torque_near import larger
from bayesfric.mechanism.parameter import scales_with_torque

_GAIN = "drive.gain"
# Standard deviations that are no chance, and what is no small mistake of the model.
_SURE, _LARGE = 4.0, 0.05


@dataclass(frozen=True)
class TorqueFactor:
    """The measured torque over the one that agrees with values and masses that are known."""

    value: float
    sd: float  # the larger of the plain and the robust one
    fixed: tuple[str, ...]  # the values that give the torque its scale
    masses: tuple[float, ...]  # and the known masses on the load, kg

    @property
    def times(self) -> float:
        """By how many sds the logarithm is off."""
        return abs(math.log(self.value)) * self.value / self.sd

    @property
    def matters(self) -> bool:
        """Whether it is no chance, and large."""
        return self.times > _SURE and abs(math.log(self.value)) > _LARGE


def torque_factor(given: Given, point: Mapping[str, float]) -> TorqueFactor | None:
    """Estimate the factor, by the input error with an unknown gain, from a ``point`` without.

    ``None`` where nothing is taken as known that gives the torque its scale, where the gain is
    fitted already, or where the recordings do not tell it.
    """
    chain, knowledge = given.chain, given.knowledge
    fixed = [
        p.name
        for p in chain.parameters
        if knowledge.fixed.get(p.name, 0.0) > 0.0 and scales_with_torque(p.unit)
    ]
    masses = sorted({o.inputs.added_mass for o in given.observations} - {0.0})
    known = bool(fixed) or any(o.inputs.known_load for o in given.observations)
    if chain.gain or not known:
        return None
    with suppress(BadInput):
        start, free = {**point, _GAIN: 1.0}, replace(chain, gain=True)
        found = input_error(free, given.observations, knowledge, given.options, start)[_GAIN]
        sd = larger(found.sd, found.sd_robust)
        if found.at_bound is None and math.isfinite(sd) and sd > 0.0 < found.value:
            value = 1.0 / found.value
            return TorqueFactor(value, sd * value**2, tuple(fixed), tuple(masses))
    return None
