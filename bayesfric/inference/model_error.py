"""How much further the numbers may be off because the model is not exactly right.

A posterior takes the model for true; it says how well its best values are known on this motion.
Where the model is wrong, another motion has other best values. How far they may lie shows within
one recording: its outputs are sorted into quarters along each axis of the motion (slow to fast,
unloaded to loaded, one end of the path to the other, ...), and each quarter asked whether the
common fit suits it. Noise lets quarters differ by a known amount; what they differ by beyond it is
model error, and carries over to the parameters by the cluster-robust covariance [1]_ with residuals
adjusted for what each quarter itself contributed to the fit [2]_, so that without model error it is
the posterior's own. The share of it that noise does not explain, ``1 - 1/F`` of the F test that one
fit suits all quarters, is model error. Where the model is wrong, as what else explains the torque
says (:mod:`bayesfric.diagnostics.missing`; where that could not be asked, quarters that differ by
more than chance along any axis), the model error of all axes, summed, widens what the data say of
the draws (priors stay as narrow as they are told), in coordinates where bounds hold [3]_. All this
takes the torque for linear, and so it is done in straight coordinates (``Target.straighten``: in
the sampled ones a knee's torque is bent within a fraction of a sd); a draw that is moved to where
it fits far worse than it should is moved by less.

A few outputs that no noise explains would hide all this, as what they leave passes for noise: where
there are such (:mod:`bayesfric.inference.outlying`), it is asked anew without them, and the answer
that widens more is taken.

Clusters in time cannot do this: the misfit repeats with the motion, and is the same in every period
of it.

References
----------
.. [1] P. J. Huber, "The behavior of maximum likelihood estimates under nonstandard conditions",
   Proc. 5th Berkeley Symp. 1 (1967) 221-233; K.-Y. Liang, S. L. Zeger, Biometrika 73 (1986) 13-22.
.. [2] R. M. Bell, D. F. McCaffrey, "Bias reduction in standard errors for linear regression with
   multi-stage samples", Survey Methodology 28 (2002) 169-181.
.. [3] B. A. Shaby, "The open-faced sandwich adjustment for MCMC using estimating functions",
   J. Comput. Graph. Stat. 23 (2014) 853-876.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.outlying import Outlying, outlying
from bayesfric.inference.posterior import Posterior
from bayesfric.inference.target import Target
from bayesfric.mechanism.parameter import effort_words
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]
Reason = Literal["likelihood", "sampling", "few"]

# Groups along an axis; with more, each sees too little of the motion to be misled by it.
_GROUPS = 4
# Fewer recordings are no sample of the recordings there could be.
_RECORDINGS = 3
# Chance of differences like these, were the model right, below which they are model error.
_SELDOM = 0.01
# Draws that tell where the posterior lies; and step to either side, in its sds.
_DRAWS, _STEP = 4000, 0.3
# What chi squared of a moved draw may be of what is foretold of it, an order of magnitude; and how
# often a move that fits worse is halved.
ALLOWED, _HALVINGS = 10.0, 12
# Outputs a group and a parameter, at least, for a group to say anything.
_LEAST = 2
# What of a direction's information one group may hold, at most, before its residuals are not
# adjusted further; and at least, before it says anything of that direction.
_ALL, _NOTHING = 0.98, 1e-3


def wanted_outputs(parameters: int) -> int:
    """Count outputs without which no kind of motion has parts large enough to ask."""
    return _GROUPS * _LEAST * parameters


@dataclass(frozen=True)
class Axis:
    """One way to sort the outputs of all recordings into groups."""

    name: str
    groups: int
    p_value: float  # how often the groups differ as much where the model is right

    @property
    def differs(self) -> bool:
        """Whether its groups differ by more than noise lets them."""
        return self.p_value < _SELDOM


@dataclass(frozen=True, eq=False)
class ModelError:
    """What groups of the motion say of the model; ``reason`` is why they say nothing."""

    axes: tuple[Axis, ...]
    root: Array  # (d, d) root of the covariance added to draws, in straight coordinates
    # (d, d) chi squared of a move in these coordinates, were the torque linear in them
    misfit: Array
    reason: Reason | None = None
    outlying: tuple[Outlying, ...] = ()  # outputs that are too far off, the farthest first
    set_aside: bool = False  # whether they are left out of what ``axes`` and ``root`` say
    wrong: bool | None = None  # whether the model is wrong, where something else has told

    @cached_property
    def shown(self) -> bool:
        """Whether the recordings show any."""
        return self.reason is None and _shown(self.wrong, self.axes)

    def widened(self, target: Target, parameters: Array, rng: np.random.Generator) -> Array:
        """Move draws of the posterior ``(n, d)`` by as much as the model may be off."""
        if not self.shown:
            return parameters
        u, _ = target.straighten(target.from_parameters(parameters))
        step = rng.standard_normal(u.shape) @ self.root.T
        found, left = parameters.copy(), np.arange(len(u))
        before = target.log_likelihood(parameters)
        for _ in range(_HALVINGS):
            moved, slope = target.to_parameters(target.bend(u[left] + step[left]))
            possible = np.isfinite(slope) & np.isfinite(moved).all(axis=1)
            # not every coordinate ends where a prior does
            possible[possible] = np.isfinite(target.log_prior(moved[possible]))
            worse = np.full(left.size, np.inf)
            if possible.any():
                likely = target.log_likelihood(moved[possible])
                worse[possible] = 2.0 * (before[left[possible]] - likely)
            foretold = np.einsum("ni,ij,nj->n", step[left], self.misfit, step[left])
            # besides, the move meets what a draw's own misfit is
            fine = worse <= ALLOWED * (foretold + u.shape[1])
            found[left[fine]] = moved[fine]
            left = left[~fine]
            step[left] *= 0.5
            if not left.size:
                break
        # so far out that it has no counterpart: stays where it was
        return found


def _shown(wrong: bool | None, axes: Sequence[Axis]) -> bool:
    return any(axis.differs for axis in axes) if wrong is None else wrong


def model_error(target: Target, posterior: Posterior, wrong: bool | None = None) -> ModelError:
    """Ask groups of the motion how far the model may be off; nothing is sampled.

    ``wrong`` says whether it is; left out, the groups tell.
    """
    d = len(target.names)
    reason: Reason | None = None
    if not isinstance(target.likelihood, TorqueLikelihood):
        reason = "likelihood"
    elif posterior.diagnostics.status == "unusable":
        reason = "sampling"
    else:
        whole = _whitened(target, target.likelihood, posterior)
        return _asked(whole, target.likelihood, d, wrong)
    return ModelError((), np.zeros((d, d)), np.zeros((d, d)), reason)


def _asked(
    whole: _Whitened, likelihood: TorqueLikelihood, d: int, wrong: bool | None = None
) -> ModelError:
    """Ask with all outputs, and without those that are too far off for noise."""
    found: tuple[Outlying, ...] = ()
    clean = np.ones(whole.residual.size, dtype=np.bool_)
    if likelihood.noise.gaussian:  # else the noise has room for them
        seen = (whole.residual, likelihood.observations)
        found, clean = outlying(
            *seen, whole.rank // len(likelihood.observations), likelihood.noise.order
        )
    every, wide = _of_groups(whole, np.ones_like(clean), likelihood, d, wrong)
    if not found:
        return every
    less, wider = _of_groups(whole, clean, likelihood, d, wrong)
    # where neither widens, what few outputs cannot sway is the better answer
    aside = less.reason is None and wider >= wide
    return replace(less if aside else every, outlying=found, set_aside=aside)


def _of_groups(
    whole: _Whitened, kept: Flags, likelihood: TorqueLikelihood, d: int, wrong: bool | None = None
) -> tuple[ModelError, float]:
    """Ask some of the outputs; the second is by how much that widens, in posterior variances."""
    k = len(whole.root)
    fit, excess = whole.only(kept), np.zeros((k, k))
    root, misfit = np.zeros((d, d)), np.zeros((d, d))
    axes: list[Axis] = []
    for name, groups in _axes(whole.predicted, likelihood.observations):
        found = _spread(fit, groups[kept])
        if found is None:
            continue
        motion = likelihood.chain.motor_motion
        axes.append(Axis(effort_words(name, motion), int(groups.max()) + 1, found[1]))
        excess += found[0]
    added = 0.0
    if _shown(wrong, axes):
        # in posterior variances, whatever the coordinates are in
        values, vectors = np.linalg.eigh(_beside(whole.prior, excess))
        values = np.clip(values, 0.0, None)
        root[:k, :k] = whole.root @ (vectors * np.sqrt(values))
        misfit[:k, :k], added = whole.misfit, float(values.sum())
    return ModelError(tuple(axes), root, misfit, None if axes else "few", wrong=wrong), added


@dataclass(frozen=True, eq=False)
class _Whitened:
    """The fit as a linear regression in unit noise and unit posterior."""

    rows: Array  # (n, k) what outputs change by for one posterior sd, in orthogonal directions
    residual: Array  # (n,) what the best fit leaves
    rank: int  # directions that the outputs tell anything of
    predicted: Array  # (n,) outputs there, as measured, N m or N
    root: Array  # (k, k) from those directions to straight coordinates
    prior: Array  # (k, k) what the priors alone tell of those directions, of one posterior's

    @property
    def misfit(self) -> Array:
        """Chi squared of a move in straight coordinates, ``(k, k)``."""
        back = np.linalg.inv(self.root)
        return np.asarray(back.T @ (self.rows.T @ self.rows) @ back)

    def only(self, kept: Flags) -> _Whitened:
        """Fit some of the outputs anew."""
        if kept.all():
            return self
        rows, (residual, rank) = self.rows[kept], _refitted(self.rows[kept], self.residual[kept])
        predicted = self.predicted[kept]
        return replace(self, rows=rows, residual=residual, rank=rank, predicted=predicted)


def _whitened(target: Target, likelihood: TorqueLikelihood, posterior: Posterior) -> _Whitened:
    k = len(target.free)
    u, _ = target.straighten(target.from_parameters(posterior.flat(_DRAWS)))
    u = u[np.isfinite(u).all(axis=1)]
    centre = u.mean(axis=0)
    root = np.linalg.cholesky(np.atleast_2d(np.cov(u[:, :k].T)))
    # central differences over a sizeable step: what a kink does to a draw counts, not its slope
    steps = np.zeros((2 * k + 1, u.shape[1]))
    steps[:k, :k], steps[k : 2 * k, :k] = _STEP * root.T, -_STEP * root.T
    parameters, _ = target.to_parameters(target.bend(centre + steps))
    predicted = likelihood.predict(target.chain_values(parameters))
    scales = target.noise.scales(parameters[-1:, k:])[0]
    changes = [(p[:k] - p[k : 2 * k]) / (2.0 * _STEP) for p in predicted]
    left = [o.measured - p[-1] for o, p in zip(likelihood.outputs, predicted, strict=True)]
    rows = np.concatenate(likelihood.innovations(changes, scales), axis=1).T
    residual = np.concatenate(likelihood.innovations(left, scales))
    # a posterior's centre is not quite where outputs fit best, and that is no misfit
    residual, rank = _refitted(rows, residual)
    return _Whitened(
        rows=rows,
        residual=residual,
        rank=rank,
        predicted=np.concatenate([p[-1] for p in predicted]),
        root=root,
        prior=_of_priors(target, centre, steps[:k]),
    )


def _of_priors(target: Target, centre: Array, steps: Array) -> Array:
    """Tell what priors say of steps ``(k, d)`` from the centre: curvature, ``(k, k)``, 0 to 1."""
    both = steps[:, None] + steps[None]
    corners = np.stack([both, steps[:, None] - steps[None]])
    at = centre + np.concatenate([corners, -corners])
    parameters, slope = target.to_parameters(target.bend(at.reshape(-1, centre.size)))
    told = np.full(slope.size, np.nan)
    possible = np.isfinite(slope) & np.isfinite(parameters).all(axis=1)
    told[possible] = target.log_prior(parameters[possible])
    along, against, back, across = told.reshape(at.shape[:-1])
    bend = -(along - against + back - across) / (4.0 * _STEP**2)
    # a bound within a step says where a draw may not go, not how far the data may be off
    values, vectors = np.linalg.eigh(np.where(np.isfinite(bend), bend, 0.0))
    return np.asarray((vectors * np.clip(values, 0.0, 1.0)) @ vectors.T)


def _beside(prior: Array, excess: Array) -> Array:
    """Leave what priors tell as it is: model error is in what the data tell, ``(k, k)``."""
    one = np.eye(len(prior))
    data = one - prior
    return np.asarray(np.linalg.inv(prior + data @ np.linalg.pinv(data + excess) @ data) - one)


def _refitted(rows: Array, residual: Array) -> tuple[Array, int]:
    """Fit all directions that the outputs tell best: what that leaves, and how many they are."""
    share, directions = np.linalg.eigh(rows.T @ rows)
    told = directions[:, share > _NOTHING]
    best = told @ ((told.T @ (rows.T @ residual)) / share[share > _NOTHING])
    return residual - rows @ best, told.shape[1]


def _axes(predicted: Array, observations: Sequence[Observation]) -> Iterator[tuple[str, Index]]:
    """Sort outputs along everything that a motion has, into groups ``(n,)`` of each axis."""

    def seen(name: str) -> Array:
        return np.concatenate([getattr(o, name)[o.filter.centres] for o in observations])

    velocity, acceleration = seen("qd"), np.concatenate([o.acceleration for o in observations])
    along = {
        "position": seen("q"),
        "velocity": velocity,
        "speed": np.abs(velocity),
        "acceleration": acceleration,
        "speeding up or braking": np.sign(velocity) * acceleration,
        "torque": predicted,
        "size of the torque": np.abs(predicted),
        "power": velocity * predicted,
    }
    for name, values in along.items():
        ends = np.quantile(values, np.arange(1, _GROUPS) / _GROUPS)
        yield name, np.unique(np.searchsorted(ends, values), return_inverse=True)[1]
    if len(observations) >= _RECORDINGS:
        sizes = [o.measured.size for o in observations]
        yield "recording", np.repeat(np.arange(len(sizes)), sizes)


def _spread(whole: _Whitened, groups: Index) -> tuple[Array, float] | None:
    """Tell how far groups pull the fit beyond what noise does, and how often chance does that.

    The first is a covariance ``(k, k)`` in unit posterior, the second the p-value of the F
    test that all groups have the same parameters: F is one where they do, and one more than model
    error over noise where they do not. ``None`` where there are no two groups.
    """
    n, k = whole.rows.shape
    pulls, gained, asked = [], 0.0, 0
    for group in range(int(groups.max()) + 1):
        inside = groups == group
        if inside.sum() < _LEAST * k:
            continue
        rows = whole.rows[inside]
        score = rows.T @ whole.residual[inside]
        share, directions = np.linalg.eigh(rows.T @ rows)
        score = directions.T @ score
        told = share > _NOTHING
        gained += float(np.sum(score[told] ** 2 / share[told]))
        asked += int(told.sum())
        pulls.append(directions @ (score / np.sqrt(np.clip(1.0 - share, 1.0 - _ALL, None))))
    more = asked - whole.rank
    if len(pulls) < 2 or more <= 0 or n <= asked:
        return None
    left = float(whole.residual @ whole.residual) - gained
    ratio = (gained / more) / max(left / (n - asked), 1e-300)
    pulled = np.array(pulls)
    beyond = max(1.0 - 1.0 / ratio, 0.0) if ratio > 0.0 else 0.0
    return beyond * (pulled.T @ pulled), float(stats.f.sf(ratio, more, n - asked))
