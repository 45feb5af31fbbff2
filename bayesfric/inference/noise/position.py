"""Noise of position and torque samples, where the position is what a likelihood explains."""

from __future__ import annotations

from bayesfric.inference.noise.scale import NoiseDescription, Scale, up_to

SCALES = (
    Scale("torque", r"\sigma_\Gamma", "noise of a torque sample", lambda s: up_to(s.torque)),
    Scale(
        "position",
        r"\sigma_q",
        "noise of a position sample",
        lambda s: up_to(s.position),
        unit="position",
    ),
)


class PositionNoise(NoiseDescription):
    """White noise of position samples, and of torque samples, which the joint integrates."""

    scales = SCALES
    description = "white in torque and position, torque noise carried through the simulation"
    # what drifts is correlated
    accounts_for_correlation = True
