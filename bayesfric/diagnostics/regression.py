"""What else explains the torque: one regression, judged by the recording's own replicates.

Beside the model's own columns, its torque's derivatives by its parameters at an estimate, stand
those of :mod:`bayesfric.diagnostics.candidates`. All pass the parallel filter of the measured
torque, are whitened by one noise, and are asked for what is left when the model's own are taken
out. The replicates give the mean and spread of each candidate where the model is right, and what chance
makes of the largest of all (Rubin, Annals of Statistics 12, 1984; Gelman, Meng and Stern,
Statistica Sinica 6, 1996; Westfall and Young, Resampling-Based Multiple Testing, 1993). What
exceeds that goes in, the one that explains most first, and the others compete for what is left.

The noise is chosen on what is left once everything that white noise would not do is taken: on the
plain residual its memory would swallow the effect. Each replicate's is chosen on itself.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import ndtri

from bayesfric.diagnostics.along import Along, Scales, scales_of
from bayesfric.diagnostics.candidates import (
    BY_NAME,
    KINDS,
    SMOOTHED,
    columns_along,
    filtered_columns,
)
from bayesfric.diagnostics.memory import WHITE, Layout, Memory, memory_of
from bayesfric.diagnostics.policy import (
    ALIKE,
    BETTER,
    FALSE_ALARMS,
    LEAST_OUTPUTS,
    MOST,
    TESTABLE,
    REPLICATES,
)
from bayesfric.diagnostics.scans import DELAYS, PUSH, TONE, Scan, bump, tuned, waves
from bayesfric.diagnostics.statistics import (
    HALF,
    OPEN,
    Columns,
    Key,
    asked,
    basis_of,
    mean_square,
    scored,
    solved,
    testable,
    unit_scores,
    without,
)
from bayesfric.diagnostics.replicates import ReplicateError, replicates
from bayesfric.estimates.torque import filtered_torque, torque_jacobian, typical_load
from bayesfric.inference.missing import Missing
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import Observation
from bayesfric.recordings.processing import Processing

# Step of a derivative, as a share of a parameter.
_STEP = 1e-6
# Share of a quantity's direction that must be determined.
_TOLD = 0.999
# Widest share of a parameter by which replicates' truths differ.
_WIDEST = 0.1
# Share of the replicates that must have come out.
_ENOUGH = 0.5
# Most that is taken out while noise is chosen, and what each costs there: twice the log of how
# many candidates there are.
_PICKS, _DEAR = 8, 10.0
# Hz below which a tone may be the noise's wander.
_SLOW = 1.0


@dataclass(frozen=True, eq=False)
class Choice:
    """What one round chose, and all that it knew."""

    # The candidate
    kind: str
    shape: str
    own: list[int]  # Numbers of its columns
    sure: bool  # Whether it is no chance
    # Its statistic as a standard normal; and (1 + k) / (n + 1) where k of n replicates have one as
    # large, of whichever candidate
    z: float
    p: float
    # z of all candidates, and what it must exceed
    largest: float
    limit: float
    # Of every candidate, scans last: its gain, less the log of the number of outputs for each
    # coefficient, shape or place after the first
    worth: Array
    scan: Scan | None = None  # Where a tone, push or far delay was found


@dataclass(frozen=True, eq=False)
class Replicate:
    """A simulated recording whose truth is known, and whose torque has no noise."""

    values: Array  # (n_parameters,) it was made with
    # (n, n_parameters) derivatives of its outputs there, and (n,) what the model leaves of its
    # torque: the error of encoder and filters
    base: Array
    left: Array
    layout: Layout  # Where its outputs lie in time


@dataclass(frozen=True, eq=False, kw_only=True)
class Step(Choice):
    """One candidate that is taken in."""

    share: float  # Root mean square of its torque over that of all torque
    # What a push is in, and its seconds; the recording also of what is one recording's alone
    recording: str
    span: tuple[float, float] | None
    coefficients: Array  # Of its own columns
    # Parameter or derived quantity: by how many of its standard deviations it moves, where the
    # recordings determine it
    moves: dict[str, float]
    alike: tuple[str, ...]  # Kinds that explain as much, or look alike on this motion


@dataclass(eq=False)
class Regression:
    """Recordings, replicates and everything that is computed once.

    Shapes: ``values`` (n_parameters,).
    """

    chain: Joint
    recordings: Sequence[Measurement]
    observations: Sequence[Observation]
    processing: Processing
    values: Array
    known: Collection[str] = ()
    seed: int = 0
    number: int = REPLICATES
    scales: Scales = field(init=False)
    data: Columns = field(init=False)
    replicates: list[Columns] = field(init=False)
    simulated: tuple[Replicate, ...] = field(init=False)
    _placed_scans: list[tuple[str, tuple[int, ...]]] = field(init=False, default_factory=list)
    _sure_kinds: set[str] = field(init=False, default_factory=set)

    def __post_init__(self) -> None:
        draws, others, noise = np.random.SeedSequence(self.seed).spawn(3)
        self.scales = scales_of(self.chain, self.values, self.observations)
        self.data = self._columns(self.values, self.observations)
        self._groups = testable(self.data)
        pairs = zip(self.observations, self.recordings, strict=True)
        along = [Along(self.chain, self.values, o, r, self.scales) for o, r in pairs]
        self._smoothed = f"{max(a.smoothed_at() for a in along):.3g} Hz"
        vectors = self._near(np.random.default_rng(draws))
        made = [(v, self._columns(v, seen)) for v, seen in self._twins(vectors, others)]
        self.simulated = tuple(Replicate(v, t.base, t.left, t.layout) for v, t in made)
        self.replicates = [replicate for _, replicate in made]
        if len(self.replicates) < _ENOUGH * self.number:
            raise ReplicateError("with parameters like these it hardly moves")
        self._clean = [replicate.left for replicate in self.replicates]
        self._choose_noise(noise)

    # What is compared

    @property
    def _sizes(self) -> Array:
        """What counts as a change of one of each parameter ``(d,)``."""
        return np.maximum(np.abs(self.values), 1e-12)

    def _own(self, values: Array, observations: Sequence[Observation]) -> Columns:
        """Make the model's columns of recordings, at parameters ``(n_parameters,)``."""
        chain = self.chain
        free = np.array([name not in self.known for name in chain.names])
        steps = free * _STEP * np.maximum(np.abs(values), 1.0)
        base = torque_jacobian(chain, observations, values, steps)
        left = [o.measured - filtered_torque(chain, o, values[None])[0] for o in observations]
        nothing = np.empty((len(base), 0))
        return Columns(base, nothing, np.concatenate(left), Layout.of(observations), ())

    def _columns(self, values: Array, observations: Sequence[Observation]) -> Columns:
        """Put those of candidates beside them."""
        blocks = []
        for o, r in zip(observations, self.recordings, strict=True):
            made = dict(columns_along(Along(self.chain, values, o, r, self.scales)))
            blocks.append(filtered_columns(o, list(made.values())))
        own = self._own(values, observations)
        return replace(own, others=np.concatenate(blocks), keys=tuple(made))

    def _near(self, rng: np.random.Generator) -> Array:
        """Draw vectors ``(number, n_parameters)`` that the recordings hold possible.

        From the estimate's normal; its open directions are left out.
        """
        size = self._sizes
        rows = self.data.base * size
        variance = mean_square(without(basis_of(self.data.base), self.data.left), rows.shape[1])
        power, vectors = np.linalg.eigh(rows.T @ rows)
        told = power > OPEN * power.max()
        sds = np.minimum(np.sqrt(variance / power[told]), _WIDEST)
        drawn = rng.standard_normal((self.number, int(told.sum()))) * sds
        lower = np.array([p.lower for p in self.chain.parameters])
        return np.asarray(np.maximum(self.values + (drawn @ vectors[:, told].T) * size, lower))

    def _twins(
        self, vectors: Array, stream: np.random.SeedSequence
    ) -> Iterator[tuple[Array, list[Observation]]]:
        """Make a replicate at each vector, unless the filters leave too few outputs."""
        parts = []
        for r, o, one in zip(
            self.recordings, self.observations, stream.spawn(len(self.recordings)), strict=True
        ):
            seeds = one.spawn(len(vectors))
            parts.append(replicates(self.chain, vectors, r, o, self.processing, seeds))
        for values, seen in zip(vectors, zip(*parts, strict=True), strict=True):
            made = [o for o in seen if o is not None]
            least = len(self.chain.names) + LEAST_OUTPUTS
            if len(made) == len(seen) and sum(o.measured.size for o in made) >= least:
                yield values, made

    # Noise

    def _choose_noise(self, stream: np.random.SeedSequence) -> None:
        """Give replicates the noise of what is left when all is taken that is there by white noise."""
        self._add_noise(WHITE, [], stream)
        taken: list[list[int]] = [[]]
        for choice, extra in self._climbed(_PICKS, choosing=True):
            if not choice.sure:
                break
            taken.append([*extra, *choice.own])
        best = math.inf
        for picks, extra in enumerate(taken):
            memory, bic = _memory(self.data, extra)
            bic += len(extra) * math.log(self.data.left.size) + _DEAR * picks
            if bic < best:
                best, self.noise, chosen = bic, memory, extra
        self._add_noise(self.noise, chosen, stream)
        self.replicates = [replace(t, memory=_memory(t, chosen)[0]) for t in self.replicates]

    def _add_noise(
        self, memory: Memory, extra: Sequence[int], stream: np.random.SeedSequence
    ) -> None:
        """Add so much that replicates leave as much as the recording does: their sensors make some."""
        clean = [replace(t, left=x) for t, x in zip(self.replicates, self._clean, strict=True)]
        taken = self.values.size + len(extra)
        own, total = (
            float(np.mean([mean_square(d.rest(extra), taken) for d in some]))
            for some in (clean, [self.data])
        )
        beyond = max(1.0 - own / max(total, 1e-300), 0.1)
        sd = math.sqrt(total * beyond / memory.variance(self.data.layout))
        rng = np.random.default_rng(stream)
        self.replicates = [
            replace(t, left=t.left + sd * memory.drawn(t.layout, rng)) for t in clean
        ]

    # Ranking

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of candidates that are asked."""
        scanned = (key.kind for key in self.data.keys if key.kind == DELAYS[1])
        return tuple(dict.fromkeys([*(key.kind for key, _ in self._groups), *scanned, TONE, PUSH]))

    @property
    def untold(self) -> tuple[str, ...]:
        """Kinds that could be, and that this motion does not tell from the model's own."""
        return tuple(dict.fromkeys(k.kind for k in self.data.keys if k.kind not in self.kinds))

    def steps(self, most: int = MOST) -> list[Step]:
        """Rank what the model lacks: what no chance is, in order, or the first that may be."""
        found = []
        for choice, extra in self._climbed(most):
            found.append(self._step(choice, extra))
            if not choice.sure:
                break
            self._sure_kinds.add(choice.kind)
            if choice.scan is not None:
                self._placed_scans.append((choice.kind, tuple(choice.own)))
        return found

    def missing(self) -> Missing:
        """Give all candidates to be marginalised, after :meth:`steps`.

        Those that were found are among them; a tone, a push or a far delay only where it was, and
        none that is as large as all torque where it is there. Columns are as large as all torque,
        of friction as what the model loses; the mean score of the replicates is taken off, and half of
        it counts as spread. The noise is the one that was chosen before: what is taken in differs
        with the replicates where several explain as much.
        """
        d = replace(self.data, memory=self.noise).whitened
        base = basis_of(d.base)
        # what is there for a moment only is no larger for that; and what more is lost is of the
        # size of what the model loses
        size = np.abs(self.data.others).max(axis=0)
        losses = [key.kind in BY_NAME and BY_NAME[key.kind].loss for key in self.data.keys]
        most = np.where(losses, self.scales.lost, self.scales.torque)
        size = np.divide(most, size, out=np.zeros_like(size), where=size > 0.0)
        columns = self.data.others * size
        rest, left = without(base, without(base, d.others * size)), without(base, d.left)
        unit, whole = (np.linalg.norm(x, axis=0) for x in (rest, d.others * size))
        seen = unit > TESTABLE * whole
        groups = [(k.kind, tuple(own)) for k, own in self._groups if not BY_NAME[k.kind].least]
        wanted = groups + self._placed_scans
        # between the shapes of a grid
        wanted += [(f"beside {k.kind}", (i,)) for i, k in enumerate(d.keys) if k.beside]
        kinds: dict[str, list[tuple[int, ...]]] = {}
        for kind, own in wanted:
            if seen[list(own)].all():
                kinds.setdefault(kind, []).append(own)
        free = left.size - base.shape[1]
        power = float(left @ left)
        scores, sds = zip(
            *(unit_scores(replicate.whitened, size) for replicate in self.replicates), strict=True
        )
        mean, white = np.mean(scores, axis=0), float(np.mean(sds))
        sd, bias = np.std(scores, axis=0, ddof=1) / white, mean / white
        in_law = {kind.name for kind in KINDS if kind.of_speed}
        biases = self._sure_kinds - in_law
        return Missing(
            biases_friction=np.array([key.kind in biases for key in self.data.keys], dtype=bool),
            observations=tuple(self.observations),
            columns=columns,
            kinds={kind: tuple(shapes) for kind, shapes in kinds.items()},
            gram=rest.T @ rest,
            scores=rest.T @ left - mean * unit,
            rough=np.mean(columns**2, axis=0) / self.noise.variance(self.data.layout),
            power=power,
            spread=np.hypot(np.maximum(sd, 1.0), HALF * bias),
            free=free,
        )

    def _climbed(self, most: int, *, choosing: bool = False) -> Iterator[tuple[Choice, list[int]]]:
        """Take in one candidate after the other; gives each with the columns taken before it.

        While the noise is being chosen it counts as white, and only what was found is taken.
        """
        extra: list[int] = []
        for _ in range(most):
            choice = self._best(extra, choosing)
            yield choice, extra
            extra = [*extra, *choice.own]
            alone = "gravity", "repeating", TONE, PUSH
            if not choosing and choice.kind not in alone:
                keys = enumerate(self.data.keys)
                family = [i for i, k in keys if k.kind == choice.kind and not k.delay]
                extra += [i for i in family if i not in extra]

    def _best(self, extra: list[int], choosing: bool) -> Choice:
        """Choose the candidate that explains most of those that are no chance.

        A push comes last: it is taken only where nothing else is sure. A fault of the recording is
        looked for first only. Of a log that holds nothing above its band it is smoothing: what the
        others explain of it is what is missing.
        """
        if not choosing:
            self.data = replace(self.data, memory=_memory(self.data, extra)[0])
        given = self._groups, extra, self.scales.push
        mine = asked(self.data, *given)
        z, null = scored(mine, [asked(replicate, *given) for replicate in self.replicates])
        largest = null.max(axis=1)
        limit = float(np.quantile(largest, 1.0 - FALSE_ALARMS, method="higher"))
        # so few replicates know it to 0.3: nor is less than by as many normals (Bonferroni)
        limit = max(limit, -float(ndtri(0.5 * FALSE_ALARMS / z.size)))
        kinds = [*(key.kind for key, _ in self._groups), *(scan.kind for scan in mine.scans)]
        # a shape, or the place of a scan, is one more number
        shapes = Counter(key.kind for key, _ in self._groups)
        more = [len(o) - 1 + (shapes[k.kind] > 1) for k, o in self._groups] + [2, 1, 1]
        gains = np.append(mine.gains, [scan.peak for scan in mine.scans])
        worth = gains - np.array(more) * math.log(self.data.left.size)
        allowed = z > limit
        if choosing:  # what the noise's wander can be is not to be taken before it is known
            slow = mine.scans[0].place < _SLOW
            allowed &= [k not in (PUSH, "drift") and not (k == TONE and slow) for k in kinds]
        last = np.array([k == PUSH for k in kinds])
        if (allowed & ~last).any():
            allowed &= ~last
        named = {(key.kind, key.shape) for key, _ in self._groups}
        faulty = not extra and (SMOOTHED, self._smoothed) in named
        for i, (key, own) in enumerate(self._groups):
            kind = BY_NAME[key.kind]
            if kind.least:
                allowed[i] &= bool(allowed[i]) and self._share(own, extra) > kind.least
            if faulty or key.kind == SMOOTHED:
                allowed[i] = (key.kind, key.shape) == (SMOOTHED, self._smoothed)
            # what a term that was taken in leaves may look like a fault
            allowed[i] &= not (extra and kind.of_recording)
        sure = bool(allowed.any())
        best = int(np.argmax(np.where(allowed, worth, -np.inf) if sure else z))
        p = float((1 + (largest >= z[best]).sum()) / (len(largest) + 1))
        told = sure, float(z[best]), p, float(z.max()), limit, worth
        if best < len(self._groups):
            key, own = self._groups[best]
            return Choice(key.kind, key.shape, own, *told)
        scan = self._placed(mine.scans[best - len(self._groups)], extra)
        own = self._with_scan(scan) if sure or not choosing else []
        return Choice(scan.kind, self._shape(scan), own, *told, scan)

    def _step(self, choice: Choice, extra: Sequence[int]) -> Step:
        """Add to a choice what it moves, what looks like it, and the seconds of a push."""
        # of what is one recording's alone, as a delay
        recording = {f"in {name}": name for name in self.scales.names}.get(choice.shape, "")
        span = None
        if choice.kind == PUSH and choice.scan is not None:
            place, width = choice.scan.place, 2.0 * self.scales.push
            recording = self.observations[choice.scan.recording].name
            span = place - width, place + width
        return Step(
            **vars(choice),
            recording=recording,
            span=span,
            alike=tuple(self._alike(choice, extra)) if choice.sure else (),
            **self._moved(choice.own, extra),
        )

    def _alike(self, choice: Choice, extra: Sequence[int]) -> Iterator[str]:
        """Name other kinds that this motion does not tell from the one that was chosen.

        None for a tone or a push.
        """
        if choice.kind in (TONE, PUSH):
            return
        white = self.data.whitened
        z = without(basis_of(white.beside(extra)), white.others)
        mine = basis_of(z[:, choice.own])
        ranked = list(zip(self._groups, choice.worth, strict=False))
        best = max((w for (key, _), w in ranked if key.kind == choice.kind), default=-math.inf)
        if choice.scan is not None:  # the last scan is that of the delay
            best = max(best, choice.worth[-1])
        seen = {choice.kind}
        for (key, columns), gain in ranked:
            if key.kind in seen or BY_NAME[key.kind].of_recording:
                continue
            theirs = basis_of(z[:, columns])
            same = theirs.size > 0 and (
                float(np.linalg.svd(mine.T @ theirs, compute_uv=False).min()) > ALIKE
            )
            if gain > best - BETTER or (same and gain > 0.5 * best):
                seen.add(key.kind)
                yield key.kind

    def _moved(self, own: list[int], extra: Sequence[int]) -> dict[str, Any]:
        """Fit the best candidate: its own coefficients, and what it moves the model's by."""
        white, d, split = self.data.whitened, self.values.size, self.values.size + len(extra)
        size = np.ones(split + len(own))
        size[:d] = self._sizes
        before, *_ = solved(white.beside(extra), white.left, size[:split])
        both = white.beside([*extra, *own])
        after, covariance, told = solved(both, white.left, size)
        return {
            "share": self._share(own, extra),
            "coefficients": after[split:],
            "moves": self._moves(after[:d] - before[:d], covariance[:d, :d], told[:d]),
        }

    def _share(self, own: list[int], extra: Sequence[int]) -> float:
        """Give the root mean square of a candidate's torque over that of all torque."""
        white, split = self.data.whitened, self.values.size + len(extra)
        size = np.ones(split + len(own))
        size[: self.values.size] = self._sizes
        coefficients = solved(white.beside([*extra, *own]), white.left, size)[0][split:]
        torque = self.data.others[:, own] @ coefficients
        return float(np.sqrt(np.mean(torque**2))) / self.scales.torque

    def _moves(self, shift: Array, covariance: Array, told: Array) -> dict[str, float]:
        """Give what a shift ``(d,)`` of parameters is for everything that a fit reports.

        ``told`` ``(d, k)`` are directions that the recordings determine.
        """
        found, size = {}, self._sizes
        for name, gradient in self._gradients.items():
            scaled = gradient * size
            inside = told.T @ scaled
            variance = float(gradient @ covariance @ gradient)
            if inside @ inside > _TOLD * (scaled @ scaled):
                found[name] = float(gradient @ shift) / math.sqrt(variance)
        return found

    @cached_property
    def _gradients(self) -> dict[str, Array]:
        """Derivatives ``(d,)`` of parameters and derived quantities by the parameters."""
        chain, d = self.chain, self.values.size
        load = typical_load(chain, self.observations, self.values)
        steps = _STEP * self._sizes
        moved = self.values + np.concatenate([np.diag(steps), -np.diag(steps)])
        found = {name: np.eye(d)[i] for i, name in enumerate(chain.names)}
        for one in derive(chain, moved, load):
            found[one.name] = (one.values[:d] - one.values[d:]) / (2.0 * steps)
        return {k: v for k, v in found.items() if k not in self.known and np.isfinite(v).all()}

    def _placed(self, scan: Scan, extra: Sequence[int]) -> Scan:
        """Tune the frequency of a tone; a push stays where it is."""
        if scan.kind != TONE:
            return scan
        d, white = self.data, self.data.whitened
        basis = basis_of(white.beside(extra))

        def left(x: Array) -> Array:
            return without(basis, d.memory.whitened(x, d.layout))

        hertz = tuned(without(basis, white.left), d.layout, scan.place, left)
        return replace(scan, place=hertz)

    def _shape(self, scan: Scan) -> str:
        if scan.kind == TONE:
            return f"{scan.place:.3g} Hz"
        if scan.kind in DELAYS:
            return next(key.shape for key in self.data.keys if key.delay == scan.place)
        return f"{self.observations[scan.recording].name} at {scan.place:.2f} s"

    def _with_scan(self, scan: Scan) -> list[int]:
        """Add the columns of what a scan has found to recording and replicates, and number them."""
        if scan.kind in DELAYS:  # which have them already
            return [i for i, key in enumerate(self.data.keys) if key.delay == scan.place]
        first = self.data.others.shape[1]

        def widened(d: Columns) -> Columns:
            tone, width = scan.kind == TONE, self.scales.push
            more = waves(d.layout, scan.place) if tone else bump(d.layout, scan, width)
            keys = (Key(scan.kind, self._shape(scan), i) for i in range(more.shape[1]))
            return replace(d, others=np.column_stack([d.others, more]), keys=(*d.keys, *keys))

        self.data, self.replicates = (
            widened(self.data),
            [widened(replicate) for replicate in self.replicates],
        )
        return list(range(first, self.data.others.shape[1]))


def _memory(d: Columns, extra: Sequence[int]) -> tuple[Memory, float]:
    """Choose the memory of what is left beside ``extra``, candidates; and its criterion."""
    return memory_of(d.rest(extra), d.layout)
