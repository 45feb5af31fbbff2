"""What would explain the residual, as everything shows it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesfric.errors import BadInput
from bayesfric.estimates.delay import Delay, alike, delays
from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.methods import Given
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.explain.candidates import Candidate
from bayesfric.explain.evidence import STRETCHES, Score
from bayesfric.explain.ladder import Ladder, Trial, compared, searched, stacked
from bayesfric.explain.told import Reason, sd_of, something, untold
from bayesfric.mechanism.presets import PRESETS
from bayesfric.mechanism.quantities import QUANTITIES
from bayesfric.recordings.measurement import Measurement
from bayesfric.templates import placed

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Term:
    """A term that a joint may lack."""

    phrase: str  # what it is called in a sentence
    owner: str  # the element, ``load``, or empty for the whole chain
    setting: str  # what a configuration says for it
    evidence: float  # natural logarithm of its Bayes factor beside the model it was tried with
    also: tuple[str, ...]  # settings that do the same to these motions
    rivals: tuple[Term, ...] = ()  # what it cannot be told from
    presets: tuple[str, ...] = ()  # those that have it, where the joint is another preset
    parameters: tuple[str, ...] = ()  # that it brings
    why: Reason | None = None  # it is not asked for though it fits better
    # whether its numbers are surely not nothing; else it is asked for as left-out motion is
    # predicted better by more than chance
    sure: bool = True

    @property
    def name(self) -> str:
        """What it is called, with its element."""
        return f"{self.phrase} ({self.owner})" if self.owner else self.phrase

    @property
    def table(self) -> str:
        """Table of a configuration that its line goes to."""
        return placed(self.setting)[0]

    @property
    def line(self) -> str:
        """Line to write under that table."""
        return placed(self.setting)[1]


@dataclass(frozen=True)
class Number:
    """A number that people quote, under one model."""

    value: float
    sd: float | None  # the larger of the plain and the robust one; none where nothing tells it
    unit: str
    at_bound: bool = False  # whether it stands on a limit, and has no sd for that


@dataclass(frozen=True)
class Model:
    """One model that was compared."""

    terms: tuple[Term, ...]  # what it has more than the model as it is, in the order of their gain
    rms: float  # of what it leaves of all that it was fitted to, N m or N
    taken: float  # share of the variance that the model as it is leaves
    held_out: float  # rms of what it leaves of motion that it was not fitted to, N m or N
    held_out_error: float  # its standard error
    better: float  # log density of held-out motion over that of the model as it is
    error: float  # standard error of that
    weight: float  # in the mixture that predicts best
    rival: bool  # whether it is no rung, but cannot be told from the last
    numbers: Mapping[str, Number]

    @property
    def name(self) -> str:
        """What it has more than the one before it."""
        if not self.terms:
            return "as it is"
        return f"{'instead' if self.rival else '+'} {self.terms[-1].name}"


@dataclass(frozen=True)
class Explanation:
    """What would explain the residual of a model.

    Attributes
    ----------
    asked
        Terms that the recordings ask for, the strongest first.
    fitted
        Terms that would fit better, and predict no better.
    untold
        Terms that would fit better, but whose values the recordings do not tell; each says why.
    against
        Terms that the recordings speak against.
    models
        The ladder: as it is, with the first term, with the first two, and so on; then the last
        one with each rival in its place.
    averaged
        Mean and sd of every number over the models that cannot be told apart.
    late
        By how much positions come late, of all recordings together, with the model as it is; and
        with the terms that are asked for, which may look late too. ``None`` where it does not
        matter, recordings contradict it, or the model has the delay as a parameter.
    """

    unit: str  # of the torque
    asked: tuple[Term, ...]
    fitted: tuple[Term, ...]
    against: tuple[Term, ...]
    models: tuple[Model, ...]
    averaged: Mapping[str, Number]
    tried: int
    folds: tuple[str, ...]  # what was left out in turn
    whole_recordings: bool  # whether that is recordings, or kinds of motion
    memory: tuple[float, ...]  # partial autocorrelations of the noise beside all terms
    untold: tuple[Term, ...] = ()
    late: tuple[Delay | None, Delay | None] = (None, None)

    @property
    def last(self) -> Model:
        """The last rung."""
        return [m for m in self.models if not m.rival][-1]

    @property
    def opening(self) -> Term | None:
        """What to write first of several terms, and then to ask again; see :func:`opening`."""
        return opening(self.asked, self.models[0].numbers)

    @property
    def of_times(self) -> bool:
        """Whether stretches of time were left out, for want of motions of several kinds."""
        return self.folds == STRETCHES

    @property
    def frame(self) -> pd.DataFrame:
        """A row for each model."""
        import pandas as pd

        rows = [
            {
                "terms": "; ".join(t.setting for t in m.terms),
                **{k: getattr(m, k) for k in ("rms", "taken", "held_out", "better", "error")},
                "weight": m.weight,
                "rival": m.rival,
                **{name: number.value for name, number in m.numbers.items()},
            }
            for m in self.models
        ]
        return pd.DataFrame(rows)

    def as_json(self) -> dict[str, Any]:
        """Give all of it as JSON holds it, with lists for tuples."""
        found: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return found


def opening(asked: Sequence[Term], known: Iterable[str]) -> Term | None:
    """Pick the load loss among several terms, where a model with ``known`` parameters has none.

    With one there are terms that cannot be tried without it, such as the square of the load: what
    else is asked for may stand for them.
    """
    if len(asked) < 2 or any(map(_of_load, known)):
        return None
    return next((t for t in asked if any(map(_of_load, t.parameters))), None)


def _of_load(name: str) -> bool:
    row = QUANTITIES.get(name.rpartition(".")[2])
    return row is not None and row.role == "loss"


# Outputs beyond two a parameter, or what is left out in turn is no motion to judge by.
_ENOUGH = 50


def too_few_outputs(given: Given) -> bool:
    """Whether there are too few outputs to look for anything."""
    return sum(o.measured.size for o in given.observations) < _wanted(given)


def _wanted(given: Given) -> int:
    return 2 * len(given.chain.names) + _ENOUGH


def explain(
    given: Given,
    point: Mapping[str, float],
    recordings: Sequence[Measurement] = (),
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> Explanation:
    """Look for what the model of ``given`` lacks; ``point`` is an estimate of its parameters.

    ``recordings``, where they are given, are those of the observations, and timed.

    Raises
    ------
    BadInput
        If there are too few outputs.
    """
    if too_few_outputs(given):
        outputs = sum(o.measured.size for o in given.observations)
        lasted = sum(float(o.stamps[-1] - o.stamps[0]) for o in given.observations)
        wanted = _wanted(given)
        several = "" if len(given.observations) > 1 else ", or give several recordings"
        still = sum(int(o.settings.get("dropped_dead_zone", 0)) for o in given.observations)
        moving = f"; keep it moving: at {still} more it is at rest" if still > outputs else ""
        raise BadInput(
            ", ".join(f"recording {o.name!r}" for o in given.observations),
            f"{outputs} outputs are too few to tell what a model lacks, which takes {wanted}",
            f"record {lasted * wanted / outputs:.2g} s of such motion{several}{moving}",
        )
    found = _found(given, point, progress)
    progress("values under every model")
    ladder, estimates = found.ladder, found.estimates
    first = ladder.rungs[0].score
    rungs = list(ladder.rungs)
    terms = [tuple(r.added for r in rungs[1 : k + 1] if r.added) for k in range(len(rungs))]
    for rival in found.rivals:
        assert rival.score is not None
        rungs.append(replace(ladder.last, added=rival, score=rival.score))
        terms.append((*terms[len(ladder.rungs) - 1][:-1], rival))
    weights = stacked([rung.score for rung in rungs])
    models = []
    for k, (rung, added, weight) in enumerate(zip(rungs, terms, weights.tolist(), strict=True)):
        known = estimates.get(_settings(added))
        _, estimate = known or _estimated(given, point, [t.candidate for t in added])
        better, error = compared(rung.score, first) if added else (0.0, 0.0)
        models.append(
            Model(
                tuple(_term(t) for t in added),
                rung.score.rms,
                1.0 - (rung.score.rms / first.rms) ** 2 if first.rms > 0.0 else 0.0,
                rung.score.held_out,
                rung.score.held_out_error,
                better,
                error,
                weight,
                k >= len(ladder.rungs),
                _numbers(estimate),
            )
        )
    alike = [m for m in models if m.rival] + [[m for m in models if not m.rival][-1]]
    return Explanation(
        "N m" if given.chain.motor_motion == "rotary" else "N",
        found.asked,
        tuple(_term(t) for t in ladder.fitted) + found.refused("worse"),
        tuple(_term(t) for t in ladder.against),
        tuple(models),
        _averaged(alike) if len(alike) > 1 else {},
        ladder.tried,
        ladder.folds,
        ladder.folds == tuple(o.name for o in given.observations),
        tuple(ladder.memory.tolist()),
        untold=found.refused("zero", "shape", "negative"),
        late=_late(given, point, recordings, found),
    )


def _late(
    given: Given, point: Mapping[str, float], recordings: Sequence[Measurement], found: _Found
) -> tuple[Delay | None, Delay | None]:
    """Tell the delay that matters without the ladder's terms, and with them."""
    if not recordings or given.chain.delay:
        return None, None

    def matters(given: Given, point: Mapping[str, float]) -> Delay | None:
        every = delays(given, recordings, point)
        return every[-1] if every and every[-1].matters and alike(every) else None

    before = matters(given, point)
    added = [rung.added for rung in found.ladder.rungs if rung.added]
    if before is None or not added:
        return before, before
    beside, estimate = found.estimates[_settings(added)]
    return before, matters(beside, dict(estimate.point))


@dataclass(frozen=True, eq=False)
class _Found:
    """A ladder of terms whose values the recordings tell."""

    ladder: Ladder
    rivals: tuple[Trial, ...]  # of the last, with values that the recordings tell
    without: Sequence[tuple[Trial, Reason]]  # what they do not
    # models with so many terms more, and their estimates, that were made for that: the last rung's
    # is among them
    estimates: Mapping[tuple[str, ...], tuple[Given, Estimate]]

    @property
    def asked(self) -> tuple[Term, ...]:
        rungs = self.ladder.rungs
        others = [*(r.rivals for r in rungs[:-1]), self.rivals]
        pairs = [(r.added, o) for r, o in zip(rungs, others, strict=True) if r.added]
        last = self.estimates.get(_settings([t for t, _ in pairs]))
        return tuple(
            replace(_term(t, o), sure=last is not None and something(t.candidate, last[1]))
            for t, o in pairs
        )

    def refused(self, *reasons: Reason) -> tuple[Term, ...]:
        """Give what is refused for these reasons."""
        return tuple(replace(_term(t), why=why) for t, why in self.without if why in reasons)


def _found(
    given: Given,
    point: Mapping[str, float],
    progress: Callable[[str], None] = lambda _: None,
) -> _Found:
    """Climb, and climb anew without each term whose value is not told."""
    search = searched(given.chain, given.observations, point, progress=progress)
    without: list[tuple[Trial, Reason]] = []
    estimates: dict[tuple[str, ...], tuple[Given, Estimate]] = {}

    def why_not(
        added: Sequence[Trial], k: int, rivals: Sequence[Trial], after: Score, before: Score
    ) -> Reason | None:
        one = added[k].candidate
        key = _settings(added)
        if key not in estimates:  # every rung of a ladder is asked of the same model
            estimates[key] = _estimated(given, point, [t.candidate for t in added])
        beside, estimate = estimates[key]
        # a richer choice is there for what a simpler one cannot do as well
        simpler = any(
            (o.candidate.owner, o.candidate.option) == (one.owner, one.option)
            and len(o.candidate.new) < len(one.new)
            for o in rivals
        )
        if simpler and not something(one, estimate):
            return "zero"
        return untold(one, beside.chain, estimate, given.observations, after, before)

    while True:
        alike = [one for t, _ in without for one in (t.candidate, *t.others)]
        ladder = search.climbed({one.setting for one in alike})
        rungs, added = ladder.rungs, [r.added for r in ladder.rungs if r.added]
        # the weakest comes last, and may be what spoils another's value
        for k in reversed(range(len(added))):
            here, below = rungs[k + 1], rungs[k]
            if why := why_not(added, k, here.rivals, here.score, below.score):
                without.append((added[k], why))
                break
        else:
            break
    rivals = tuple(
        t
        for t in ladder.last.rivals
        if t.score and not why_not([*added[:-1], t], -1, (), t.score, rungs[-2].score)
    )
    return _Found(ladder, rivals, without, estimates)


def _settings(added: Sequence[Trial]) -> tuple[str, ...]:
    return tuple(t.candidate.setting for t in added)


def _term(t: Trial, rivals: Sequence[Trial] = ()) -> Term:
    one = t.candidate
    also = tuple(dict.fromkeys(other.setting for other in _simplest(one, t.others)))
    others = tuple(_term(other) for other in rivals)
    presets = tuple(_having(one))
    return Term(one.phrase, one.owner, one.setting, t.evidence, also, others, presets, one.brings)


def _having(one: Candidate) -> Iterator[str]:
    """Name other presets of the same ratio whose load is like that of the chain with a term."""
    load = one.chain.load
    if one.owner != load.name or one.chain.made_from not in PRESETS:
        return
    for name, preset in PRESETS.items():
        chain = preset.chain()
        alike = chain.ratio == one.chain.ratio and name != one.chain.made_from
        if alike and load.choices.items() <= chain.load.choices.items():
            yield name


def _simplest(one: Candidate, others: Sequence[Candidate]) -> Iterator[Candidate]:
    """Leave out richer choices of the same option.

    Two losses that come out alike are the one loss: they do the same only as far as they hold it.
    """
    least: dict[tuple[str, str], int] = {}
    for candidate in (one, *others):
        place = candidate.owner, candidate.option
        least[place] = min(len(candidate.new), least.get(place, len(candidate.new)))
    for candidate in others:
        if len(candidate.new) == least[candidate.owner, candidate.option]:
            yield candidate


def _estimated(
    given: Given, point: Mapping[str, float], added: Sequence[Candidate]
) -> tuple[Given, Estimate]:
    """Fit a model with some terms more, from where it is without them."""
    chain, start = given.chain, dict(point)
    for one in added:
        chain = one.added_to(chain)
        start |= {name: one.point[name] for name in chain.names if name not in start}
    start = {name: start[name] for name in chain.names}
    known = given.knowledge
    knowledge = Knowledge(
        {name: x for name, x in known.fixed.items() if name in start},
        {name: x for name, x in known.bounds.items() if name in start},
        {name: x for name, x in known.told.items() if name in start},
    )
    beside = replace(given, chain=chain, knowledge=knowledge)
    return beside, input_error(chain, given.observations, knowledge, given.options, start)


def _numbers(estimate: Estimate) -> dict[str, Number]:
    """Take what people quote: parameters, and what the motor feels where these are open."""
    values = [v for v in estimate.values if v.kind == "parameter"]
    if any(not v.determined for v in values):
        values += [v for v in estimate.values if v.kind == "derived" and v.gauge_free]
    return {v.name: Number(v.value, sd_of(v), v.unit, v.at_bound is not None) for v in values}


def _averaged(models: Sequence[Model]) -> dict[str, Number]:
    """Mean and sd of the mixture of models that cannot be told apart, of what all of them have."""
    names = [
        n
        for n in models[0].numbers
        if all(n in m.numbers and m.numbers[n].sd is not None for m in models)
    ]
    weights = np.array([max(m.weight, 1e-12) for m in models])
    weights /= weights.sum()
    found = {}
    for name in names:
        value = np.array([m.numbers[name].value for m in models])
        sd = np.array([m.numbers[name].sd for m in models], dtype=np.float64)
        mean = float(weights @ value)
        spread = float(np.sqrt(weights @ (sd**2 + (value - mean) ** 2)))
        found[name] = Number(mean, spread, models[0].numbers[name].unit)
    return found
