"""What all joints say together of a log and its URDF, before any of them is fitted.

By least squares each joint has a Gaussian likelihood of the deviations ``z`` of the bodies, of a
factor ``1 + a`` of its effort, and of the share ``b`` of gravity that its effort lacks. A departure
from a right log and URDF adds variance to some of these, of a scale with a half-Cauchy prior [1]_.
Kinds of departure are a priori equally likely, together as likely as none, and so are the joints or
numbers of a kind. The departures of the largest posterior density are included, step by step.

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
from bayesfric.arm.arm_options import Vector, torque_columns
from bayesfric.arm.inertial_prior import PER_BODY, Bodies, InertialPrior
from bayesfric.base.errors import BadInput
from bayesfric.estimates.autoregression import long_run_variance
from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.point_estimate import HALF
from bayesfric.fit.model import Model, Result
from bayesfric.inference.priors import as_knowledge, read_prior
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import interpolated
from bayesfric.recordings.signals import Signals, retimed
from bayesfric.report.summary.doubts import put_doubts

# Scales of a departure that are compared, and the logs of the half-Cauchy's density of their logs.
_SCALES = np.asarray(2.0 ** np.arange(-4, 13), dtype=np.float64)
_ODDS = np.log(2.0 * _SCALES / (1.0 + _SCALES**2))
# Least odds of an alternative.
_LEAST = 0.05
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
    """The departures included, and factors of the torque of the bodies with their sds."""

    included: tuple[Departure, ...]
    alternatives: tuple[Departure, ...]  # in addition or in place of one, not much less likely
    joints: Mapping[str, tuple[float, float]]  # of those whose effort may have another scale
    bodies: tuple[float, float]  # of all together, by joints whose effort has none
    scales: Mapping[str, float]  # of efforts, which are undone
    gains: Mapping[str, float]  # relative sds of these, which fits estimate as gains of drives
    # 90 % ranges of the scales of `joints` over those undone, by what data favour as well
    ranges: Mapping[str, tuple[float, float]]
    gravity: Vector
    widths: Array  # (n_deviations,) factors on standard deviations

    @property
    def changes(self) -> bool:
        """Whether the models change."""
        return any(departure.kind != "payload" for departure in self.included)

    def doubted(self, name: str, result: Result) -> Result:
        """Doubt the numbers of a joint that the scale of its effort multiplies, and widen them."""
        if name not in self.joints:
            return result
        summary, scaled = result.summary, ("motor.", "offset")
        of = [x for x in summary.parameters if x.startswith(scaled) and ".load" not in x]
        factor, sd = self.joints[name]
        alone = any(x.name == name for x in (*self.included, *self.alternatives))
        doubt = {"kind": "effort-scale", "parameters": of, "factor": factor, "sd": sd}
        doubt["where"] = "" if alone else " at all joints"
        doubt["cause"] = "another unit, a gear ratio, or other bodies"
        if factor < 0.0:
            doubt["cause"] = "the opposite sign"
        if abs(factor) < 3.0 * sd:
            doubt["cause"] = "another axis than in the URDF, or another joint's column"
        doubts = [message.model_dump() for message in summary.doubts]
        changes, (low, high) = {}, self.ranges[name]
        for key in of:
            ends = np.outer(summary.parameters[key].reported.interval, [1.0 / high, 1.0 / low])
            interval, sd = (float(ends.min()), float(ends.max())), float(np.ptp(ends)) / 2.0 / HALF
            changes[key] = {"model_error_interval": interval, "model_error_sd": sd}
        return replace(result, summary=put_doubts(summary.with_rows(changes), [*doubts, doubt]))


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
    friction a law lacks the share ``lacking`` (rms), independently from one reversal to the next.
    """
    torques, losses, measured, strokes = [], [], [], 1
    for o, log, still in zip(observations, logs, gravity, strict=False):
        rigid, weight = bodies_torques(o), interpolated(log.time, still, o.stamps)
        sign, columns = np.sign(o.qd), torque_columns(rigid[0], o.qd, o.qdd)
        # friction by a load that may lack gravity
        columns = np.vstack([columns, np.abs(rigid[0] - weight) * sign])
        torques.append(o.filter.apply(np.vstack([rigid, -weight])))
        losses.append(o.filter.apply(columns))
        measured.append(o.measured)
        strokes += int(np.count_nonzero(np.diff(sign[o.filter.centres])))
    x, friction = np.concatenate(torques, axis=1).T, np.concatenate(losses, axis=1).T
    y, both = np.concatenate(measured) - x[:, 0], np.hstack([friction, x])
    coefficients = np.linalg.lstsq(both, y, rcond=None)[0]
    residual = y - both @ coefficients
    variance = long_run_variance(residual, np.arange(y.size)) / max(y.size - both.shape[1], 1)
    losing = [1, 2, 3, 5]  # Coulomb, viscous, and those by the load
    size = lacking * np.std(friction[:, losing] @ coefficients[losing])
    variance += float(size**2) * y.size / strokes
    basis = np.linalg.qr(friction)[0]
    x, y = x - basis @ (basis.T @ x), y - basis @ (basis.T @ y)
    return x.T @ x / variance, x.T @ y / variance


def _information(
    bodies: Bodies,
    prior: InertialPrior,
    logs: Sequence[ArmLog],
    models: Mapping[str, Model],
    directions: Mapping[str, Array],
    lacking: float,
) -> tuple[Array, Array]:
    """Sum the likelihoods of joints, of z, a of each, and b: information and vector."""
    count, order = len(prior.deviations), list(bodies.joints)
    size, at_rest = count + len(models) + 1, []
    for log in logs[: max((len(x.observations) for x in models.values()), default=0)]:
        still, nominal = log.motion.copy(), prior.columns(loaded=log.loaded)[:, :1]
        still[1:] = 0.0
        at_rest.append(bodies.torques(still, np.repeat(nominal[None], len(order), axis=0))[:, 0])
    information, vector = np.zeros((size, size)), np.zeros(size)
    for j, (name, model) in enumerate(models.items(), start=count):
        weights = [torques[order.index(name)] for torques in at_rest]
        own, own_vector = _likelihood(model.observations, logs, weights, lacking)
        to_own = np.zeros((len(own), size))
        to_own[0, j], to_own[1:-1, :count], to_own[-1, -1] = 1.0, directions[name].T, 1.0
        information += to_own.T @ own @ to_own
        vector += to_own.T @ own_vector
    return information, vector


@dataclass(frozen=True, eq=False)
class Evidence:
    """A likelihood ``exp(-x'J x/2 + h'x)`` of all coefficients, and the departures of a prior.

    ``columns`` ``(n, k)`` are by kind and name the coefficients to which a departure adds variance;
    the first ``known`` are standard normal without any. That of kind ``gravity`` is 1.
    """

    information: Array  # J, (n, n)
    vector: Array  # h, (n,)
    known: int
    columns: Mapping[str, Mapping[str, Array]]

    def _odds(self, kind: str) -> float:
        return -math.log(len(self.columns) * max(len(self.columns[kind]), 1))

    def posterior(self, included: Sequence[Departure]) -> tuple[float, Array, Array]:
        """Log of evidence and prior of departures; mean and covariance of the coefficients."""
        size, log_prior = len(self.vector), sum(self._odds(kind) for kind, *_ in included)
        mean, parts = np.zeros(size), [np.eye(size)[:, : self.known]]
        for kind, name, scale in included:
            if kind == "gravity":
                mean += self.columns[kind][name][:, 0]
            else:
                parts.append(scale * self.columns[kind][name])
                log_prior += float(_ODDS[scale == _SCALES][0])
        root = np.hstack(parts)
        precision = np.eye(root.shape[1]) + root.T @ self.information @ root
        score = root.T @ (self.vector - self.information @ mean)
        solution = np.linalg.solve(precision, score)
        evidence = float(score @ solution - np.linalg.slogdet(precision)[1]) / 2.0
        evidence += float(self.vector @ mean - mean @ self.information @ mean / 2.0)
        covariance = root @ np.linalg.solve(precision, root.T)
        return evidence + log_prior, mean + root @ solution, covariance

    def added(self, included: tuple[Departure, ...]) -> Iterator[tuple[float, Departure]]:
        """Try each further departure at its likeliest scale: as :meth:`posterior`, and which."""
        value, mean, covariance = self.posterior(included)
        score = self.vector - self.information @ mean
        marginal = self.information - self.information @ covariance @ self.information
        for kind, of_kind in self.columns.items():
            for name, x in of_kind.items():
                if any(departure[:2] == (kind, name) for departure in included):
                    continue
                along, across = x.T @ score, x.T @ marginal @ x
                gains: Array = along - across[0] / 2.0
                scales: Array = np.ones(1)
                if kind != "gravity":
                    variances, axes = np.linalg.eigh(across)
                    scales, scaled = _SCALES, _SCALES[:, None] ** 2
                    shares = scaled * np.maximum(variances, 0.0)
                    terms = scaled * (axes.T @ along) ** 2 / (1.0 + shares) - np.log1p(shares)
                    gains = np.asarray(_ODDS + np.sum(terms, axis=1) / 2.0, dtype=np.float64)
                best = int(np.argmax(gains))
                gain, scale = float(gains[best]), float(scales[best])
                yield value + self._odds(kind) + gain, Departure(kind, name, scale)

    def likeliest(self) -> tuple[tuple[Departure, ...], list[tuple[Departure, ...]]]:
        """Add and drop departures until none is better; and with the likeliest others of each kind.

        Data favour these, the last of each, in addition to those included or in place of one.
        """
        included, value = tuple[Departure, ...](), self.posterior(())[0]
        while True:
            rests = [tuple(x for x in included if x is not each) for each in included]
            options = [(self.posterior(rest)[0], rest) for rest in rests]
            options += [(v, (*included, departure)) for v, departure in self.added(included)]
            best, option = max(options, key=lambda each: each[0])
            if best <= value + 1e-9:
                break
            value, included = best, option
        alternatives = dict[str, tuple[Departure, ...]]()
        for kind, rest in (("", included), *zip([x.kind for x in included], rests, strict=True)):
            without = self.posterior(rest)[0]
            for v, departure in sorted(self.added(rest)):
                least = max(value + math.log(_LEAST), without + self._odds(departure.kind))
                if v > least and departure.kind != kind:
                    alternatives[departure.kind] = *rest, departure
        return included, [*alternatives.values()]


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
    information, vector = _information(bodies, prior, logs, models, directions, lacking)
    names, count = [*models], len(prior.deviations)
    unit, of_links = np.eye(len(vector)), count - PER_BODY
    numbers = {name: j for j, name in enumerate(names, start=count)}
    efforts = {name: unit[:, [j]] for name, j in numbers.items() if not models[name].chain.gain}
    all_efforts = unit[:, count:-1].sum(axis=1, keepdims=True)
    columns: dict[str, dict[str, Array]] = {
        "efforts": {"": all_efforts} if len(efforts) == len(names) else {},
        "effort": efforts if len(names) > 1 else {},
        "gravity": {"": unit[:, -1:]} if any(bodies.gravity) else {},
        "payload": {} if payload else {"": unit[:, of_links:count]},
        "bodies": {"": unit[:, :of_links]},
        "body": {prior.deviations[k][0]: unit[:, [k]] for k in range(1, of_links)},
    }
    evidence = Evidence(information, vector, count if payload else of_links, columns)
    included, others = evidence.likeliest()
    alternatives = tuple(departures[-1] for departures in others)
    _, mean, covariance = evidence.posterior(included)

    def factor(at: Sequence[int], *, of_efforts: bool) -> tuple[float, float]:
        """Factor of the torque of the bodies at some joints, and its sd."""
        row = information[at].sum(axis=0) / max(information[at, at].sum(), 1e-300)
        row[-1], row[count:-1] = 0.0, row[count:-1] * of_efforts
        return float(1.0 + row @ mean), math.sqrt(max(float(row @ covariance @ row), 0.0))

    def scaled(departures: Sequence[Departure]) -> list[str]:
        """Names of the joints whose effort they scale."""
        return [
            n for n in names if any(x[:2] in (("effort", n), ("efforts", "")) for x in departures)
        ]

    def scale_of(departures: Sequence[Departure], name: str) -> tuple[float, float]:
        """Scale of a joint's effort, and its relative sd."""
        _, mean, covariance = evidence.posterior(departures)
        value, variance = 1.0 + mean[numbers[name]], covariance[(numbers[name],) * 2]
        return float(value), float(math.sqrt(variance) / abs(value))

    scales = {name: scale_of(included, name) for name in scaled(included)}
    doubtful, ranges = scaled((*included, *alternatives)), dict[str, tuple[float, float]]()
    for name in doubtful:
        undone, ends = abs(scales.get(name, (1.0,))[0]), [1.0]
        for departures in others:
            value, width = scale_of(departures, name)
            ends += [abs(value) / undone * math.exp(side * HALF * width) for side in (-1.0, 1.0)]
        ranges[name] = min(ends), max(ends)
    alone = [each.name for each in included if each.kind == "effort"]
    together = [j for name, j in numbers.items() if name not in alone]
    variances = np.ones(count)
    for kind, name, scale in included:
        if kind in ("bodies", "body"):
            variances += scale**2 * columns[kind][name][:count].sum(axis=1)
    return Departures(
        included,
        alternatives,
        {
            name: factor([numbers[name]] if name in alone else together, of_efforts=True)
            for name in doubtful
        },
        factor(together, of_efforts=False) if together else (1.0, 0.0),
        {name: value for name, (value, _) in scales.items()},
        {name: width for name, (_, width) in scales.items()},
        ranges,
        (0.0, 0.0, 0.0) if Departure("gravity") in included else bodies.gravity,
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
        # jitter of the log's stamps is an error of all joints, which does not average out
        sd = max(sd, min((own for _, own in joints.values()), default=sd))
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


def coupled_joint(
    o: Signals, log: ArmLog, joints: Sequence[str], name: str, torques: Array
) -> tuple[str, float, float, float] | None:
    """Find the joint whose motion a joint's effort follows in addition to its own, if any does.

    Returns its name, the ratio ``s``, and the rms residual without and with it: friction and rotor
    inertia of such a motor follow ``q_i + s q_j``. ``torques`` ``(k, n)`` are the nominal
    rigid-body torque and its deviations along the log. By the Bayesian information criterion of as
    many independent outputs as the residual has, ratios and joints equally likely.
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
    return joints[other], float(ratio), before, after
