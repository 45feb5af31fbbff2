"""Which totals does the motor see: linear least squares, section 4.1, eqs. (10) and (11)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.estimates.information import Information
from bayesfric.estimates.point_estimate import Estimate, EstimatedValue
from bayesfric.estimates.torque import places
from bayesfric.estimates.torque_form import OPEN, columns, filled, in_order, shortest
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import Parameter, effort_words
from bayesfric.mechanism.quantities import SHAPES, TOTALS
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation


def least_squares(
    chain: Joint,
    observations: Sequence[Observation],
    projection: TotalsProjection | None = None,
) -> Estimate:
    """Estimate the motor-side totals of eq. (11).

    The gearbox is taken with one mean transfer coefficient ``alpha_m`` (eq. 10), so the torque is
    linear in the totals. A total that the motion cannot tell from others gets an infinite standard
    deviation. A known added mass is part of the totals unless recordings with different masses, or
    a load without parameters of its own, set it apart.

    Parameters
    ----------
    chain, observations
        The mechanism and its recordings, prepared.
    projection
        Theirs, where it is there already.

    Returns
    -------
    Estimate
        Of totals alone, such as ``J_t = Jm + Jc/(alpha_m N²)``; ``point`` is empty.

    Raises
    ------
    BadInput
        If there are not more outputs than totals, or nothing of the model shows.

    Notes
    -----
    ``torque = J_t qdd_m + f_t qd_m + C_t sign(qd_m) + dC_t + ml g/(alpha_m N) sin(q)`` and further
    terms of the mechanism. Regressors and torque have passed the same parallel filter. What shapes
    a term, such as an exponent, is held where a search for it would start; see ``assumption``.
    """
    projection = projection or TotalsProjection(chain, observations)
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
            "nothing in this model shows in this motion",
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
        sds = information.sds(np.eye(len(names))[i])
        stated = projection.labels[i], *projection.describe(name)
        values.append(EstimatedValue(*stated, float(solution[i]), *sds))
    assumption = "sd: uncorrelated residuals of equal variance; sd_robust: correlated ones (HAC)"
    if "added_load" not in names and any(o.inputs.known_load for o in observations):
        assumption += "; the known load is part of the totals"
    if shapes := [p for p in chain.parameters if p.quantity in SHAPES]:
        held = ", ".join(f"{p.name} = {p.row.start:g}" for p in shapes)
        assumption += f"; taken for known: {held}"
    return Estimate(
        method="least-squares",
        values=tuple(values),
        residual_rms=float(np.sqrt(np.mean(residual**2))),
        n_outputs=torque.size,
        assumption=assumption,
        residual_unit="N m" if chain.motor_motion == "rotary" else "N",
    )


class TotalsProjection:
    """The linear map from torques to the totals of eq. (11).

    @@ATTR chain, observations: The mechanism and its recordings, prepared. | names: Of the k
    totals, such as ``inertia``. | regressors: ``(n_outputs, k)``, filtered like the measured
    torque. | labels: Names as results show them: ``total.inertia``, or ``motor.inertia`` where that
    is all of it. | scale: ``(k,)`` norm of each regressor. | open: ``(k,)`` of bool: which totals
    the motion cannot tell from others.
    """

    def __init__(self, chain: Joint, observations: Sequence[Observation]) -> None:
        self._chain, self._observations = chain, observations
        # of the totals, such as inertia; (n_outputs, n_totals), filtered like the measured torque
        self.names, self.regressors = totals_regressors(chain, observations)
        # the same as results show them: total.inertia, or motor.inertia where that is all of it
        self.labels = [total_label(chain, name) for name in self.names]
        # norm of each regressor, and which totals the motion cannot tell from others
        self.scale, self.open, self._solution, _ = shortest(self.regressors)

    def solve(self, torque: Array) -> Array:
        """Totals of filtered torques. Shapes: torque (n_outputs,); returns (k,)."""
        return np.asarray(self._solution @ torque)

    def of_samples(self) -> list[Array]:
        """Give the same map for unfiltered torque. Shapes: returns (k, N)."""
        ends = np.cumsum([o.filter.n_outputs for o in self._observations])[:-1]
        parts = np.split(self._solution, ends, axis=1)
        pairs = zip(self._observations, parts, strict=True)
        return [o.filter.reached(part) for o, part in pairs]

    def aliases(self) -> dict[str, str]:
        """Give labels by other names: ``total.<name>``, and the owner's where it has all of it.

        So ``motor.viscous`` stays one where the motor's viscous friction differs by direction.
        """
        found: dict[str, str] = {}
        for name, label in zip(self.names, self.labels, strict=True):
            parts = (p for p in self._chain.parameters if name in dict(_regressed(self._chain, p)))
            owners = {p.owner for p in parts}
            names = [f"total.{name}", *(f"{one}.{name}" for one in owners if len(owners) == 1)]
            found |= {other: label for other in names if other != label}
        return found

    def describe(self, name: str) -> tuple[str, str, str]:
        """Give unit, LaTeX symbol and meaning of a total."""
        chain = self._chain
        for p in chain.parameters:
            if _has_own(chain, p) and p.name == name:
                return p.unit, p.symbol, p.meaning
        kind, _, recording = name.partition(".")
        total, motion = TOTALS[kind], chain.motor_motion
        unit, meaning = total.unit(motion), effort_words(total.meaning, motion)
        if not recording:
            turned = any(p.circular for p in chain.parameters) and total.turned
            return unit, turned or total.symbol, meaning
        symbol = rf"\Delta C_{{t,{chain.own_offsets.index(recording) + 1}}}"
        return unit, symbol, f"{meaning}, {recording}"


def total_label(chain: Joint, name: str) -> str:
    """Name a total: that of the parameter that makes it up alone, else ``total.<name>``."""
    if any(_has_own(chain, p) and p.name == name for p in chain.parameters):
        owner, places = name.partition(".")[0], [e.name for e in chain.elements]
        if owner in ("drive", "target"):  # it is of the torque as measured
            return name
        before = chain.elements[: places.index(owner)] if owner in places else chain.elements
        scaled = chain.gain or any(e.load_loss != "none" for e in before)
        return f"total.{name}" if scaled else name
    kind = name.partition(".")[0]
    owners = [p for p in chain.parameters if kind in dict(_regressed(chain, p))]
    own = [p for p in owners if p.name == name] if name.startswith("offset.") else owners
    if len(own) == 1 and own[0].owner in (chain.elements[0].name, "") and not chain.gain:
        told = own[0].quantity == kind and (name == kind or len(owners) == len(chain.own_offsets))
        if told:
            return own[0].name
    return f"total.{name}"


def _has_own(chain: Joint, p: Parameter) -> bool:
    """Whether a parameter has a regressor that no total is."""
    return p.name in dict(_regressed(chain, p)) and p.quantity != "offset"


def _regressed(chain: Joint, p: Parameter) -> tuple[tuple[str, float], ...]:
    """Regressors of eq. (11) that a parameter shows in, and its torque there for a value of one.

    A mean transfer coefficient stands for load-dependent friction; what shapes other terms, or
    scales everything, has no regressor of its own.
    """
    if p.circular:
        return (("gravity_cosine", 0.0),)
    return tuple((TOTALS[k].regressor or k if k in TOTALS else k, c) for k, c in filled(chain, p))


def starting_values(chain: Joint, totals: Estimate, mu: float, share: float) -> dict[str, float]:
    """Split the totals of :func:`least_squares` into parameters, as a place to start from."""
    labels = {name: total_label(chain, name) for name in in_order(chain)}
    total = {name: totals[label].value for name, label in labels.items() if label in totals}
    gain = total.get("added_load", 1.0)
    owners: dict[str, set[str]] = {}
    for p in chain.parameters:
        for kind, _ in _regressed(chain, p):
            owners.setdefault(kind, set()).add(p.owner)
    values: dict[str, float] = {}
    way = np.sign(chain.load.gravity)
    for p in chain.parameters:
        if p.row.role == "loss":
            values[p.name] = mu
        elif p.quantity == "first_moment":
            seen = float(np.hypot(total.get("gravity", 0.0), total.get("gravity_cosine", 0.0)))
            values[p.name] = max(seen, 1e-6) * chain.ratio / abs(chain.load.gravity)
        elif p.circular:
            cosine, sine = total.get("gravity_cosine", 0.0), total.get("gravity", 0.0)
            values[p.name] = float(np.arctan2(way * cosine, way * sine)) if sine or cosine else 0.0
        elif p.quantity == "gain":
            values[p.name] = 1.0 / gain if gain > 0 else 1.0
        elif p.quantity == "offset":
            values[p.name] = total.get(p.name, 0.0)
        elif p.row.role == "own":
            kind = _regressed(chain, p)[0][0]
            part = _part(p.owner, owners[kind], chain.elements[0].name, share)
            seen = total.get(kind, 0.0)
            if p.lower == 0.0:
                seen = max(seen, 1e-3 * abs(totals.residual_rms) + 1e-12)
            # the whole torque of a regressor for a value of one, both directions together
            whole = sum(
                abs(c) for q in chain.parameters if q.owner == p.owner
                for k, c in _regressed(chain, q) if k == kind
            )  # fmt: skip
            values[p.name] = part * seen / whole
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


def totals_regressors(chain: Joint, observations: Sequence[Observation]) -> tuple[list[str], Array]:
    """Name the totals of eq. (11), and give their regressors.

    Shapes: returns regressors (n_outputs, k).
    """
    found = {kind for p in chain.parameters for kind, _ in _regressed(chain, p)}
    loads = {o.inputs.load(chain.load.motion) for o in observations}
    pushed = any(o.inputs.load_torque is not None for o in observations)
    if pushed or (loads != {(0.0, 0.0)} and ("gravity" not in found or len(loads) > 1)):
        found.add("added_load")
    if "offset" in found:
        found |= set(chain.offset_names)
    names = [name for name in in_order(chain) if name in found]
    blocks = [o.filter.apply(columns(chain, o, names)).T for o in observations if names]
    return names, np.concatenate(blocks) if blocks else np.empty((0, 0))
