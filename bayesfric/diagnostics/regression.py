"""What else explains the torque: one regression, tested against simulated replicates.

The model's own columns, derivatives of its torque by its parameters at an estimate, are joined by
those of :mod:`bayesfric.diagnostics.candidates`. All pass the parallel filter of the measured
torque and are whitened by one noise model; the model's own columns are projected out. The
replicates give the null distribution of each statistic and of the maximum of all (Rubin, Annals of
Statistics 12, 1984; Gelman, Meng and Stern, Statistica Sinica 6, 1996; Westfall and Young,
Resampling-Based Multiple Testing, 1993). Significant candidates are included by forward selection.

The noise is chosen on the residual after including everything that is significant with white noise:
on the plain residual its autocorrelation would absorb the effect. Each replicate's is chosen on
itself.
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
from bayesfric.diagnostics.autocorrelation import (
    WHITE,
    Autocorrelation,
    Layout,
    choose_autocorrelation,
)
from bayesfric.diagnostics.candidates import (
    BY_NAME,
    KINDS,
    SMOOTHED,
    columns_along,
    filtered_columns,
)
from bayesfric.diagnostics.disturbances import (
    DELAYS,
    SINUSOID,
    TRANSIENT,
    Scan,
    sinusoid_columns,
    transient_columns,
    tune_frequency,
)
from bayesfric.diagnostics.policy import (
    BETTER,
    COLLINEAR,
    FALSE_ALARMS,
    LEAST_OUTPUTS,
    MAX_EFFECTS,
    REPLICATES,
    TESTABLE,
)
from bayesfric.diagnostics.replicates import ReplicateError, replicates
from bayesfric.diagnostics.statistics import (
    HALF,
    OPEN,
    Columns,
    Key,
    basis_of,
    mean_square,
    project_out,
    score_candidates,
    standard_normal_scores,
    testable,
    truncated_least_squares,
    unit_scores,
)
from bayesfric.estimates.torque import filtered_torque, torque_jacobian, typical_load
from bayesfric.inference.discrepancy import Missing
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import Observation
from bayesfric.recordings.source import Processing

# Step of a derivative, as a share of a parameter.
_STEP = 1e-6
# Share of a quantity's direction that must be identified.
_DETERMINED = 0.999
# Largest relative spread of a parameter between replicates.
_WIDEST = 0.1
# Share of the replicates that must succeed.
_ENOUGH = 0.5
# Largest number of effects included while noise is chosen, and the penalty of each: twice the log
# of the number of candidates.
_PICKS, _PICK_COST = 8, 10.0
# Frequency, Hz, below which a sinusoid may be the noise's drift.
_DRIFT_HERTZ = 1.0


@dataclass(frozen=True, eq=False)
class Selection:
    """Best candidate of one round of forward selection."""

    kind: str
    shape: str
    columns: list[int]  # indices
    significant: bool
    # statistic as a standard normal, and p-value (1 + k) / (n + 1): k of n replicates have a
    # candidate with as large a statistic
    z: float
    p: float
    # largest z of all candidates, and its critical value
    largest: float
    limit: float
    # BIC-penalised gain of every candidate, searches last
    worth: Array
    scan: Scan | None = None  # place of a disturbance or far delay


@dataclass(frozen=True, eq=False)
class Replicate:
    """A simulated recording with known parameters and no torque noise."""

    values: Array  # (n_parameters,) true parameters
    # (n, n_parameters) derivatives of its outputs there, and (n,) residual of the model: the error
    # of encoder and filters
    base: Array
    residual: Array
    layout: Layout


@dataclass(frozen=True, eq=False, kw_only=True)
class Step(Selection):
    """One candidate included by forward selection."""

    share: float  # rms of its torque over that of all torque
    # recording and seconds of a transient; the recording also of an effect in one recording alone
    recording: str
    span: tuple[float, float] | None
    coefficients: Array  # of its columns
    # shift of each identified parameter or derived quantity in its standard deviations
    moves: dict[str, float]
    collinear: tuple[str, ...]  # kinds that explain as much or are collinear


@dataclass(eq=False)
class Regression:
    """Regression of the residual torque at ``values`` ``(n_parameters,)`` on candidate effects."""

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
    _located_scans: list[tuple[str, tuple[int, ...]]] = field(init=False, default_factory=list)
    _significant_kinds: set[str] = field(init=False, default_factory=set)

    def __post_init__(self) -> None:
        draws, others, noise = np.random.SeedSequence(self.seed).spawn(3)
        self.scales = scales_of(self.chain, self.values, self.observations)
        self.data = self._columns(self.values, self.observations)
        self._groups = testable(self.data)
        pairs = zip(self.observations, self.recordings, strict=True)
        along = [Along(self.chain, self.values, o, r, self.scales) for o, r in pairs]
        self._smoothed = f"{max(a.smoothed_at() for a in along):.3g} Hz"
        vectors = self._draw_parameters(np.random.default_rng(draws))
        simulated = [
            (v, self._columns(v, observations))
            for v, observations in self._simulate(vectors, others)
        ]
        self.simulated = tuple(Replicate(v, t.base, t.residual, t.layout) for v, t in simulated)
        self.replicates = [replicate for _, replicate in simulated]
        if len(self.replicates) < _ENOUGH * self.number:
            raise ReplicateError("with parameters like these it hardly moves")
        self._clean = [replicate.residual for replicate in self.replicates]
        self._choose_noise(noise)

    # What is compared

    @property
    def _sizes(self) -> Array:
        """Scale ``(d,)`` of each parameter."""
        return np.maximum(np.abs(self.values), 1e-12)

    def _model_columns(self, values: Array, observations: Sequence[Observation]) -> Columns:
        """Compute the model's columns at parameters ``(n_parameters,)``."""
        chain = self.chain
        free = np.array([name not in self.known for name in chain.names])
        steps = free * _STEP * np.maximum(np.abs(values), 1.0)
        base = torque_jacobian(chain, observations, values, steps)
        left = [o.measured - filtered_torque(chain, o, values[None])[0] for o in observations]
        nothing = np.empty((len(base), 0))
        return Columns(base, nothing, np.concatenate(left), Layout.of(observations), ())

    def _columns(self, values: Array, observations: Sequence[Observation]) -> Columns:
        """Compute the model's and the candidates' columns."""
        blocks = []
        for o, r in zip(observations, self.recordings, strict=True):
            columns = dict(columns_along(Along(self.chain, values, o, r, self.scales)))
            blocks.append(filtered_columns(o, list(columns.values())))
        own = self._model_columns(values, observations)
        return replace(own, others=np.concatenate(blocks), keys=tuple(columns))

    def _draw_parameters(self, rng: np.random.Generator) -> Array:
        """Draw parameters ``(number, n_parameters)`` from the estimate's normal.

        Unidentified directions are left out.
        """
        size = self._sizes
        rows = self.data.base * size
        variance = mean_square(
            project_out(basis_of(self.data.base), self.data.residual), rows.shape[1]
        )
        power, vectors = np.linalg.eigh(rows.T @ rows)
        determined = power > OPEN * power.max()
        sds = np.minimum(np.sqrt(variance / power[determined]), _WIDEST)
        drawn = rng.standard_normal((self.number, int(determined.sum()))) * sds
        lower = np.array([p.lower for p in self.chain.parameters])
        return np.asarray(
            np.maximum(self.values + (drawn @ vectors[:, determined].T) * size, lower)
        )

    def _simulate(
        self, vectors: Array, stream: np.random.SeedSequence
    ) -> Iterator[tuple[Array, list[Observation]]]:
        """Simulate a replicate for each vector; skip those with too few outputs after filtering."""
        parts = []
        for r, o, recording_seeds in zip(
            self.recordings, self.observations, stream.spawn(len(self.recordings)), strict=True
        ):
            seeds = recording_seeds.spawn(len(vectors))
            parts.append(replicates(self.chain, vectors, r, o, self.processing, seeds))
        for values, simulated in zip(vectors, zip(*parts, strict=True), strict=True):
            usable = [o for o in simulated if o is not None]
            least = len(self.chain.names) + LEAST_OUTPUTS
            if len(usable) == len(simulated) and sum(o.measured.size for o in usable) >= least:
                yield values, usable

    # Noise

    def _choose_noise(self, stream: np.random.SeedSequence) -> None:
        """Choose the noise on what remains after including effects; add it to the replicates."""
        self._add_noise(WHITE, [], stream)
        inclusions: list[list[int]] = [[]]
        for choice, extra in self._forward_selection(_PICKS, for_noise=True):
            if not choice.significant:
                break
            inclusions.append([*extra, *choice.columns])
        best = math.inf
        for picks, extra in enumerate(inclusions):
            autocorrelation, bic = choose_autocorrelation(
                self.data.residual_with(extra), self.data.layout
            )
            bic += len(extra) * math.log(self.data.residual.size) + _PICK_COST * picks
            if bic < best:
                best, self.noise, chosen = bic, autocorrelation, extra
        self._add_noise(self.noise, chosen, stream)
        self.replicates = [
            replace(t, autocorrelation=choose_autocorrelation(t.residual_with(chosen), t.layout)[0])
            for t in self.replicates
        ]

    def _add_noise(
        self, autocorrelation: Autocorrelation, extra: Sequence[int], stream: np.random.SeedSequence
    ) -> None:
        """Add noise so that the replicates' residual is as large as the recording's."""
        clean = [replace(t, residual=x) for t, x in zip(self.replicates, self._clean, strict=True)]
        parameters = self.values.size + len(extra)
        sensor_power, total = (
            float(np.mean([mean_square(d.residual_with(extra), parameters) for d in group]))
            for group in (clean, [self.data])
        )
        noise_share = max(1.0 - sensor_power / max(total, 1e-300), 0.1)
        sd = math.sqrt(total * noise_share / autocorrelation.variance(self.data.layout))
        rng = np.random.default_rng(stream)
        self.replicates = [
            replace(t, residual=t.residual + sd * autocorrelation.drawn(t.layout, rng))
            for t in clean
        ]

    # Ranking

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of candidates that are tested."""
        scanned = (key.kind for key in self.data.keys if key.kind == DELAYS[1])
        return tuple(
            dict.fromkeys([*(key.kind for key, _ in self._groups), *scanned, SINUSOID, TRANSIENT])
        )

    @property
    def indistinguishable(self) -> tuple[str, ...]:
        """Kinds that are collinear with the model's own columns on this motion."""
        return tuple(dict.fromkeys(k.kind for k in self.data.keys if k.kind not in self.kinds))

    def steps(self, most: int = MAX_EFFECTS) -> list[Step]:
        """Forward-select missing effects; if none is significant, return the best candidate."""
        steps = []
        for choice, extra in self._forward_selection(most):
            steps.append(self._step(choice, extra))
            if not choice.significant:
                break
            self._significant_kinds.add(choice.kind)
            if choice.scan is not None:
                self._located_scans.append((choice.kind, tuple(choice.columns)))
        return steps

    def missing(self) -> Missing:
        """Return all candidates for marginalisation, after :meth:`steps`.

        A disturbance or far delay is included only if it was selected, and so is a kind with a
        least share. Columns have the size of all torque, those of friction the size of the model's
        losses. The replicates' mean score is subtracted, half of it counts as spread. The noise is
        that of the whole selection: included effects differ where several explain as much.
        """
        d = replace(self.data, autocorrelation=self.noise).whitened
        base = basis_of(d.base)
        # a short effect is no larger for that; additional losses are as large as the model's
        size = np.abs(self.data.others).max(axis=0)
        losses = [key.kind in BY_NAME and BY_NAME[key.kind].loss for key in self.data.keys]
        largest = np.where(losses, self.scales.lost, self.scales.torque)
        size = np.divide(largest, size, out=np.zeros_like(size), where=size > 0.0)
        columns = self.data.others * size
        remainder, residual = (
            project_out(base, project_out(base, d.others * size)),
            project_out(base, d.residual),
        )
        unit, total = (np.linalg.norm(x, axis=0) for x in (remainder, d.others * size))
        identified = unit > TESTABLE * total
        groups = [
            (k.kind, tuple(members)) for k, members in self._groups if not BY_NAME[k.kind].least
        ]
        all_groups = groups + self._located_scans
        # shapes between those of a grid
        all_groups += [(f"beside {k.kind}", (i,)) for i, k in enumerate(d.keys) if k.nuisance]
        kinds: dict[str, list[tuple[int, ...]]] = {}
        for kind, members in all_groups:
            if identified[list(members)].all():
                kinds.setdefault(kind, []).append(members)
        free = residual.size - base.shape[1]
        power = float(residual @ residual)
        scores, sds = zip(
            *(unit_scores(replicate.whitened, size) for replicate in self.replicates), strict=True
        )
        mean, white = np.mean(scores, axis=0), float(np.mean(sds))
        sd, bias = np.std(scores, axis=0, ddof=1) / white, mean / white
        in_law = {kind.name for kind in KINDS if kind.of_speed}
        biases = self._significant_kinds - in_law
        return Missing(
            biases_friction=np.array([key.kind in biases for key in self.data.keys], dtype=bool),
            observations=tuple(self.observations),
            columns=columns,
            kinds={kind: tuple(shapes) for kind, shapes in kinds.items()},
            gram=remainder.T @ remainder,
            scores=remainder.T @ residual - mean * unit,
            column_errors=np.mean(columns**2, axis=0) / self.noise.variance(self.data.layout),
            power=power,
            spread=np.hypot(np.maximum(sd, 1.0), HALF * bias),
            free=free,
        )

    def _forward_selection(
        self, most: int, *, for_noise: bool = False
    ) -> Iterator[tuple[Selection, list[int]]]:
        """Include one candidate after the other; yield each with the columns included before it.

        With ``for_noise`` the noise is white, and only the selected columns are included.
        """
        extra: list[int] = []
        for _ in range(most):
            choice = self._select(extra, for_noise)
            yield choice, extra
            extra = [*extra, *choice.columns]
            single = "gravity", "repeating", SINUSOID, TRANSIENT
            if not for_noise and choice.kind not in single:
                keys = enumerate(self.data.keys)
                same_kind = [i for i, k in keys if k.kind == choice.kind and not k.delay]
                extra += [i for i in same_kind if i not in extra]

    def _select(self, extra: list[int], for_noise: bool) -> Selection:
        """Select the significant candidate with the largest penalised gain.

        A transient is selected only if nothing else is significant, a fault of the recording only
        as the first. If the log is low-passed below its band, smoothing is selected: other
        candidates would explain what it removed.
        """
        if not for_noise:
            self.data = replace(
                self.data,
                autocorrelation=choose_autocorrelation(
                    self.data.residual_with(extra), self.data.layout
                )[0],
            )
        arguments = self._groups, extra, self.scales.transient_width
        recorded = score_candidates(self.data, *arguments)
        z, null = standard_normal_scores(
            recorded, [score_candidates(replicate, *arguments) for replicate in self.replicates]
        )
        largest = null.max(axis=1)
        limit = float(np.quantile(largest, 1.0 - FALSE_ALARMS, method="higher"))
        # few replicates give it to 0.3: at least that of as many independent normals (Bonferroni)
        limit = max(limit, -float(ndtri(0.5 * FALSE_ALARMS / z.size)))
        kinds = [*(key.kind for key, _ in self._groups), *(scan.kind for scan in recorded.scans)]
        # a shape, or the place of a search, is one more parameter
        shapes = Counter(key.kind for key, _ in self._groups)
        extra_parameters = [len(o) - 1 + (shapes[k.kind] > 1) for k, o in self._groups] + [2, 1, 1]
        gains = np.append(recorded.gains, [scan.peak for scan in recorded.scans])
        worth = gains - np.array(extra_parameters) * math.log(self.data.residual.size)
        allowed = z > limit
        if for_noise:  # the noise's drift is not known yet
            slow = recorded.scans[0].place < _DRIFT_HERTZ
            allowed &= [
                k not in (TRANSIENT, "drift") and not (k == SINUSOID and slow) for k in kinds
            ]
        transient = np.array([k == TRANSIENT for k in kinds])
        if (allowed & ~transient).any():
            allowed &= ~transient
        shapes_present = {(key.kind, key.shape) for key, _ in self._groups}
        smoothed = not extra and (SMOOTHED, self._smoothed) in shapes_present
        for i, (key, members) in enumerate(self._groups):
            kind = BY_NAME[key.kind]
            if kind.least:
                allowed[i] &= bool(allowed[i]) and self._share(members, extra) > kind.least
            if smoothed or key.kind == SMOOTHED:
                allowed[i] = (key.kind, key.shape) == (SMOOTHED, self._smoothed)
            # the remainder of an included term may look like a fault
            allowed[i] &= not (extra and kind.of_recording)
        significant = bool(allowed.any())
        best = int(np.argmax(np.where(allowed, worth, -np.inf) if significant else z))
        p = float((1 + (largest >= z[best]).sum()) / (len(largest) + 1))
        statistics = significant, float(z[best]), p, float(z.max()), limit, worth
        if best < len(self._groups):
            key, members = self._groups[best]
            return Selection(key.kind, key.shape, members, *statistics)
        scan = self._tuned_scan(recorded.scans[best - len(self._groups)], extra)
        members = self._add_scan_columns(scan) if significant or not for_noise else []
        return Selection(scan.kind, self._scan_shape(scan), members, *statistics, scan)

    def _step(self, choice: Selection, extra: Sequence[int]) -> Step:
        """Complete a selection by the shifts of parameters, collinear kinds and its place."""
        # effect in one recording alone, as a delay
        recording = {f"in {name}": name for name in self.scales.names}.get(choice.shape, "")
        span = None
        if choice.kind == TRANSIENT and choice.scan is not None:
            place, width = choice.scan.place, 2.0 * self.scales.transient_width
            recording = self.observations[choice.scan.recording].name
            span = place - width, place + width
        return Step(
            **vars(choice),
            recording=recording,
            span=span,
            collinear=tuple(self._collinear_kinds(choice, extra)) if choice.significant else (),
            **self._fit_selected(choice.columns, extra),
        )

    def _collinear_kinds(self, choice: Selection, extra: Sequence[int]) -> Iterator[str]:
        """List other kinds that explain as much or are collinear; none for disturbances."""
        if choice.kind in (SINUSOID, TRANSIENT):
            return
        white = self.data.whitened
        z = project_out(basis_of(white.with_candidates(extra)), white.others)
        basis = basis_of(z[:, choice.columns])
        ranked = list(zip(self._groups, choice.worth, strict=False))
        best = max((w for (key, _), w in ranked if key.kind == choice.kind), default=-math.inf)
        if choice.scan is not None:  # the last search is the delay's
            best = max(best, choice.worth[-1])
        yielded = {choice.kind}
        for (key, columns), gain in ranked:
            if key.kind in yielded or BY_NAME[key.kind].of_recording:
                continue
            other = basis_of(z[:, columns])
            collinear = other.size > 0 and (
                float(np.linalg.svd(basis.T @ other, compute_uv=False).min()) > COLLINEAR
            )
            if gain > best - BETTER or (collinear and gain > 0.5 * best):
                yielded.add(key.kind)
                yield key.kind

    def _fit_selected(self, members: list[int], extra: Sequence[int]) -> dict[str, Any]:
        """Fit the selected candidate: share, coefficients, and shifts of the model's parameters."""
        white, d, split = self.data.whitened, self.values.size, self.values.size + len(extra)
        size = np.ones(split + len(members))
        size[:d] = self._sizes
        before, *_ = truncated_least_squares(
            white.with_candidates(extra), white.residual, size[:split]
        )
        both = white.with_candidates([*extra, *members])
        after, covariance, determined = truncated_least_squares(both, white.residual, size)
        return {
            "share": self._share(members, extra),
            "coefficients": after[split:],
            "moves": self._parameter_shifts(
                after[:d] - before[:d], covariance[:d, :d], determined[:d]
            ),
        }

    def _share(self, members: list[int], extra: Sequence[int]) -> float:
        """Return the rms of a candidate's torque over that of all torque."""
        white, split = self.data.whitened, self.values.size + len(extra)
        size = np.ones(split + len(members))
        size[: self.values.size] = self._sizes
        coefficients = truncated_least_squares(
            white.with_candidates([*extra, *members]), white.residual, size
        )[0][split:]
        torque = self.data.others[:, members] @ coefficients
        return float(np.sqrt(np.mean(torque**2))) / self.scales.torque

    def _parameter_shifts(
        self, shift: Array, covariance: Array, determined: Array
    ) -> dict[str, float]:
        """Convert a shift ``(d,)`` to shifts of each reported quantity in its sd.

        ``determined`` ``(d, k)`` are the identified directions.
        """
        shifts, size = {}, self._sizes
        for name, gradient in self._gradients.items():
            scaled = gradient * size
            projected = determined.T @ scaled
            variance = float(gradient @ covariance @ gradient)
            if projected @ projected > _DETERMINED * (scaled @ scaled):
                shifts[name] = float(gradient @ shift) / math.sqrt(variance)
        return shifts

    @cached_property
    def _gradients(self) -> dict[str, Array]:
        """Derivatives ``(d,)`` of parameters and derived quantities by the parameters."""
        chain, d = self.chain, self.values.size
        load = typical_load(chain, self.observations, self.values)
        steps = _STEP * self._sizes
        shifted = self.values + np.concatenate([np.diag(steps), -np.diag(steps)])
        gradients = {name: np.eye(d)[i] for i, name in enumerate(chain.names)}
        for quantity in derive(chain, shifted, load):
            gradients[quantity.name] = (quantity.values[:d] - quantity.values[d:]) / (2.0 * steps)
        return {k: v for k, v in gradients.items() if k not in self.known and np.isfinite(v).all()}

    def _tuned_scan(self, scan: Scan, extra: Sequence[int]) -> Scan:
        """Refine the frequency of a sinusoid."""
        if scan.kind != SINUSOID:
            return scan
        d, white = self.data, self.data.whitened
        basis = basis_of(white.with_candidates(extra))

        def project(x: Array) -> Array:
            return project_out(basis, d.autocorrelation.whitened(x, d.layout))

        hertz = tune_frequency(project_out(basis, white.residual), d.layout, scan.place, project)
        return replace(scan, place=hertz)

    def _scan_shape(self, scan: Scan) -> str:
        if scan.kind == SINUSOID:
            return f"{scan.place:.3g} Hz"
        if scan.kind in DELAYS:
            return next(key.shape for key in self.data.keys if key.delay == scan.place)
        return f"{self.observations[scan.recording].name} at {scan.place:.2f} s"

    def _add_scan_columns(self, scan: Scan) -> list[int]:
        """Append the columns of a search result to recording and replicates; return indices."""
        if scan.kind in DELAYS:  # these columns exist already
            return [i for i, key in enumerate(self.data.keys) if key.delay == scan.place]
        first = self.data.others.shape[1]

        def extended(d: Columns) -> Columns:
            is_sinusoid, width = scan.kind == SINUSOID, self.scales.transient_width
            new_columns = (
                sinusoid_columns(d.layout, scan.place)
                if is_sinusoid
                else transient_columns(d.layout, scan, width)
            )
            keys = (Key(scan.kind, self._scan_shape(scan), i) for i in range(new_columns.shape[1]))
            return replace(
                d, others=np.column_stack([d.others, new_columns]), keys=(*d.keys, *keys)
            )

        self.data, self.replicates = (
            extended(self.data),
            [extended(replicate) for replicate in self.replicates],
        )
        return list(range(first, self.data.others.shape[1]))
