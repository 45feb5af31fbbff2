"""Default priors: weakly informative, scaled by what the recordings move and take.

No single term is expected to need much more torque than the largest measured
one. So a constant loss gets a half-normal with that torque as its scale, a
viscous loss that torque over the typical speed, an inertia that torque over the
typical acceleration, each at its own element's shaft. Scales are rounded to one
digit: they state an order of magnitude, not a measurement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesfric.inference.prior.priors import Prior, PriorText, read_prior
from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.parameter import TURN, Parameter, entry_of
from bayesfric.recordings.observation import Observation

# A reversible gearbox keeps mu_2 below one: alpha_2 = 1/(1 - mu_2) is finite.
_REVERSIBLE = 1.0


@dataclass(frozen=True)
class Scales:
    """Sizes of what was measured.

    Attributes
    ----------
    torque
        Largest measured motor torque (99.9th percentile), N m or N.
    speed, acceleration
        Root mean square at the joint.
    position
        Range of the joint's position, rad or m.
    """

    torque: float
    speed: float
    acceleration: float
    position: float = 1.0


def measured_scales(observations: Sequence[Observation]) -> Scales:
    """Take the scales of the default priors from all recordings together."""
    torque = np.concatenate([o.measured for o in observations])
    # only where outputs are: an excluded glitch must not set a scale
    speed = np.concatenate([o.qd[o.filter.centres] for o in observations])
    acceleration = np.concatenate([o.qdd[o.filter.centres] for o in observations])
    duration = sum(o.period * o.measured.size for o in observations)
    rms_speed = float(np.sqrt(np.mean(speed**2)))
    return Scales(
        torque=float(np.quantile(np.abs(torque), 0.999)),
        speed=rms_speed,
        # a motion that hardly accelerates still changes its speed once in the recording
        acceleration=max(float(np.sqrt(np.mean(acceleration**2))), rms_speed / duration),
        position=max(float(np.ptp(o.q[o.filter.centres])) for o in observations),
    )


def default_prior(chain: Chain, p: Parameter, scales: Scales) -> Prior:
    """Choose the default prior of one parameter.

    Parameters
    ----------
    chain
        The mechanism, for the ratio between the motor and the parameter's shaft.
    p
        The parameter.
    scales
        From :func:`measured_scales`.
    """
    text = _text(chain, p, scales)
    upper = min(p.upper, _REVERSIBLE) if p.quantity in ("load", "load_back") else p.upper
    return read_prior(p.name, text, lower=p.lower, upper=upper, default=True, circular=p.circular)


def _text(chain: Chain, p: Parameter, scales: Scales) -> PriorText:
    to_motor, to_joint = _ratios(chain, p)
    torque = scales.torque * to_motor
    speed, acceleration = scales.speed * to_joint, scales.acceleration * to_joint
    half_normal = {
        "inertia": torque / acceleration,
        "viscous": torque / speed,
        "coulomb": torque,
        "coulomb_positive": torque,
        "coulomb_negative": torque,
        "quadratic": torque / speed**2,
        "stribeck_ratio": 1.0,
        "stribeck_velocity": speed,
        "load": 0.5,
        "load_drive": 0.5,
        "load_back": 0.5,
        "first_moment": torque / abs(chain.load.gravity),
    }
    texts: dict[str, PriorText] = {
        quantity: {"distribution": "halfnorm", "scale": _one_digit(scale)}
        for quantity, scale in half_normal.items()
    }
    texts |= {
        "offset": {"distribution": "norm", "scale": _one_digit(scales.torque)},
        "gain": {"distribution": "lognorm", "s": 0.5},
        "gravity_angle": [-TURN / 2.0, TURN / 2.0],
    }
    return entry_of(texts, p.quantity, "the choice of default priors")


def _ratios(chain: Chain, p: Parameter) -> tuple[float, float]:
    """Speed ratios from the motor to the parameter's shaft and from there to the joint."""
    owner = p.name.rpartition(".")[0]
    before = 1.0
    for element in chain.elements:
        if element.name == owner:
            return before, chain.ratio / before
        before *= element.ratio
    return (1.0, chain.ratio) if owner in ("", "drive") else (chain.ratio, 1.0)


def _one_digit(x: float) -> float:
    return float(f"{x:.0e}")
