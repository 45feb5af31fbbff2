"""Noise of position and torque samples, for the likelihood of the position."""

from __future__ import annotations

from bayesfric.estimates.least_squares import TypicalSizes
from bayesfric.inference.noise.scale import NoiseDescription, Scale, up_to
from bayesfric.inference.prior.priors import PriorText

# Rounding to steps is noise of step/sqrt(12): the prior begins at a third of it. With a gearbox
# between encoder and joint that may be a hundred-millionth of the range.
_OF_STEP = 0.1
# Lower end over the range if no steps are visible: below any encoder's.
_OF_RANGE = 1e-10


def _position(sizes: TypicalSizes) -> PriorText:
    """Return the prior of the position's noise, from below the encoder's step."""
    least = max(_OF_STEP * sizes.position_step, _OF_RANGE * sizes.position)
    return up_to(sizes.position, least)


SCALES = (
    Scale("torque", r"\sigma_\Gamma", "noise of a torque sample", lambda s: up_to(s.torque)),
    Scale("position", r"\sigma_q", "noise of a position sample", _position, unit="position"),
)


# White noise of position and torque samples; the joint integrates the latter, so errors are
# correlated.
POSITION_NOISE = NoiseDescription(
    SCALES,
    "white in torque and position, torque noise carried through the simulation",
    accounts_for_correlation=True,
)
