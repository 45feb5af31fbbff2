"""The totals at the motor: linear least squares, section 4.1, eqs. (10) and (11).

With them, starts of a search and the typical sizes that default priors are scaled by.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.estimates.information import Information
from bayesfric.estimates.point_estimate import Estimate, EstimatedValue
from bayesfric.estimates.torque import (
    OPEN,
    column_names,
    columns,
    filled_columns,
    minimum_norm,
    places,
)
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.own_term import CarriedTerm, along
from bayesfric.mechanism.quantities import SHAPES, TOTALS, Parameter, TypicalSizes, effort_words
from bayesfric.recordings.arrays import Array, rms
from bayesfric.recordings.signals import Signals

# Quantile that is taken for the largest: a glitch must not set a scale.
_NEARLY_ALL = 0.999


def least_squares(
    joint: Joint,
    observations: Sequence[Signals],
    projection: TotalsProjection | None = None,
) -> Estimate:
    """Estimate the motor-side totals of eq. (11).

    The gearbox is taken with one mean transfer coefficient ``alpha_m`` (eq. 10), so the torque is
    linear in the totals. A total that is collinear with others has an infinite standard deviation.
    A known added mass is part of the totals unless recordings with different masses, or a load
    without parameters, identify it.

    Parameters
    ----------
    joint, observations
        The mechanism and its recordings, prepared.
    projection
        Theirs, if it is computed already.

    Returns
    -------
    Estimate
        Of totals alone, such as ``J_t = Jm + Jc/(alpha_m N²)``; ``point`` is empty.

    Raises
    ------
    BadInput
        If there are not more outputs than totals, or no regressor differs from zero.

    Notes
    -----
    ``torque = J_t qdd_m + f_t qd_m + C_t sign(qd_m) + dC_t + ml g/(alpha_m N) sin(q)`` and further
    terms of the mechanism. Regressors and torque have passed the same parallel filter. What shapes
    a term, such as an exponent, is held where a search for it would start; see ``assumption``.
    """
    projection = projection or TotalsProjection(joint, observations)
    names, regressors = projection.names, projection.regressors
    torque = np.concatenate([o.measured for o in observations])
    if torque.size <= len(names):
        raise BadInput(
            ", ".join(o.name for o in observations),
            f"{torque.size} outputs cannot determine {len(names)} totals",
            "use a longer recording, or decimate less",
        )
    if not names or not regressors.any():
        raise BadInput(
            ", ".join(o.name for o in observations),
            "this motion has no effect on this model",
            "use a recording that moves, or a mechanism with inertia or friction",
        )
    solution = projection.solve(torque)
    residual = torque - regressors @ solution
    information = Information(
        regressors,
        residual,
        1.0 / projection.scale,
        places=places(observations),
        tolerance=OPEN,
    )
    values = []
    for i, name in enumerate(names):
        # torques that balance without the motor determine only ratios
        sds = information.sds(np.eye(len(names))[i]) if torque.any() else (np.inf, np.inf)
        description = projection.labels[i], *projection.describe(name)
        values.append(EstimatedValue(*description, float(solution[i]), *sds))
    assumption = "sd: uncorrelated residuals of equal variance; sd_robust: correlated ones (HAC)"
    if "added_load" not in names and any(o.inputs.known_load for o in observations):
        assumption += "; the known load is part of the totals"
    if shapes := [p for p in joint.parameters if p.quantity in SHAPES]:
        fixed = ", ".join(f"{p.name} = {p.row.start:g}" for p in shapes)
        assumption += f"; assumed known: {fixed}"
    return Estimate(
        method="least-squares",
        values=tuple(values),
        residual_rms=rms(residual),
        n_outputs=torque.size,
        assumption=assumption,
        residual_unit=joint.torque_unit,
    )


class TotalsProjection:
    """The linear map from torques to the totals of eq. (11)."""

    def __init__(self, joint: Joint, observations: Sequence[Signals]) -> None:
        self._chain = joint
        # of the k totals, such as inertia; (n_outputs, k), filtered like the measured torque
        self.names, self.regressors = totals_regressors(joint, observations)
        # in results: total.inertia, or motor.inertia where that is all of it
        self.labels = [total_label(joint, name) for name in self.names]
        # (k,) norm of each regressor, and which totals are collinear with others
        self.scale, self.open, self._solution, _ = minimum_norm(self.regressors)

    def solve(self, torque: Array) -> Array:
        """Give the totals ``(k,)`` of filtered torques ``(n_outputs,)``, or of columns of them."""
        return np.asarray(self._solution @ torque)

    def aliases(self) -> dict[str, str]:
        """Give other names of labels: ``total.<name>``, and the owner's where it is the only one.

        So ``motor.viscous`` stays valid where the motor's viscous friction differs by direction.
        """
        labels: dict[str, str] = {}
        for name, label in zip(self.names, self.labels, strict=True):
            parts = (
                p for p in self._chain.parameters if name in dict(_regressors_of(self._chain, p))
            )
            owners = {p.owner for p in parts}
            names = [f"total.{name}", *(f"{owner}.{name}" for owner in owners if len(owners) == 1)]
            labels |= {alias: label for alias in names if alias != label}
        return labels

    def describe(self, name: str) -> tuple[str, str, str]:
        """Give unit, LaTeX symbol and meaning of a total."""
        joint = self._chain
        for p in joint.parameters:
            if _has_regressor(joint, p) and p.name == name:
                return p.unit, p.symbol, p.meaning
        kind, _, recording = name.partition(".")
        total, motion = TOTALS[kind], joint.motor_motion
        unit, meaning = total.unit(motion), effort_words(total.meaning, motion)
        if not recording:
            turned = any(p.circular for p in joint.parameters) and total.turned
            return unit, turned or total.symbol, meaning
        symbol = rf"\Delta C_{{t,{joint.own_offsets.index(recording) + 1}}}"
        return unit, symbol, f"{meaning}, {recording}"


def total_label(joint: Joint, name: str) -> str:
    """Name a total: that of the parameter that makes it up alone, else ``total.<name>``."""
    if any(_has_regressor(joint, p) and p.name == name for p in joint.parameters):
        owner, places = name.partition(".")[0], [e.name for e in joint.elements]
        if owner in ("drive", "target"):  # added to the torque as measured
            return name
        before = joint.elements[: places.index(owner)] if owner in places else joint.elements
        scaled = joint.gain or joint.kp or any(e.load_loss != "none" for e in before)
        return f"total.{name}" if scaled else name
    kind = name.partition(".")[0]
    owners = [p for p in joint.parameters if kind in dict(_regressors_of(joint, p))]
    filling = [p for p in owners if p.name == name] if name.startswith("offset.") else owners
    if (
        len(filling) == 1
        and filling[0].owner in (joint.elements[0].name, "")
        and not (joint.gain or joint.kp)
    ):
        sole = filling[0].quantity == kind and (
            name == kind or len(owners) == len(joint.own_offsets)
        )
        if sole:
            return filling[0].name
    return f"total.{name}"


def _has_regressor(joint: Joint, p: Parameter) -> bool:
    """Whether a parameter has a regressor that no total is."""
    return p.name in dict(_regressors_of(joint, p)) and p.quantity != "offset"


def _regressors_of(joint: Joint, p: Parameter) -> tuple[tuple[str, float], ...]:
    """Regressors of eq. (11) of a parameter, and its torque in each for a value of one.

    A mean transfer coefficient replaces load-dependent friction; what shapes or scales other terms
    has no regressor.
    """
    if p.circular:
        return (("gravity_cosine", 0.0),)
    return tuple(
        (TOTALS[k].regressor or k if k in TOTALS else k, c) for k, c in filled_columns(joint, p)
    )


def starting_values(joint: Joint, totals: Estimate, mu: float, share: float) -> dict[str, float]:
    """Split the totals of :func:`least_squares` into parameters, as a place to start from."""
    labels = {name: total_label(joint, name) for name in column_names(joint)}
    total = {name: totals[label].value for name, label in labels.items() if label in totals}
    gain = total.get("added_load", 1.0)
    owners: dict[str, set[str]] = {}
    for p in joint.parameters:
        for kind, _ in _regressors_of(joint, p):
            owners.setdefault(kind, set()).add(p.owner)
    values: dict[str, float] = {}
    sign = np.sign(joint.load.gravity)
    for p in joint.parameters:
        if p.row.role == "loss":
            values[p.name] = mu
        elif p.quantity == "first_moment":
            amount = float(np.hypot(total.get("gravity", 0.0), total.get("gravity_cosine", 0.0)))
            values[p.name] = max(amount, 1e-6) * joint.ratio / abs(joint.load.gravity)
        elif p.circular:
            cosine, sine = total.get("gravity_cosine", 0.0), total.get("gravity", 0.0)
            values[p.name] = (
                float(np.arctan2(sign * cosine, sign * sine)) if sine or cosine else 0.0
            )
        elif p.quantity in ("gain", "kp"):
            values[p.name] = (joint.kp or 1.0) * (1.0 / gain if gain > 0 else 1.0)
        elif p.quantity == "offset":
            values[p.name] = total.get(p.name, 0.0)
        elif p.row.role == "own":
            kind = _regressors_of(joint, p)[0][0]
            part = _part(p.owner, owners[kind], joint.elements[0].name, share)
            amount = total.get(kind, 0.0)
            if p.lower == 0.0:
                amount = max(amount, 1e-3 * abs(totals.residual_rms) + 1e-12)
            # torque of the regressor for a value of one, both directions together
            unit_torque = sum(
                abs(c) for q in joint.parameters if q.owner == p.owner
                for k, c in _regressors_of(joint, q) if k == kind
            )  # fmt: skip
            values[p.name] = part * amount / unit_torque
        else:
            if p.row.start is None:
                raise KeyError(
                    f"{p.name}: a search for {p.quantity!r} does not know where to start"
                )
            values[p.name] = p.row.start
    return values


def _part(owner: str, peers: set[str], motor: str, share: float) -> float:
    """Share of one owner in a total: the motor has ``share``, its peers divide the rest."""
    others = peers - {motor}
    if not others:
        return 1.0
    if motor not in peers:
        return 1.0 / len(others)
    return share if owner == motor else (1.0 - share) / len(others)


def totals_regressors(joint: Joint, observations: Sequence[Signals]) -> tuple[list[str], Array]:
    """Name the k totals of eq. (11), and give their regressors ``(n_outputs, k)``, filtered."""
    kinds = {kind for p in joint.parameters for kind, _ in _regressors_of(joint, p)}
    loads = {o.inputs.load(joint.load.motion) for o in observations}
    loaded = any(o.inputs.load_torque is not None for o in observations)
    if loaded or (loads != {(0.0, 0.0)} and ("gravity" not in kinds or len(loads) > 1)):
        kinds.add("added_load")
    if "offset" in kinds:
        kinds |= set(joint.offset_names)
    names = [name for name in column_names(joint) if name in kinds]
    blocks = [o.filter.apply(columns(joint, o, names)).T for o in observations if names]
    return names, np.concatenate(blocks) if blocks else np.empty((0, 0))


def typical_sizes(
    joint: Joint, observations: Sequence[Signals], known: Mapping[str, float]
) -> TypicalSizes:
    """Take the scales from all recordings together, with the ``known`` parameters.

    Where the motor is off, the known terms' torque is in place of the motor's.
    """
    torque = np.concatenate([o.measured for o in observations])
    if not torque.any():
        torque = known_torque(joint, observations, known)
    # only where outputs are: an excluded glitch must not set a scale
    speed = np.concatenate([o.qd[o.filter.centres] for o in observations])
    acceleration = np.concatenate([o.acceleration for o in observations])
    duration = sum(o.period * o.measured.size for o in observations)
    lean = max(float(np.abs(np.sin(o.q[o.filter.centres])).max()) for o in observations)
    return TypicalSizes(
        torque=float(np.quantile(np.abs(torque), _NEARLY_ALL)),
        # from an unknown zero the angle may be any
        lean=1.0 if any(p.circular for p in joint.parameters) else lean or 1.0,
        exchanged=_surely_taken(joint, observations),
        speed=rms(speed),
        # a motion changes its speed at least once in all recordings
        acceleration=max(rms(acceleration), rms(speed) / duration),
        position=max(float(np.ptp(o.q[o.filter.centres])) for o in observations),
        duration=max(float(np.ptp(o.stamps)) for o in observations),
        position_step=min(o.position_step for o in observations),
        period=max(float(np.median(np.diff(o.stamps))) for o in observations),
        columns={joint.names[c.index]: _rms_of(c, observations) for c in joint.carried},
    )


def known_torque(
    joint: Joint, observations: Sequence[Signals], known: Mapping[str, float]
) -> Array:
    """Compute the torque ``(n_outputs,)`` of known parameters, masses and load torques alone."""
    undelayed = replace(joint, delay=False, own_offsets=())
    values = np.array([known.get(name, 0.0) for name in undelayed.names])
    return np.concatenate([
        o.filter.apply(
            inverse_torque(undelayed, values, o.q, o.qd, o.qdd, inputs=o.inputs, time=o.stamps)
        )
        for o in observations
    ])  # fmt: skip


def sizes_at(joint: Joint, owner: str, scales: TypicalSizes) -> TypicalSizes:
    """Give the sizes at the input of an element, or of ``load``; losses on the way are left out."""
    to_joint = joint.reaches[owner]
    return replace(
        scales,
        torque=scales.torque * (joint.ratio / to_joint),
        speed=scales.speed * to_joint,
        acceleration=scales.acceleration * to_joint,
        gravity=joint.load.gravity,
    )


def _surely_taken(joint: Joint, observations: Sequence[Signals]) -> float:
    """Give the largest torque of a single term by least squares, less two standard deviations."""
    projection = TotalsProjection(joint, observations)
    with suppress(BadInput):
        estimate = least_squares(joint, observations, projection)
        sizes = np.quantile(np.abs(projection.regressors), _NEARLY_ALL, axis=0)
        determined = np.array([v.determined for v in estimate.values])
        sds = np.array([max(v.sd, np.nan_to_num(v.sd_robust)) for v in estimate.values])
        lowest = np.abs([v.value for v in estimate.values]) - 2.0 * sds
        return float(np.max(lowest[determined] * sizes[determined], initial=0.0))
    return 0.0


def _rms_of(carried: CarriedTerm, observations: Sequence[Signals]) -> float:
    """Root mean square torque of a custom or signal term, for a value of one."""
    at = [o.filter.centres for o in observations]
    arguments = [
        (o.q[k], o.qd[k], o.stamps[k], o.inputs) for k, o in zip(at, observations, strict=True)
    ]
    return rms(np.concatenate([along(carried.row, carried.reach, *a) for a in arguments]))
