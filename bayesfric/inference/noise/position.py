"""Noise of position and torque samples, where the position is what a likelihood explains.

How large may the encoder's and the torque's errors be, and which priors do their standard
deviations have when nothing is said of them?
"""

from __future__ import annotations

from bayesfric.estimates.sizes import TypicalSizes
from bayesfric.inference.noise.scale import NoiseDescription, Scale, up_to
from bayesfric.inference.prior.priors import PriorText

# Rounding to steps is noise of step/sqrt(12), and no noise is less: the prior begins at a third of
# it. With a gearbox between encoder and joint that is a hundred-millionth of the range and less.
_OF_STEP = 0.1
# The same of the range, where no steps are seen: no encoder is as fine.
_OF_RANGE = 1e-10


def _position(sizes: TypicalSizes) -> PriorText:
    """Spread the prior of the position's noise from below what the encoder resolves."""
    least = max(_OF_STEP * sizes.position_step, _OF_RANGE * sizes.position)
    return up_to(sizes.position, least)


SCALES = (
    Scale("torque", r"\sigma_\Gamma", "noise of a torque sample", lambda s: up_to(s.torque)),
    Scale(
        "position",
        r"\sigma_q",
        "noise of a position sample",
        _position,
        unit="position",
    ),
)


# White noise of position samples, and of torque samples, which the joint integrates: what drifts is
# correlated.
POSITION_NOISE = NoiseDescription(
    SCALES,
    "white in torque and position, torque noise carried through the simulation",
    accounts_for_correlation=True,
)
