"""Linear least squares on the motor side, section 4.1, eqs. (10) and (11)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput
from bayesfric.estimates.estimate import Estimate, EstimatedValue
from bayesfric.estimates.information import Information
from bayesfric.estimates.torque import places
from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.inverse import added_load
from bayesfric.mechanism.parameter import effort_words, entry_of
from bayesfric.recordings.observation import Observation

# Relative size below which a singular value of the regressors is rounding.
_OPEN = 1e-9

_UNITS = {
    # name: rotary unit, linear unit, symbol, meaning
    "inertia": ("kg m²", "kg", "J_t", "inertia seen by the motor"),
    "viscous": ("N m s", "N s/m", "f_t", "viscous loss seen by the motor"),
    "quadratic": ("N m s²", "N s²/m²", "f_{3,t}", "quadratic loss seen by the motor"),
    "coulomb": ("N m", "N", "C_t", "constant loss seen by the motor"),
    "offset": ("N m", "N", r"\Delta C_t", "constant torque, half the difference of the losses"),
    "gravity": ("N m", "N", r"ml\,g/(\alpha_m N)", "gravity torque seen by the motor, sine part"),
    "gravity_cosine": ("N m", "N", r"ml\,g\sin q_g/(\alpha_m N)", "gravity torque, cosine part"),
    "added_load": ("", "", r"1/\alpha_m", "motor torque per torque of the known added load"),
}

# Totals that each quantity shows in; a mean transfer coefficient stands for load losses, and
# what varies a loss or scales everything has no total of its own.
_TOTALS: dict[str, tuple[str, ...]] = {
    "inertia": ("inertia",),
    "viscous": ("viscous",),
    "quadratic": ("quadratic",),
    "coulomb": ("coulomb",),
    "coulomb_positive": ("coulomb", "offset"),
    "coulomb_negative": ("coulomb", "offset"),
    "first_moment": ("gravity",),
    "gravity_angle": ("gravity_cosine",),
    "offset": ("offset",),
    "stribeck_ratio": (),
    "stribeck_velocity": (),
    "load": (),
    "load_drive": (),
    "load_back": (),
    "gain": (),
}


def least_squares(chain: Chain, observations: Sequence[Observation]) -> Estimate:
    """Estimate the motor-side totals of eq. (11).

    The gearbox is taken with one mean transfer coefficient ``alpha_m`` (eq. 10),
    so the torque is linear in the totals. Regressors and torque have passed the
    same parallel filter.

    Parameters
    ----------
    chain
        Says which totals there are.
    observations
        One or more prepared recordings.

    Returns
    -------
    Estimate
        ``total.inertia`` (Jt), ``total.viscous`` (ft), ``total.coulomb`` (Ct),
        ``total.offset`` (dCt), ``total.gravity`` (ml g/(alpha_m N)) and, where the
        chain or the recordings have them, the other terms.

    Raises
    ------
    BadInput
        If there are fewer outputs than totals, or nothing of the model shows.

    Notes
    -----
    A total that the motion cannot tell from others gets an infinite standard
    deviation. A known added mass is part of the totals unless recordings with
    different masses, or a load without parameters of its own, set it apart.
    """
    projection = TotalsProjection(chain, observations)
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
        tolerance=_OPEN,
    )
    values = []
    for i, name in enumerate(names):
        unit, symbol, meaning = projection.describe(name)
        sd, robust = information.sds(np.eye(len(names))[i])
        value = float(solution[i])
        label = projection.labels[i]
        values.append(EstimatedValue(label, unit, symbol, meaning, value, sd, robust))
    assumption = "sd: uncorrelated residuals of equal variance; sd_robust: correlated ones (HAC)"
    if "added_load" not in names and any(o.added_mass for o in observations):
        assumption += "; the known added mass is part of the totals"
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

    Parameters
    ----------
    chain
        Says which totals there are.
    observations
        One or more prepared recordings.

    Attributes
    ----------
    names
        Of the totals, such as ``inertia``.
    labels
        The same as results show them: ``total.inertia``, or ``motor.inertia`` where that
        parameter is all there is to the total.
    regressors
        ``(n_outputs, n_totals)``, filtered like the measured torque.
    scale
        ``(n_totals,)`` norm of each regressor.
    open
        ``(n_totals,)`` which totals the motion cannot tell from others.
    """

    def __init__(self, chain: Chain, observations: Sequence[Observation]) -> None:
        self.names, self.regressors = _regressors(chain, observations)
        self.labels = [total_label(chain, name) for name in self.names]
        self._chain = chain
        scale = np.linalg.norm(self.regressors, axis=0) if self.names else np.empty(0)
        self.scale = np.where(scale == 0.0, 1.0, scale)
        self.open = np.zeros(len(self.names), dtype=np.bool_)
        if not self.names:
            return
        left, singular, right = np.linalg.svd(self.regressors / self.scale, full_matrices=False)
        told = singular > _OPEN * singular[0]
        # the shortest solution where the motion leaves some totals open
        self._solution = (right[told].T / singular[told]) @ left.T[told] / self.scale[:, None]
        self.open = np.asarray((right[~told] ** 2).sum(axis=0) > 1e-8)

    def solve(self, torque: NDArray[np.float64]) -> NDArray[np.float64]:
        """Totals of filtered torques, ``(n_outputs,)`` or ``(n_outputs, k)``."""
        return np.asarray(self._solution @ torque)

    def describe(self, name: str) -> tuple[str, str, str]:
        """Give unit, LaTeX symbol and meaning of a total."""
        kind, _, recording = name.partition(".")
        rotary, linear, symbol, meaning = _UNITS[kind]
        motion = self._chain.motor_motion
        unit, meaning = rotary if motion == "rotary" else linear, effort_words(meaning, motion)
        if not recording:
            return unit, symbol, meaning
        symbol = rf"\Delta C_{{t,{self._chain.own_offsets.index(recording) + 1}}}"
        return unit, symbol, f"{meaning}, {recording}"


def total_label(chain: Chain, name: str) -> str:
    """Name a total: that of the parameter that makes it up alone, else ``total.<name>``."""
    kind = name.partition(".")[0]
    owners = [p.name for p in chain.parameters if p.quantity.startswith(kind)]
    if kind == "offset" and chain.own_offsets:
        owners = [name]
    motor = chain.elements[0].name
    alone = owners in ([f"{motor}.{name}"], [name]) and not chain.gain
    asymmetric = any(p.quantity == "coulomb_positive" for p in chain.parameters)
    if not alone or (kind == "offset" and asymmetric):
        return f"total.{name}"
    return owners[0]


def starting_values(chain: Chain, totals: Estimate, mu: float, share: float) -> dict[str, float]:
    """Split motor-side totals into parameters, as a place to start a search from.

    Parameters
    ----------
    chain
        The mechanism.
    totals
        From :func:`least_squares`.
    mu
        Load loss to assume wherever there is one.
    share
        Share of each total that the motor gets; the other elements and the load
        divide the rest.
    """
    total = {name: totals[label].value for name, label in _labels(chain).items() if label in totals}
    gain = total.get("added_load", 1.0)
    owners: dict[str, list[str]] = {}
    for p in chain.parameters:
        kind = p.quantity.removesuffix("_positive").removesuffix("_negative")
        owners.setdefault(kind, []).append(p.name)
    to_motor = {"": 1.0, "drive": 1.0, "load": chain.ratio}
    before = 1.0
    for element in chain.elements:
        to_motor[element.name] = before
        before *= element.ratio
    powers = {"inertia": 2, "viscous": 2, "quadratic": 3, "coulomb": 1, "first_moment": 1}

    values: dict[str, float] = {}
    for p in chain.parameters:
        owner = p.name.rpartition(".")[0]
        kind = p.quantity.removesuffix("_positive").removesuffix("_negative")
        if kind in ("inertia", "viscous", "quadratic", "coulomb"):
            peers = {name.rpartition(".")[0] for name in owners[kind]}
            part = _part(owner, peers, chain.elements[0].name, share)
            seen = max(total.get(kind, 0.0), 1e-3 * abs(totals.residual_rms) + 1e-12)
            values[p.name] = part * seen * to_motor[owner] ** powers[kind]
        elif kind == "first_moment":
            seen = float(np.hypot(total.get("gravity", 0.0), total.get("gravity_cosine", 0.0)))
            values[p.name] = max(seen, 1e-6) * chain.ratio / abs(chain.load.gravity)
        elif kind == "gravity_angle":
            way = np.sign(chain.load.gravity)
            values[p.name] = float(
                np.arctan2(way * total["gravity_cosine"], way * total["gravity"])
                if "gravity" in total
                else 0.0
            )
        elif kind in ("load", "load_drive", "load_back"):
            values[p.name] = mu
        elif kind == "offset":
            values[p.name] = total.get(p.name, 0.0)
        elif kind == "gain":
            values[p.name] = 1.0 / gain if gain > 0 else 1.0
        else:
            places = {"stribeck_ratio": 0.3, "stribeck_velocity": p.default}
            values[p.name] = entry_of(places, kind, "the search's start")
    return values


def _labels(chain: Chain) -> dict[str, str]:
    kinds = [kind for kind in _UNITS if kind != "offset" or not chain.own_offsets]
    kinds += [f"offset.{recording}" for recording in chain.own_offsets]
    return {name: total_label(chain, name) for name in kinds}


def _part(owner: str, peers: set[str], motor: str, share: float) -> float:
    others = peers - {motor}
    if not others:
        return 1.0
    if motor not in peers:
        return 1.0 / len(others)
    return share if owner == motor else (1.0 - share) / len(others)


def _regressors(
    chain: Chain, observations: Sequence[Observation]
) -> tuple[list[str], NDArray[np.float64]]:
    wanted = {
        kind for p in chain.parameters for kind in entry_of(_TOTALS, p.quantity, "least squares")
    }
    n = chain.ratio
    loads = {added_load(chain, o.added_mass, o.radius) for o in observations}
    known = loads != {(0.0, 0.0)} and ("gravity" not in wanted or len(loads) > 1)
    blocks: list[NDArray[np.float64]] = []
    names: list[str] = []
    for o in observations:
        sign = np.sign(o.qd)
        columns: dict[str, NDArray[np.float64]] = {}
        if "inertia" in wanted:
            columns["inertia"] = n * o.qdd
        if "viscous" in wanted:
            columns["viscous"] = n * o.qd
        if "quadratic" in wanted:
            columns["quadratic"] = n**2 * o.qd * np.abs(o.qd)
        if "coulomb" in wanted:
            columns["coulomb"] = sign
        for recording in chain.own_offsets:
            columns[f"offset.{recording}"] = np.full_like(sign, recording == o.name)
        if not chain.own_offsets and "offset" in wanted:
            columns["offset"] = np.ones_like(sign)
        if "gravity" in wanted:
            columns["gravity"] = np.sin(o.q)
        if "gravity_cosine" in wanted:
            columns["gravity_cosine"] = np.cos(o.q)
        if known:
            inertia, moment = added_load(chain, o.added_mass, o.radius)
            columns["added_load"] = (
                inertia * o.qdd + chain.load.gravity * moment * np.sin(o.q)
            ) / n
        names = list(columns)
        if columns:
            blocks.append(o.filter.apply(np.stack(list(columns.values()))).T)
    return names, np.concatenate(blocks) if blocks else np.empty((0, 0))
