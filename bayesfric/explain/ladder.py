"""Which terms the data ask for, one after the other."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import logsumexp

from bayesfric.estimates.torque import filtered_torque, torque_jacobian
from bayesfric.explain.candidates import Candidate, candidates
from bayesfric.explain.evidence import Columns, Gain, Score, gain, prepared, score
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import CYCLES
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]

# A term is asked for when it is this much more likely than not, when one of all is missing: what
# is not there is then found in at most one of twenty recordings, by Markov's inequality.
_ODDS = math.log(20.0)
# What cannot be told from the best: within this of its evidence, and not asked for beside it.
_AS_GOOD = 3.0
# Evidence against, less than which is none.
_AGAINST = -3.0
# Cosine from which two candidates are one, whatever they are called.
_SAME = 0.999
# A search that found this many terms explains nothing.
_MOST = 6
# Steps of derivatives, in sizes of what is there.
_STEP = 1e-6


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate beside one model."""

    candidate: Candidate  # at the value of its shape that suits best
    evidence: float  # log Bayes factor, the mean over what shapes it
    others: tuple[Candidate, ...]  # under other names, with the same effect on these motions
    columns: tuple[int, ...]
    direction: Array = field(repr=False)
    score: Score | None = None  # of the model with it

    def odds(self, among: int) -> float:
        """Logarithm of the odds that it is missing, when one of so many is."""
        return self.evidence - math.log(among)


@dataclass(frozen=True, eq=False)
class Rung:
    """One model of the ladder."""

    added: Trial | None  # what it has more than the one below; none for the model as it is
    chosen: tuple[Candidate, ...]  # all that it has more than the model as it is
    score: Score
    # difference of its held-out log density to the one below, and its standard error
    better: float = math.nan
    error: float = math.nan
    # what cannot be told from the added one
    rivals: tuple[Trial, ...] = ()


@dataclass(frozen=True, eq=False)
class Ladder:
    """From the model as it is to the best that these recordings ask for."""

    rungs: tuple[Rung, ...]
    tried: int  # candidates that these motions could show
    fitted: tuple[Trial, ...]  # strong on what is fitted, but predicting no better
    rest: tuple[Trial, ...]  # all others, beside the last model, best first
    against: tuple[Trial, ...]  # those that these recordings speak against
    folds: tuple[str, ...]
    memory: Array  # of the noise

    @property
    def last(self) -> Rung:
        """The best."""
        return self.rungs[-1]


def climb(
    chain: Joint,
    observations: Sequence[Observation],
    point: Mapping[str, float],
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> Ladder:
    """Try every candidate beside a chain with these parameters, then the best with the others.

    Near the point the torque is taken as linear in all parameters.
    """
    progress("effects of every term")
    values = chain.vector(point)
    base = _effects(chain, observations, values, chain.names)
    model = [filtered_torque(chain, o, values[None])[0] for o in observations]
    target = np.concatenate([o.measured for o in observations]) - np.concatenate(model)
    found = candidates(chain, observations, point)
    blocks = [
        _effects(one.chain, observations, one.chain.vector(one.point), one.new) for one in found
    ]
    seen = [k for k, block in enumerate(blocks) if block.any()]
    found, blocks = [found[k] for k in seen], [blocks[k] for k in seen]
    progress("held-out motion")
    others = np.concatenate(blocks, axis=1) if blocks else np.empty((target.size, 0))
    columns = prepared(base, others, target, observations)
    first = columns.white.shape[1] - 1 - others.shape[1]
    ends = first + np.cumsum([0] + [block.shape[1] for block in blocks])
    own = [tuple(range(a, b)) for a, b in pairwise(ends.tolist())]
    return _climbed(columns, list(range(first)), found, own)


def _effects(
    chain: Joint, observations: Sequence[Observation], values: Array, names: Sequence[str]
) -> Array:
    """Differentiate the filtered torque by some parameters, ``(n, len(names))``."""
    at = [chain.names.index(name) for name in names]
    steps = np.zeros(values.size)
    steps[at] = _STEP * np.maximum(np.abs(values[at]), 1.0)
    return torque_jacobian(chain, observations, values, steps)[:, at]


def _climbed(
    columns: Columns,
    base: list[int],
    found: Sequence[Candidate],
    own: Sequence[tuple[int, ...]],
) -> Ladder:
    chosen = list(base)
    taken: list[Candidate] = []
    rungs = [Rung(None, (), score(columns, chosen))]
    fitted: list[Trial] = []
    tried = 0
    while True:
        trials = _trials(columns, chosen, found, own, taken)
        tried = tried or len(trials)
        best = _best(columns, chosen, trials, tried, rungs[-1], fitted)
        if best is None or len(taken) == _MOST:
            break
        beside = [*chosen, *best.added.columns] if best.added else chosen
        after = _trials(columns, beside, found, own, [*best.chosen])
        strong = {t.candidate.key for t in after if t.odds(tried) > _ODDS}
        rivals = tuple(
            replace(t, score=score(columns, [*chosen, *t.columns]))
            for t in trials
            if best.added
            and t.candidate.key != best.added.candidate.key
            and t.evidence > best.added.evidence - _AS_GOOD
            and t.candidate.key not in strong
        )
        rungs.append(Rung(best.added, best.chosen, best.score, best.better, best.error, rivals))
        chosen, taken = beside, list(best.chosen)
    known = {t.candidate.key for t in fitted}
    rest = [t for t in trials if t.candidate.key not in known]
    return Ladder(
        tuple(rungs),
        tried,
        tuple(fitted),
        tuple(rest),
        tuple(t for t in rest if t.evidence < _AGAINST),
        columns.fold_names,
        columns.memory,
    )


def _trials(
    columns: Columns,
    chosen: Sequence[int],
    found: Sequence[Candidate],
    own: Sequence[tuple[int, ...]],
    taken: Sequence[Candidate],
) -> list[Trial]:
    """Weigh every candidate beside what is chosen, the best first; what is one is one."""
    # of cycles there may be several
    having = {(one.owner, one.option) for one in taken if one.option not in CYCLES}
    columns_of = {mine for one, mine in zip(found, own, strict=True) if one in taken}
    weighed: dict[tuple[str, str, str], list[tuple[Candidate, Gain, tuple[int, ...]]]] = {}
    for one, mine in zip(found, own, strict=True):
        if (one.owner, one.option) in having or mine in columns_of:
            continue
        g = gain(columns, chosen, mine, one.sign)
        if g.dimensions:
            weighed.setdefault(one.key, []).append((one, g, mine))
    trials = []
    for shapes in weighed.values():
        # over what shapes it, each value as likely as the others
        evidence = float(logsumexp([g.evidence for _, g, _ in shapes]) - math.log(len(shapes)))
        one, g, mine = max(shapes, key=lambda x: x[1].evidence)
        trials.append(Trial(one, evidence, (), mine, g.direction))
    trials.sort(key=lambda t: -t.evidence)
    apart: list[Trial] = []
    for t in trials:
        for k, other in enumerate(apart):
            if abs(float(t.direction @ other.direction)) > _SAME:
                names = (*other.others, t.candidate)
                apart[k] = replace(other, others=names)
                break
        else:
            apart.append(t)
    return apart


def _best(
    columns: Columns,
    chosen: Sequence[int],
    trials: Sequence[Trial],
    among: int,
    below: Rung,
    fitted: list[Trial],
) -> Rung | None:
    """Give the rung with the strongest candidate that also predicts better; note the others."""
    for t in trials:
        if t.odds(among) <= _ODDS:
            return None
        found = score(columns, [*chosen, *t.columns])
        better, error = compared(found, below.score)
        if better > 0.0 and found.held_out < below.score.held_out:
            return Rung(t, (*below.chosen, t.candidate), found, better, error)
        if t.candidate.key not in {one.candidate.key for one in fitted}:
            fitted.append(t)
    return None


def compared(one: Score, other: Score) -> tuple[float, float]:
    """Difference of two held-out log densities, and its standard error over the folds."""
    apart = one.folds - other.folds
    return float(apart.sum()), float(np.sqrt(apart.size) * apart.std(ddof=1))


def stacked(scores: Sequence[Score]) -> Array:
    """Weights of models whose mixture predicts best (Yao et al., Bayesian Analysis 13, 2018)."""
    density = np.stack([one.folds for one in scores], axis=1)
    density = density - density.max(axis=1, keepdims=True)

    def lost(x: Array) -> float:
        weights = np.exp(x - logsumexp(x))
        return -float(logsumexp(density, axis=1, b=weights).sum())

    found = minimize(
        lost, np.zeros(len(scores)), method="L-BFGS-B", bounds=[(-20.0, 20.0)] * len(scores)
    )
    return np.asarray(np.exp(found.x - logsumexp(found.x)))
