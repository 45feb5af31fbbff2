"""Which terms the data ask for, one after the other."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import logsumexp

from bayesfric.estimates.torque import filtered_torque, torque_jacobian
from bayesfric.explain.candidates import Candidate, Key, candidates
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
# An exchange must be better by this, and there are so many at most.
_BETTER, _EXCHANGES = 1.0, 10
# Steps of derivatives, in sizes of what is there.
_STEP = 1e-6


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate beside one model."""

    candidate: Candidate  # at the value of its shape that suits best
    # log Bayes factor, the mean over what shapes it; and with white noise: the first says whether
    # it is there, the second which of two fits better
    evidence: float
    plain: float
    others: tuple[Candidate, ...]  # under other names, with the same effect on these motions
    columns: tuple[int, ...]
    direction: Array = field(repr=False)
    score: Score | None = None  # of the model with it

    def beaten_by(self, other: Trial) -> float:
        """By how much another is better, as sure as the noise between pieces of time allows."""
        share = self.evidence / self.plain if 0.0 < self.evidence < self.plain else 1.0
        return (other.plain - self.plain) * share

    @property
    def richness(self) -> tuple[int, bool]:
        """How much it says: its numbers; and of as many what every joint can have says least."""
        return len(self.candidate.chain.names), bool(self.candidate.owner)

    def odds(self, among: int) -> float:
        """Logarithm of the odds that it is missing, when one of so many is."""
        return self.evidence - math.log(among)


@dataclass(frozen=True, eq=False)
class Rung:
    """One model of the ladder: all terms of the rungs below, and one more."""

    added: Trial | None  # none for the model as it is
    score: Score
    rivals: tuple[Trial, ...] = ()  # what cannot be told from the added one


@dataclass(frozen=True, eq=False)
class Ladder:
    """From the model as it is to the best that these recordings ask for."""

    rungs: tuple[Rung, ...]
    tried: int  # candidates that these motions could show
    fitted: tuple[Trial, ...]  # strong on what is fitted, but predicting no better
    against: tuple[Trial, ...]  # those that these recordings speak against
    folds: tuple[str, ...]
    memory: Array  # of the noise

    @property
    def last(self) -> Rung:
        """The best."""
        return self.rungs[-1]


def searched(
    chain: Joint,
    observations: Sequence[Observation],
    point: Mapping[str, float],
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> Search:
    """Prepare a search among all candidates beside a chain with these parameters.

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
    usual = np.repeat([one.usual for one in found], [block.shape[1] for block in blocks])
    columns = prepared(base, others, target, observations, usual.astype(np.bool_))
    first = columns.white.shape[1] - 1 - others.shape[1]
    ends = first + np.cumsum([0] + [block.shape[1] for block in blocks])
    own = [tuple(range(a, b)) for a, b in pairwise(ends.tolist())]
    return Search(columns, list(range(first)), found, own)


def _effects(
    chain: Joint, observations: Sequence[Observation], values: Array, names: Sequence[str]
) -> Array:
    """Differentiate the filtered torque by some parameters, ``(n, len(names))``."""
    at = [chain.names.index(name) for name in names]
    steps = np.zeros(values.size)
    steps[at] = _STEP * np.maximum(np.abs(values[at]), 1.0)
    return torque_jacobian(chain, observations, values, steps)[:, at]


@dataclass(frozen=True, eq=False)
class Search:
    """What candidates are searched with."""

    columns: Columns
    base: list[int]
    found: Sequence[Candidate]
    own: Sequence[tuple[int, ...]]
    without: Collection[str] = ()
    weighed: dict[tuple[tuple[int, ...], ...], list[Trial]] = field(default_factory=dict)

    def climbed(self, without: Collection[str] = ()) -> Ladder:
        """Take the best, then the best with the others; candidates of some settings left out."""
        search = replace(self, without=without, weighed={}) if without else self
        return _climbed(search, len(self.beside([])))

    def at(self, chosen: Sequence[Trial]) -> list[int]:
        """Columns of the model with some terms."""
        return [*self.base, *(k for t in chosen for k in t.columns)]

    def beside(self, chosen: Sequence[Trial]) -> list[Trial]:
        """Weigh every candidate beside some terms, the best first; the same terms once."""
        key = tuple(t.columns for t in chosen)
        if key not in self.weighed:
            self.weighed[key] = _trials(self, chosen)
        return self.weighed[key]

    def score(self, chosen: Sequence[Trial]) -> Score:
        """Predict what is left out, with some terms."""
        return score(self.columns, self.at(chosen))


def _climbed(search: Search, among: int) -> Ladder:
    trials = search.beside([])
    chosen: list[Trial] = []
    fitted: dict[Key, Trial] = {}
    seen = {frozenset[tuple[int, ...]]()}
    while len(chosen) < _MOST:
        best = _best(search, chosen, trials, among, fitted)
        if best is None:
            break
        after = _settled(search, [*chosen, best], among)
        state = frozenset(t.columns for t in after)
        if state in seen:
            break  # what was exchanged before comes back
        seen.add(state)
        chosen, trials = after, search.beside(after)
    for t in chosen:
        fitted.pop(t.candidate.key, None)
    rungs = [Rung(None, search.score([]))]
    ordered = _in_order(search, chosen)
    for k, t in enumerate(ordered):
        others = [*ordered[:k], *ordered[k + 1 :]]
        rungs.append(Rung(t, search.score(ordered[: k + 1]), _rivals(search, others, t)))
    # what would do in the place of a term is not spoken against because that one is there
    alike = {o.candidate.key for rung in rungs for o in rung.rivals}
    rest = [t for t in trials if t.candidate.key not in {*fitted, *alike}]
    return Ladder(
        tuple(rungs),
        among,
        tuple(fitted.values()),
        tuple(t for t in rest if t.evidence < _AGAINST),
        search.columns.fold_names,
        search.columns.memory,
    )


def _best(
    search: Search,
    chosen: Sequence[Trial],
    trials: Sequence[Trial],
    among: int,
    fitted: dict[Key, Trial],
) -> Trial | None:
    """Give the strongest candidate that also predicts better; note those that do not."""
    below = search.score(chosen)
    for t in trials:
        if t.odds(among) <= _ODDS:
            continue
        found = search.score([*chosen, t])
        if compared(found, below)[0] > 0.0 and found.held_out < below.held_out:
            return _simplest(search, chosen, t, trials, among)
        fitted.setdefault(t.candidate.key, t)
    return None


def _simplest(
    search: Search, others: Sequence[Trial], best: Trial, trials: Sequence[Trial], among: int
) -> Trial:
    """Give the simplest of those that are about as good as the best, and predict better, too."""
    below = search.score(others)
    simplest = best
    for t in trials:
        if t.richness >= simplest.richness or t.odds(among) <= _ODDS:
            continue
        better, error = compared(search.score([*others, t]), below)
        if t.beaten_by(best) < _AS_GOOD and better > error:
            simplest = t
    return simplest


def _settled(search: Search, chosen: list[Trial], among: int) -> list[Trial]:
    """Exchange terms for better ones, and drop those that others have made needless."""
    for _ in range(_EXCHANGES):
        for t in chosen:
            others = [o for o in chosen if o is not t]
            trials = search.beside(others)
            mine = _of(trials, t)
            if mine is None or mine.odds(among) <= _ODDS:
                chosen = others
                break
            # of what is one on these motions, the simplest
            best = trials[0]
            if sure := best.odds(among) > _ODDS:
                best = _simplest(search, others, best, trials, among)
            renamed = mine is best and mine.candidate.key != t.candidate.key
            better = best.richness < mine.richness or mine.beaten_by(best) > _BETTER
            if renamed or (sure and better):
                chosen = [*others, best]
                break
        else:
            break
    return chosen


def _of(trials: Sequence[Trial], t: Trial) -> Trial | None:
    """Find the same term beside another model, under whatever name it goes there."""
    key = t.candidate.key
    for o in trials:
        if o.candidate.key == key or any(c.key == key for c in o.others):
            return o
    return None


def _in_order(search: Search, chosen: Sequence[Trial]) -> list[Trial]:
    """Sort terms by what each brings beside those before it."""
    left, ordered = list(chosen), list[Trial]()
    while left:
        trials = search.beside(ordered)
        found = [_of(trials, t) for t in left]
        k = int(np.argmax([o.plain if o else -math.inf for o in found]))
        t, o = left.pop(k), found[k]
        ordered.append(replace(t, evidence=o.evidence) if o else t)
    return ordered


def _rivals(search: Search, others: Sequence[Trial], t: Trial) -> tuple[Trial, ...]:
    """Give what could stand in the place of one term and is about as good."""
    trials = search.beside(others)
    mine = _of(trials, t)
    return tuple(
        replace(o, score=search.score([*others, o]))
        for o in trials
        if o is not mine and o.beaten_by(mine or t) < _AS_GOOD and o.evidence > _ODDS
    )


def _trials(search: Search, taken: Sequence[Trial]) -> list[Trial]:
    """Weigh every candidate beside what is chosen, the best first; what is one is one."""
    # of cycles there may be several
    having = {t.candidate.place for t in taken if t.candidate.option not in CYCLES}
    columns_of = {t.columns for t in taken}
    weighed: dict[Key, list[tuple[Candidate, Gain, tuple[int, ...]]]] = {}
    beside = search.at(taken)
    for one, mine in zip(search.found, search.own, strict=True):
        taken_up = one.place in having or mine in columns_of
        if taken_up or one.setting in search.without:
            continue
        g = gain(search.columns, beside, mine, one.sign)
        if g.dimensions:
            weighed.setdefault(one.key, []).append((one, g, mine))
    trials = []
    for shapes in weighed.values():
        # over what shapes it, each value as likely as the others
        less = math.log(len(shapes))
        evidence, plain = (
            float(logsumexp(kind) - less)
            for kind in zip(*((g.evidence, g.plain) for _, g, _ in shapes), strict=True)
        )
        one, g, mine = max(shapes, key=lambda x: x[1].evidence)
        trials.append(Trial(one, evidence, plain, (), mine, g.direction))
    # of two that do the same the first is named, not the one that rounding favours
    trials.sort(key=lambda t: -round(t.plain, 6))
    apart: list[Trial] = []
    for t in trials:
        for k, other in enumerate(apart):
            if abs(float(t.direction @ other.direction)) > _SAME:
                apart[k] = _one(other, t)
                break
        else:
            apart.append(t)
    return apart


def _one(trial: Trial, same: Trial) -> Trial:
    """Make one of two that do the same, under the name of the one with fewer parameters.

    With as many, a weight comes before a ripple: few motors have one that repeats once a turn.
    """
    ripple, other = (t.candidate.option in CYCLES for t in (trial, same))
    weight = same.candidate.owner == "load" and ripple and not other
    simpler = len(same.columns) < len(trial.columns) + weight
    if simpler and same.beaten_by(trial) < _AS_GOOD:
        trial, same = same, trial
    return replace(trial, others=(*trial.others, same.candidate, *same.others))


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
