"""What all joints say of efforts and bodies together, before any of them is fitted.

By least squares each joint has a Gaussian likelihood of the deviations ``z`` of the bodies, of a
factor ``1 + a`` of its effort, and of the share ``b`` of gravity that its effort lacks. A departure
from a right log and URDF is a wider prior of these. The likeliest is taken, then the likeliest in
addition to it, while the evidence grows by more than the prior odds cost.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bayesfric.arm.arm_log import ArmLog, signals
from bayesfric.arm.arm_options import Vector
from bayesfric.arm.inertial_prior import PER_BODY, Bodies, InertialPrior
from bayesfric.estimates.autoregression import long_run_variance
from bayesfric.fit.model import Model, Result
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import interpolated
from bayesfric.recordings.signals import Signals
from bayesfric.report.summary.doubts import put_doubts

# Prior odds of each kind of departure, of all its joints, bodies or widths together.
_ODDS = 0.25
# Share of a joint's friction (rms) that its law may lack, in so many independent shapes.
_LACKING, _SHAPES = 0.1, 20
# Factors on the standard deviations of all bodies, and of one.
_WIDTHS, _ONE_BODY = (2.0, 4.0, 8.0, 16.0), 10.0


class Departure(NamedTuple):
    """One of kind ``effort``, ``gravity``, ``payload``, ``bodies`` or ``body``."""

    kind: str
    name: str = ""  # of the joint or link; empty for all
    width: float = 1.0  # of the standard deviations of bodies


@dataclass(frozen=True, eq=False)
class CommonFactors:
    """The departures taken, and factors of the torque of the bodies with their sds."""

    departures: tuple[Departure, ...]
    joints: Mapping[str, tuple[float, float]]  # of those whose effort has another scale
    bodies: tuple[float, float]  # of all together, by joints whose effort has none
    scales: Mapping[str, float]  # of efforts
    gravity: Vector
    widths: Array  # (n_deviations,) factors on standard deviations

    @property
    def changes(self) -> bool:
        """Whether the models change."""
        return any(departure.kind != "payload" for departure in self.departures)

    def has(self, kind: str, name: str = "") -> bool:
        """Whether a departure is taken."""
        return any(departure[:2] == (kind, name) for departure in self.departures)

    def doubted(self, name: str, result: Result) -> Result:
        """Doubt the numbers of a joint that the scale of its effort multiplies."""
        if name not in self.joints:
            return result
        summary, scaled = result.summary, ("motor.", "offset")
        of = [x for x in summary.parameters if x.startswith(scaled) and ".load" not in x]
        factor, sd = self.joints[name]
        doubt = {"kind": "effort-scale", "parameters": of, "factor": factor, "sd": sd}
        doubt["where"] = "" if self.has("effort", name) else " at all joints"
        doubt["cause"] = "the opposite sign" if factor < 0.0 else "another unit, or a gear ratio"
        doubts = [message.model_dump() for message in summary.doubts]
        return replace(result, summary=put_doubts(summary, [*doubts, doubt]))


def bodies_torques(o: Signals) -> Array:
    """Rigid-body torque and its deviations ``(1 + k, n)`` at the samples."""
    load, others = o.inputs.load_torque, o.inputs.others
    assert load is not None
    names = [name for name in signals(len(others)) if name in others]
    return np.stack([-load.at(o.stamps), *(others[name].at(o.stamps) for name in names)])


def compared_torques(model: Model) -> Array:
    """Filter a joint's rigid-body torque and its deviations as compared, ``(1 + k, outputs)``."""
    parts = [o.filter.apply(bodies_torques(o)) for o in model.observations]
    return np.concatenate(parts, axis=1)


def _likelihood(
    observations: Sequence[Signals], logs: Sequence[ArmLog], gravity: Sequence[Array]
) -> tuple[Array, Array]:
    """Estimate a joint's likelihood of ``(a, k deviations, b)``: information and vector.

    ``gravity`` ``(n,)`` is the torque of the bodies at rest along the motion of each log.
    """
    torques, losses, measured = [], [], []
    for o, log, still in zip(observations, logs, gravity, strict=False):
        rigid, sign = bodies_torques(o), np.sign(o.qd)
        weight = interpolated(log.time, still, o.stamps)
        loads = [np.abs(rigid[0]) * sign, np.abs(rigid[0] - weight) * sign]
        columns = [sign, o.qd, *loads, o.qdd, np.ones_like(sign)]
        torques.append(o.filter.apply(np.vstack([rigid, -weight])))
        losses.append(o.filter.apply(np.stack(columns)))
        measured.append(o.measured)
    x, friction = np.concatenate(torques, axis=1).T, np.concatenate(losses, axis=1).T
    y, both = np.concatenate(measured) - x[:, 0], np.hstack([friction, x])
    coefficients = np.linalg.lstsq(both, y, rcond=None)[0]
    residual = y - both @ coefficients
    variance = long_run_variance(residual, np.arange(y.size)) / max(y.size - both.shape[1], 1)
    lacking = _LACKING * np.std(friction[:, :4] @ coefficients[:4])
    variance += float(lacking**2) * y.size / _SHAPES
    basis = np.linalg.qr(friction)[0]
    x, y = x - basis @ (basis.T @ x), y - basis @ (basis.T @ y)
    return x.T @ x / variance, x.T @ y / variance


def common_factors(
    bodies: Bodies,
    prior: InertialPrior,
    logs: Sequence[ArmLog],
    models: Mapping[str, Model],
    directions: Mapping[str, Array],
    *,
    payload: bool,
) -> CommonFactors:
    """Choose departures by their evidence; ``payload`` is whether there is known to be one."""
    names, count, order = [*models], len(prior.deviations), list(bodies.joints)
    at_rest = []
    for log in logs[: max(len(model.observations) for model in models.values())] if models else ():
        still, nominal = log.motion.copy(), prior.columns(loaded=log.loaded)[:, :1]
        still[1:] = 0.0
        at_rest.append(bodies.torques(still, np.repeat(nominal[None], len(order), axis=0))[:, 0])
    size = count + len(names) + 1  # z, a of each joint, and b
    information, vector = np.zeros((size, size)), np.zeros(size)
    for j, name in enumerate(names, start=count):
        weights = [torques[order.index(name)] for torques in at_rest]
        own, own_vector = _likelihood(models[name].observations, logs, weights)
        to_own = np.zeros((len(own), size))
        to_own[0, j], to_own[1:-1, :count], to_own[-1, -1] = 1.0, directions[name].T, 1.0
        information += to_own.T @ own @ to_own
        vector += to_own.T @ own_vector
    links = dict.fromkeys(filter(None, prior.links))
    of_link = {link: np.array(prior.links) == link for link in links}

    def candidates() -> Iterator[tuple[Departure, float]]:
        known = [name for name in names if not models[name].chain.gain]
        if len(known) == len(names):
            yield Departure("effort"), _ODDS
        yield from ((Departure("effort", name), _ODDS / len(names)) for name in known)
        if any(bodies.gravity):
            yield Departure("gravity"), _ODDS
        if not payload:
            yield Departure("payload"), _ODDS
        yield from ((Departure("bodies", width=width), _ODDS) for width in _WIDTHS)
        yield from ((Departure("body", link, _ONE_BODY), _ODDS / len(links)) for link in links)

    def widths(taken: Sequence[Departure]) -> Array:
        out = np.ones(count)
        for kind, link, width in taken:
            out[of_link[link] if kind == "body" else slice(None)] *= width
        return out

    def posterior(taken: Sequence[Departure], sd: float = 1.0) -> tuple[float, Array, Array, Array]:
        """Log evidence; mean and covariance of z, a and b; and estimated scales of efforts."""
        kinds = {kind for kind, *_ in taken}
        wide, mean = np.zeros((size, count)), np.zeros(size)
        wide[:count] = np.diag(widths(taken))
        if not payload and "payload" not in kinds:
            wide[count - PER_BODY : count] = 0.0
        mean[-1] = "gravity" in kinds
        scaled = np.zeros((size, 0))
        for _, name, _ in (departure for departure in taken if departure.kind == "effort"):
            columns = [name in ("", each) for each in names]
            scaled = np.column_stack([scaled, np.r_[np.zeros(count), columns, 0.0]])
        wide = np.hstack([wide, sd * scaled])
        precision = np.eye(wide.shape[1]) + wide.T @ information @ wide
        score = wide.T @ (vector - information @ mean)
        solution = np.linalg.solve(precision, score)
        evidence = float(score @ solution - np.linalg.slogdet(precision)[1]) / 2.0
        evidence += float(vector @ mean - mean @ information @ mean / 2.0)
        covariance = wide @ np.linalg.solve(precision, wide.T)
        scales = scaled @ (sd * solution[len(solution) - scaled.shape[1] :])
        if (far := float(np.abs(scales).max())) > 1.1 * sd:
            return posterior(taken, far)  # units may differ by a factor of a thousand
        return evidence, mean + wide @ solution, covariance, 1.0 + scales[count:-1]

    taken, best = list[Departure](), posterior([])
    while True:
        further = [
            (math.log(odds) + (option := posterior([*taken, departure]))[0], departure, option)
            for departure, odds in candidates()
            if not any(departure[:2] == other[:2] for other in taken)
        ]
        value, departure, option = max(further, key=lambda each: each[0])
        if value <= best[0]:
            break
        taken, best = [*taken, departure], option
    _, mean, covariance, scales = best

    def factor(columns: Sequence[int], *, efforts: bool) -> tuple[float, float]:
        """Factor of the torque of the bodies at some joints, and its sd."""
        row = information[columns].sum(axis=0) / max(information[columns, columns].sum(), 1e-300)
        row[-1], row[count:-1] = 0.0, row[count:-1] * efforts
        return float(1.0 + row @ mean), math.sqrt(max(float(row @ covariance @ row), 0.0))

    numbers = {name: j for j, name in enumerate(names, start=count)}
    of_all = Departure("effort") in taken
    alone = {name for kind, name, _ in taken if kind == "effort" and name}
    group = [j for name, j in numbers.items() if name not in alone]
    joints = {
        name: factor(group if name not in alone else [j], efforts=True)
        for name, j in numbers.items()
        if of_all or name in alone
    }
    gravity = (0.0, 0.0, 0.0) if Departure("gravity") in taken else bodies.gravity
    return CommonFactors(
        tuple(taken),
        joints,
        factor(group, efforts=False) if group else (1.0, 0.0),
        {name: float(scale) for name, scale in zip(names, scales, strict=True) if name in joints},
        gravity,
        widths(taken),
    )
