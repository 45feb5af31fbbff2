"""What a back-EMF cannot be told from, where the torque was computed from a motor voltage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesfric.identifiability.virtual_recording import scaled_jacobian, torque_noise
from bayesfric.inference.local_units import units_of
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Measurement

# Sine of the angle below which two columns of a Jacobian are one.
_SAME = 1e-6


@dataclass(frozen=True)
class SpeedTerm:
    """What a torque proportional to speed, such as a back-EMF's, cannot be told from."""

    recordings: tuple[str, ...]  # Those whose torque comes from a voltage
    # kt²/R as given, the largest: what the speed takes off, in N m s or N s/m at the motor
    nominal: float
    unit: str
    # Parameters whose effect, each one's or all together, has the same shape exactly
    same_as_back_emf: tuple[str, ...]
    # Share of the term's square that some change of parameters makes up for, 0 to 1
    explained: float

    @property
    def meaning(self) -> str:
        """Say what is confounded, and what measurement would tell it apart."""
        names = " and ".join(self.same_as_back_emf)
        told = (
            f"torque comes from a voltage ({', '.join(self.recordings)}), less the nominal "
            f"back-EMF kt²/R ({self.nominal:.3g} {self.unit}, at the motor) times speed"
        )
        if not names:
            return (
                f"{told}; parameters make up for {100.0 * self.explained:.0f} % of an error in it"
            )
        return (
            f"{told}; viscous loss and back-EMF cannot be told apart, as that has exactly the shape"
            f" of {names}: viscous loss plus the error of the nominal kt²/R. A measured current, or"
            " kt and R measured at a standstill, would tell them apart"
        )


def speed_term(
    target: Target, parameters: Array, recordings: Sequence[Measurement]
) -> SpeedTerm | None:
    """Compare a torque proportional to speed with what the parameters can do.

    With ``V = R I + kt w`` the torque computed from a voltage is ``kt V/R - kt² w/R`` at the
    motor's speed w; an error of the nominal ``kt²/R`` adds a term proportional to speed. That,
    filtered and whitened as the torque is, is projected on the columns of the Jacobian.

    Shapes: parameters (d,).
    """
    observations = target.likelihood.observations
    nominal = {r.name: r.nominal_back_emf for r in recordings if r.nominal_back_emf}
    told = tuple(o.name for o in observations if o.name in nominal)
    if not told:
        return None
    at, values = units_of(target, parameters), target.chain_values(parameters[None])[0]
    noise = [torque_noise(target, parameters, r) for r in range(len(observations))]
    pairs = list(zip(observations, noise, strict=True))
    blocks = [scaled_jacobian(target, o, values, at, one) for o, one in pairs]
    jacobian = np.concatenate(blocks)
    term = np.concatenate(
        [one.whitened(o.filter.apply(o.qd) * (o.name in told), o) for o, one in pairs]
    )
    term /= np.linalg.norm(term)
    sizes = np.linalg.norm(jacobian, axis=0)
    unit = jacobian / np.where(sizes > 0.0, sizes, 1.0)
    apart = np.linalg.norm(unit - np.outer(term, term @ unit), axis=0)
    same = np.flatnonzero((sizes > 0.0) & (apart < _SAME))
    parts = np.linalg.lstsq(unit, term, rcond=1e-9)[0]
    rest = term - unit @ parts
    if not same.size and np.linalg.norm(rest) < _SAME:  # as of a loss by direction
        same = np.flatnonzero(np.abs(parts) > _SAME)
    return SpeedTerm(
        told,
        max(nominal[name] for name in told),
        "N m s" if target.likelihood.chain.motor_motion == "rotary" else "N s/m",
        tuple(target.free[j] for j in same),
        float(1.0 - rest @ rest),
    )
