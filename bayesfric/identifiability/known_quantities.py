"""What the result owes to what is known besides the torque: a mass, a back-EMF, no ripple."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.information import directions
from bayesfric.estimates.torque import filtered_torque
from bayesfric.identifiability.local import LocalInformation, units_of
from bayesfric.identifiability.sentences import Statement, stated
from bayesfric.identifiability.virtual_recording import TorqueNoise, scaled_jacobian, torque_noise
from bayesfric.inference.target import Target
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.scaling import scalings
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]

# Step of the derivative by the logarithm of the added mass.
_STEP = 1e-6
# Sine of the angle below which two columns of a Jacobian are one.
_SAME = 1e-6
# A parameter owes its value to the mass where its sd without it is this much larger.
_OWES = 3.0
# Ratios this close to a whole number are one, written with few digits.
_WHOLE = 1e-3


def gravity_like(chain: Joint) -> int:
    """Count how often a turn the motor's torque ripples at the pace of gravity; 0 if it cannot.

    Once, where the motor turns as often as the joint; twice, where the joint turns twice as often.
    Behind a gear that makes it slower, no ripple of the motor is slow enough.
    """
    if chain.motor_motion != "rotary" or chain.load.motion != "rotary":
        return 0
    times = round(1.0 / chain.ratio)
    return times if abs(times * chain.ratio - 1.0) < _WHOLE else 0


@dataclass(frozen=True)
class UnknownMass:
    """What would be left if the added mass were not known."""

    # what could then be multiplied by powers of one factor together with the mass, and no torque
    # would change; empty where torque tells the mass itself
    exponents_without: dict[str, float]
    # parameters whose sd from the data would be infinite, or more than three times what it is
    determines: tuple[str, ...]

    def meaning(self, *, all_told: bool) -> Statement | None:
        """Say what rests on the mass; ``all_told`` where nothing is open with it."""
        if not self.determines:
            return stated("known_mass", "not_needed") if all_told else None
        powers = self.exponents_without
        scaled = tuple(powers) if all(abs(x - 1.0) < 1e-5 for x in powers.values()) else ()
        return stated("known_mass", "determines", determines=self.determines, scaled=scaled)


@dataclass(frozen=True)
class SpeedTerm:
    """What a torque proportional to speed, such as a back-EMF's, cannot be told from."""

    recordings: tuple[str, ...]  # those whose torque comes from a voltage
    nominal: float  # kt²/R as given, the largest: what the speed takes off, at the motor
    unit: str  # of that
    # parameters whose effect, each's or all of them together, has the same shape exactly
    same_as_back_emf: tuple[str, ...]
    explained: float  # share of the term's square that some change of parameters makes up for

    def meaning(self, among: int) -> Statement:
        """Say what is confounded; ``among`` recordings in all."""
        return stated("voltage", "back_emf", among=among, **vars(self))


def gravity_ripple(target: Target) -> Statement | None:
    """Say that gravity's first moment takes a ripple up.

    ``None`` where nothing that the motor does has the pace of gravity, or the moment is known.
    """
    chain = target.likelihood.chain
    free = {p.quantity: p.name for p in chain.parameters if p.name in target.free}
    times, name = gravity_like(chain), free.get("first_moment")
    if not times or name is None:
        return None
    told = {"per_torque": chain.ratio / abs(chain.load.gravity), "name": name, "times": times}
    return stated("ripple", "gravity", **told, angle_free="gravity_angle" in free)


def _heavier(o: Observation, factor: float) -> Observation:
    return replace(o, inputs=replace(o.inputs, added_mass=factor * o.inputs.added_mass))


def unknown_mass(target: Target, parameters: Array, local: LocalInformation) -> UnknownMass | None:
    """Look at the torque as if the added masses were known but for one common factor.

    At the estimate ``(d,)``, noise scales last; ``None`` where no recording has a mass.
    """
    chain, observations = target.likelihood.chain, target.likelihood.observations
    if not any(o.inputs.added_mass for o in observations):
        return None
    jacobian, noise = _torque_jacobian(target, parameters)
    values = target.chain_values(parameters[None])

    def by_mass(o: Observation) -> Array:
        beside = (_heavier(o, 1.0 + _STEP), _heavier(o, 1.0 - _STEP))
        more, less = (filtered_torque(chain, one, values)[0] for one in beside)
        return np.asarray((more - less) / (2.0 * _STEP))

    column = [one.whitened(by_mass(o), o) for o, one in zip(observations, noise, strict=True)]
    whole = np.column_stack([jacobian, np.concatenate(column)])
    k = len(target.free)
    # what theory says is taken out: where the direction of power changes inside a step, a
    # derivative is off by enough to make a determined direction of a null one
    open_ = local.null_rows[: local.from_theory]
    # scalings of load and mass together; a known parameter takes them away, as it does the load's
    columns = [chain.names.index(name) for name in target.free]
    with_mass = [
        np.append(s.tangent(values[0])[columns] / local.units, 1.0)
        for s in scalings(chain)
        if set(s.names) <= set(target.free)
    ]
    known_null = np.array([*(np.append(row, 0.0) for row in open_), *with_mass])
    found = directions(whole, np.ones(k + 1), known_null=known_null.reshape(-1, k + 1))
    known = directions(jacobian, np.ones(k), known_null=open_)
    exponents: dict[str, float] = {}
    for row in found.rows[found.null]:
        if abs(row[k]) > 1e-6:
            scaled = zip(local.labels, row / row[k], strict=False)
            exponents = {label: float(round(x, 9)) for label, x in scaled if abs(x) > 1e-5}
    owed = []
    for name, one in zip(target.free, np.eye(k + 1)[:k], strict=True):
        before, after = known.solve(one[:k]), found.solve(one)
        if before is None:
            continue  # not even the known mass tells
        if after is None or after @ one > _OWES**2 * (before @ one[:k]):
            owed.append(name)
    return UnknownMass(exponents, tuple(owed))


def speed_term(
    target: Target, parameters: Array, recordings: Sequence[Measurement]
) -> SpeedTerm | None:
    """Compare a torque proportional to speed with what the parameters can do.

    The torque computed from a voltage is ``kt V/R - kt² (motor speed)/R``; an error of ``kt²/R``
    adds a term proportional to speed. At the estimate ``(d,)``, noise scales last; ``None`` where
    no recording's torque comes from a voltage.
    """
    observations = target.likelihood.observations
    nominal = {r.name: r.nominal_back_emf for r in recordings if r.nominal_back_emf}
    told = tuple(o.name for o in observations if o.name in nominal)
    if not told:
        return None
    jacobian, noise = _torque_jacobian(target, parameters)
    term = np.concatenate(
        [
            one.whitened(o.filter.apply(o.qd) * (o.name in told), o)
            for o, one in zip(observations, noise, strict=True)
        ]
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


def _torque_jacobian(target: Target, parameters: Array) -> tuple[Array, list[TorqueNoise]]:
    """Jacobian of the torque over its noise, whatever the likelihood is of, and that noise."""
    observations, at = target.likelihood.observations, units_of(target, parameters)
    values = target.chain_values(parameters[None])[0]
    noise = [torque_noise(target, parameters, r) for r in range(len(observations))]
    blocks = [
        scaled_jacobian(target, o, values, at, one)
        for o, one in zip(observations, noise, strict=True)
    ]
    return np.concatenate(blocks), noise
