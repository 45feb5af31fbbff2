"""What all joints say together of a log and its URDF, before any of them is fitted.

By least squares each joint has a Gaussian likelihood of the deviations ``z`` of the bodies, of a
factor ``1 + a`` of its effort, and of the share ``b`` of gravity that its effort lacks. A departure
from a right log and URDF adds variance to some of these, of a scale with a half-Cauchy prior [1]_.
Kinds of departure are a priori equally likely, together as likely as none, and so are the joints or
numbers of a kind. The departures of the largest posterior density are taken, step by step.

A delay is that of all joints: a joint's model that lacks a term makes one of any sign and size, so
the joints' are combined with the scatter between them (random effects [2]_).

References
----------
.. [1] N. G. Polson, J. G. Scott, "On the half-Cauchy prior for a global scale parameter", Bayesian
   Analysis 7 (2012) 887-902.
.. [2] R. DerSimonian, N. Laird, "Meta-analysis in clinical trials", Controlled Clinical Trials 7
   (1986) 177-188.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bayesfric.arm.arm_log import ArmLog, signals
from bayesfric.arm.arm_options import Vector
from bayesfric.arm.inertial_prior import PER_BODY, Bodies, InertialPrior
from bayesfric.arm.joint_consistency import UNLIKELY
from bayesfric.base.errors import BadInput
from bayesfric.estimates.autoregression import long_run_variance
from bayesfric.estimates.input_error import input_error
from bayesfric.fit.model import Model, Result
from bayesfric.inference.priors import as_knowledge, read_prior
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import interpolated
from bayesfric.recordings.signals import Signals, retimed
from bayesfric.report.summary.doubts import put_doubts

# Scales of a departure that are compared, and the logs of the half-Cauchy's density of their logs.
_SCALES = 2.0 ** np.arange(-4, 13)
_ODDS = np.log(2.0 * _SCALES / (1.0 + _SCALES**2))
# Twice the log of a Bayes factor that is strong evidence (Kass and Raftery 1995).
_STRONG = 6.0
# Longest delay to look for, s.
_LONGEST = 0.25
# Ratios of coupled joints that are tried.
_RATIOS = (1.0, -1.0, 0.5, -0.5, 2.0, -2.0)


class Departure(NamedTuple):
    """One of kind ``efforts``, ``effort``, ``gravity``, ``payload``, ``bodies`` or ``body``."""

    kind: str
    name: str = ""  # of a joint's effort, or of a deviation of the bodies
    scale: float = 1.0  # of its coefficients


@dataclass(frozen=True, eq=False)
class Departures:
    """The departures taken, and factors of the torque of the bodies with their sds."""

    taken: tuple[Departure, ...]
    alternatives: tuple[Departure, ...]  # that explain the log nearly as well in place of one
    joints: Mapping[str, tuple[float, float]]  # of those whose effort may have another scale
    bodies: tuple[float, float]  # of all together, by joints whose effort has none
    scales: Mapping[str, float]  # of efforts, taken
    gravity: Vector
    widths: Array  # (n_deviations,) factors on standard deviations

    @property
    def changes(self) -> bool:
        """Whether the models change."""
        return any(departure.kind != "payload" for departure in self.taken)

    @property
    def without_gravity(self) -> bool:
        """Whether efforts hold no gravity."""
        return Departure("gravity") in self.taken

    def doubted(self, name: str, result: Result) -> Result:
        """Doubt the numbers of a joint that the scale of its effort multiplies."""
        if name not in self.joints:
            return result
        summary, scaled = result.summary, ("motor.", "offset")
        of = [x for x in summary.parameters if x.startswith(scaled) and ".load" not in x]
        factor, sd = self.joints[name]
        alone = any(x.name == name for x in (*self.taken, *self.alternatives))
        doubt = {"kind": "effort-scale", "parameters": of, "factor": factor, "sd": sd}
        doubt["where"] = "" if alone else " at all joints"
        doubt["cause"] = "another unit, a gear ratio, or other bodies"
        if factor < 0.0:
            doubt["cause"] = "the opposite sign"
        if abs(factor) < 3.0 * sd:
            doubt["cause"] = "another axis than in the URDF, or another joint's column"
        doubts = [message.model_dump() for message in summary.doubts]
        return replace(result, summary=put_doubts(summary, [*doubts, doubt]))


def bodies_torques(o: Signals) -> Array:
    """Rigid-body torque and its deviations ``(1 + k, n)`` at the samples."""
    load, others = o.inputs.load_torque, o.inputs.others
    assert load is not None
    names = [name for name in signals(len(others)) if name in others]
    return np.stack([-load.at(o.stamps), *(others[name].at(o.stamps) for name in names)])


def _likelihood(
    observations: Sequence[Signals],
    logs: Sequence[ArmLog],
    gravity: Sequence[Array],
    lacking: float,
) -> tuple[Array, Array]:
    """Estimate a joint's likelihood of ``(a, k deviations, b)``: information and vector.

    ``gravity`` ``(n,)`` is the torque of the bodies at rest along the motion of each log. Of the
    friction a law is taken to lack the share ``lacking`` (rms), independently from one reversal to
    the next.
    """
    torques, losses, measured, strokes = [], [], [], 1
    for o, log, still in zip(observations, logs, gravity, strict=False):
        rigid, sign = bodies_torques(o), np.sign(o.qd)
        weight = interpolated(log.time, still, o.stamps)
        loads = [np.abs(rigid[0]) * sign, np.abs(rigid[0] - weight) * sign]
        columns = [sign, o.qd, *loads, o.qdd, np.ones_like(sign)]
        torques.append(o.filter.apply(np.vstack([rigid, -weight])))
        losses.append(o.filter.apply(np.stack(columns)))
        measured.append(o.measured)
        strokes += int(np.count_nonzero(np.diff(sign[o.filter.centres])))
    x, friction = np.concatenate(torques, axis=1).T, np.concatenate(losses, axis=1).T
    y, both = np.concatenate(measured) - x[:, 0], np.hstack([friction, x])
    coefficients = np.linalg.lstsq(both, y, rcond=None)[0]
    residual = y - both @ coefficients
    variance = long_run_variance(residual, np.arange(y.size)) / max(y.size - both.shape[1], 1)
    size = lacking * np.std(friction[:, :4] @ coefficients[:4])
    variance += float(size**2) * y.size / strokes
    basis = np.linalg.qr(friction)[0]
    x, y = x - basis @ (basis.T @ x), y - basis @ (basis.T @ y)
    return x.T @ x / variance, x.T @ y / variance


def find_departures(
    bodies: Bodies,
    prior: InertialPrior,
    logs: Sequence[ArmLog],
    models: Mapping[str, Model],
    directions: Mapping[str, Array],
    *,
    payload: bool,
    lacking: float,
) -> Departures:
    """Choose departures; ``payload`` is whether there is known to be one."""
    names, count, order = [*models], len(prior.deviations), list(bodies.joints)
    at_rest = []
    for log in logs[: max(len(model.observations) for model in models.values())] if models else ():
        still, nominal = log.motion.copy(), prior.columns(loaded=log.loaded)[:, :1]
        still[1:] = 0.0
        at_rest.append(bodies.torques(still, np.repeat(nominal[None], len(order), axis=0))[:, 0])
    size = count + len(names) + 1  # z, a of each joint, and b
    information, vector = np.zeros((size, size)), np.zeros(size)
    numbers = {name: j for j, name in enumerate(names, start=count)}
    for name, j in numbers.items():
        weights = [torques[order.index(name)] for torques in at_rest]
        own, own_vector = _likelihood(models[name].observations, logs, weights, lacking)
        to_own = np.zeros((len(own), size))
        to_own[0, j], to_own[1:-1, :count], to_own[-1, -1] = 1.0, directions[name].T, 1.0
        information += to_own.T @ own @ to_own
        vector += to_own.T @ own_vector
    unit, of_links = np.eye(size), count - PER_BODY
    efforts = {name: unit[:, [j]] for name, j in numbers.items() if not models[name].chain.gain}
    all_efforts = unit[:, count:-1].sum(axis=1, keepdims=True)
    # of each kind the coefficients of its departures, (size, k) by name
    columns: dict[str, dict[str, Array]] = {
        "efforts": {"": all_efforts} if len(efforts) == len(names) else {},
        "effort": efforts if len(names) > 1 else {},
        "gravity": {"": unit[:, -1:]} if any(bodies.gravity) else {},
        "payload": {} if payload else {"": unit[:, of_links:count]},
        "bodies": {"": unit[:, :of_links]},
        "body": {prior.deviations[k][0]: unit[:, [k]] for k in range(1, of_links)},
    }
    odds = {kind: -math.log(len(columns) * max(len(x), 1)) for kind, x in columns.items()}

    def posterior(taken: Sequence[Departure]) -> tuple[float, Array, Array]:
        """Log of evidence and prior; mean and covariance of z, a and b."""
        mean, wide = np.zeros(size), [unit[:, : count if payload else of_links]]
        log_prior = sum(odds[kind] for kind, *_ in taken)
        for kind, name, scale in taken:
            if kind == "gravity":
                mean[-1] = 1.0
            else:
                wide.append(scale * columns[kind][name])
                log_prior += float(_ODDS[scale == _SCALES][0])
        every = np.hstack(wide)
        precision = np.eye(every.shape[1]) + every.T @ information @ every
        score = every.T @ (vector - information @ mean)
        solution = np.linalg.solve(precision, score)
        evidence = float(score @ solution - np.linalg.slogdet(precision)[1]) / 2.0
        evidence += float(vector @ mean - mean @ information @ mean / 2.0)
        covariance = every @ np.linalg.solve(precision, every.T)
        return evidence + log_prior, mean + every @ solution, covariance

    def added(taken: tuple[Departure, ...]) -> Iterator[tuple[float, Departure]]:
        """Try each further departure at its likeliest scale."""
        value, mean, covariance = posterior(taken)
        score = vector - information @ mean
        marginal = information - information @ covariance @ information
        for kind, name, x in (
            (k, n, x) for k, of_kind in columns.items() for n, x in of_kind.items()
        ):
            if any(departure[:2] == (kind, name) for departure in taken):
                continue
            if kind == "gravity":
                gain, scale = float(score[-1] - marginal[-1, -1] / 2.0), 1.0
            else:
                variances, axes = np.linalg.eigh(x.T @ marginal @ x)
                shares = _SCALES[:, None] ** 2 * np.maximum(variances, 0.0)
                scores = _SCALES[:, None] * (axes.T @ (x.T @ score))
                gains = _ODDS + np.sum(scores**2 / (1.0 + shares) - np.log1p(shares), axis=1) / 2.0
                gain, scale = float(gains.max()), float(_SCALES[np.argmax(gains)])
            yield value + odds[kind] + gain, Departure(kind, name, scale)

    taken, value = tuple[Departure, ...](), posterior(())[0]
    while True:
        best, departure = max(added(taken))
        rests = [tuple(x for x in taken if x is not each) for each in taken]
        less, fewer = max(((posterior(rest)[0], rest) for rest in rests), default=(-math.inf, ()))
        if max(best, less) <= value + 1e-9:
            break
        value, taken = (best, (*taken, departure)) if best > less else (less, fewer)
    alternatives = dict[str, Departure]()  # the likeliest of each kind
    for rest in rests:
        least = max(value + math.log(UNLIKELY), posterior(rest)[0])
        others = sorted(option for option in added(rest) if option[0] > least)
        kinds = {departure.kind for departure in taken if departure not in rest}
        alternatives |= {each.kind: each for _, each in others if each.kind not in kinds}
    _, mean, covariance = posterior(taken)

    def factor(at: Sequence[int], *, scaled: bool) -> tuple[float, float]:
        """Factor of the torque of the bodies at some joints, and its sd."""
        row = information[at].sum(axis=0) / max(information[at, at].sum(), 1e-300)
        row[-1], row[count:-1] = 0.0, row[count:-1] * scaled
        return float(1.0 + row @ mean), math.sqrt(max(float(row @ covariance @ row), 0.0))

    def of_kinds(*kinds: str, options: Iterable[Departure] = taken) -> list[Departure]:
        return [departure for departure in options if departure.kind in kinds]

    alone = {each.name for each in of_kinds("effort")}
    together = [j for name, j in numbers.items() if name not in alone]
    every = (*taken, *alternatives.values())
    doubtful = {each.name for each in of_kinds("effort", options=every)}
    doubtful |= {*names} if of_kinds("efforts", options=every) else set()
    undone = {*names} if of_kinds("efforts") else alone
    variances = np.ones(count)
    for kind, name, scale in of_kinds("bodies", "body"):
        variances += scale**2 * columns[kind][name][:count].sum(axis=1)
    return Departures(
        taken,
        tuple(alternatives.values()),
        {
            name: factor([j] if name in alone else together, scaled=True)
            for name, j in numbers.items()
            if name in doubtful
        },
        factor(together, scaled=False) if together else (1.0, 0.0),
        {name: float(1.0 + mean[j]) for name, j in numbers.items() if name in undone},
        (0.0, 0.0, 0.0) if of_kinds("gravity") else bodies.gravity,
        np.sqrt(variances),
    )


# -- one delay of the log


@dataclass(frozen=True)
class ArmDelay:
    """Time by which positions come after efforts, s: by all joints, and by each."""

    value: float
    sd: float
    joints: Mapping[str, tuple[float, float]]  # value and sd
    evident: bool  # by the Bayesian information criterion


def common_delay(models: Mapping[str, Model]) -> ArmDelay:
    """Combine the delays of models of joints by input error, repeated about the last one.

    A model whose delay is known has no say.
    """
    models = {name: model for name, model in models.items() if not model.chain.delay}
    outputs = sum(o.measured.size for model in models.values() for o in model.observations)
    delay = 0.0
    for _ in range(5):
        joints = {name: x for name, model in models.items() if (x := _delay_of(model, delay))}
        value, sd = combined(joints.values())
        evident = value**2 > sd**2 * (math.log(max(outputs, 1)) + _STRONG)
        if not evident or abs(value - delay) < 0.5 * sd:
            break
        delay = value
    return ArmDelay(value, sd, joints, evident)


def _delay_of(model: Model, about: float) -> tuple[float, float] | None:
    """Estimate the delay of a joint and its sd, linear about a delay."""
    chain = replace(model.chain, delay=True)
    prior = read_prior(chain.delay_name, [-_LONGEST, _LONGEST], lower=-math.inf, upper=math.inf)
    knowledge = as_knowledge(chain, {**model.priors, chain.delay_name: prior})
    pairs = zip(model.recordings, model.observations, strict=True)
    shifted = [retimed(o, r.segments, r.period, about, r) for r, o in pairs]
    try:
        delay = input_error(chain, shifted, knowledge, model.evidence.options)[chain.delay_name]
    except BadInput:  # too few outputs
        return None
    sd = delay.larger_sd
    return (delay.value, sd) if delay.determined and sd > 0.0 else None


def combined(estimates: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """Combine values and sds to the mean of random effects, and its sd; 0 and infinity of none."""
    pairs = np.array([*estimates]).reshape(-1, 2)
    if not len(pairs):
        return 0.0, math.inf
    value, variance = pairs[:, 0], pairs[:, 1] ** 2
    weight = 1.0 / variance
    mean = float(weight @ value / weight.sum())
    excess = float(weight @ (value - mean) ** 2) - (len(value) - 1)
    between = max(excess / max(float(weight.sum() - weight @ weight / weight.sum()), 1e-300), 0.0)
    weight = 1.0 / (variance + between * (len(value) > 1))
    return float(weight @ value / weight.sum()), float(1.0 / math.sqrt(weight.sum()))


# -- joints whose motor turns with another joint, too, as in many wrists


@dataclass(frozen=True)
class Coupled:
    """A motor that turns with another joint: ratio, and residual rms without and with that."""

    other: str
    ratio: float
    before: float
    after: float


def coupled_joint(
    o: Signals, log: ArmLog, joints: Sequence[str], name: str, torques: Array
) -> Coupled | None:
    """Find the joint whose motion a joint's effort follows in addition to its own, if any does.

    Friction and rotor inertia of such a motor follow ``q_i + s q_j``: with that speed the model has
    the ratio ``s`` in addition. ``torques`` ``(k, n)`` are the nominal rigid-body torque and its
    deviations along the log. By the Bayesian information criterion of as many independent outputs
    as the residual has, ratios and joints equally likely.
    """
    o, index = o.excerpt(), [*joints].index(name)
    load = interpolated(log.time, torques, o.stamps)
    nuisance = o.filter.apply(np.vstack([load, np.ones_like(o.stamps)])).T
    basis, _ = np.linalg.qr(nuisance)

    def residual(other: int, ratio: float) -> Array:
        qd, qdd = interpolated(log.time, log.motion[1:, other], o.stamps)
        speed = o.qd + ratio * qd
        columns = o.filter.apply(np.stack([speed, np.sign(speed), o.qdd + ratio * qdd])).T
        columns, y = (x - basis @ (basis.T @ x) for x in (columns, o.measured))
        return np.asarray(y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0])

    def rms(other: int, ratio: float) -> float:
        return float(np.sqrt(np.mean(residual(other, ratio) ** 2)))

    moving = [j for j in range(len(joints)) if j != index and np.ptp(log.motion[0, j]) > 0.0]
    if not moving or o.measured.size < 2 * nuisance.shape[1]:
        return None
    before = rms(index, 0.0)
    after, other, ratio = min((rms(j, s), j, s) for j in moving for s in _RATIOS)
    after, ratio = min((rms(other, s), s) for s in ratio * np.linspace(0.7, 1.3, 25))
    left, count = residual(other, ratio), o.measured.size
    correlated = long_run_variance(left, np.arange(count)) / max(float(left @ left), 1e-300)
    independent = count / max(correlated, 1.0)
    evidence = 2.0 * independent * math.log(before / max(after, 1e-12 * before))
    if evidence < math.log(count) + 2.0 * math.log(len(_RATIOS) * len(moving)) + _STRONG:
        return None
    return Coupled(joints[other], float(ratio), before, after)


def coupling_remark(name: str, coupled: Coupled, unit: str) -> str:
    """Say how to couple two joints."""
    other, ratio = coupled.other, coupled.ratio
    return (
        f"its effort is that of a motor that turns with {other}, too ({coupled.before:.3g} to "
        f'{coupled.after:.3g} {unit} rms): [coupling] joints = ["{other}", "{name}"], '
        f"matrix = [[1, 0], [{ratio:.2g}, 1]]"
    )
