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
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from tempfile import TemporaryFile
from typing import IO, Any, Literal
from weakref import finalize

import numpy as np
from numpy.typing import DTypeLike
from scipy.special import ndtri

from bayesfric.diagnostics.candidates import (
    BY_NAME,
    KINDS,
    SMOOTHED,
    columns_along,
    filtered_columns,
)
from bayesfric.diagnostics.motion import MotionSignals, Scales, scales_of
from bayesfric.diagnostics.replicates import ReplicateError, replicates
from bayesfric.diagnostics.statistics import (
    DELAYS,
    FALSE_ALARMS,
    MAX_EFFECTS,
    MEAN_AS_SPREAD,
    OPEN,
    REPLICATES,
    SINUSOID,
    TESTABLE,
    TRANSIENT,
    WHITE,
    Autocorrelation,
    Columns,
    Key,
    Layout,
    Scan,
    basis_of,
    candidate_groups,
    choose_autocorrelation,
    least_outputs,
    mean_square,
    project_out,
    projected_moments,
    score_candidates,
    sinusoid_columns,
    standard_normal_scores,
    transient_columns,
    truncated_least_squares,
    tune_frequency,
    unit_scores,
)
from bayesfric.estimates.torque import filtered_torque, torque_jacobian, typical_load
from bayesfric.inference.discrepancy import Missing
from bayesfric.mechanism.derived import derivatives
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array, rms
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.signals import Signals
from bayesfric.recordings.source import Processing

Severity = Literal["note", "doubt"]

# Step of a derivative, as a share of a parameter.
_STEP = 1e-6
# Gain by which a candidate is better than another: a factor of 150 in likelihood.
_BETTER = 10.0
# Cosine from which two effects are collinear: a tenth of the variance of either is its own.
COLLINEAR = 0.95


def _contains(directions: Array, vector: Array) -> bool:
    """Whether directions ``(d, k)``, of those that data determine, hold a vector ``(d,)``."""
    projected = directions.T @ vector
    return bool(projected @ projected > 0.999 * (vector @ vector))


@dataclass(frozen=True)
class Finding:
    """An effect in the recordings that replicates of a right model do not show."""

    kind: str  # key of ``words.toml``
    severity: Severity  # doubt if it moves a reported number by more than half its interval
    statistic: float  # standard normal score among the replicates
    p: float  # (1 + k) / (n + 1): k of n replicates have a candidate with as large a statistic
    shape: str = ""  # such as a speed or a frequency; empty if the kind has one shape
    recording: str = ""  # empty for all
    span: tuple[float, float] | None = None  # s; None for the whole recording
    share: float = 0.0  # rms of its torque over the rms of all torque
    rivals: tuple[str, ...] = ()  # kinds that explain as much or are collinear on this motion
    # shift of each identified parameter or derived quantity in its standard deviations
    moves: Mapping[str, float] = field(default_factory=dict)
    setting: str = ""  # line of a configuration that adds the term; empty if there is none
    physical: bool = True  # whether the estimated sign is possible for that term
    # of the selection: whether the statistic is above its critical value
    significant: bool = field(default=True, repr=False)
    largest: float = field(default=0.0, repr=False)  # statistic of all candidates
    limit: float = field(default=0.0, repr=False)  # its critical value
    columns: Sequence[int] = field(default=(), repr=False)  # indices
    coefficients: Array = field(default_factory=lambda: np.zeros(0), repr=False, compare=False)
    scan: Scan | None = field(default=None, repr=False)  # place of a disturbance or far delay

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that it moves, the largest shift first."""
        return tuple(self.moves)

    @property
    def hint(self) -> str:
        """The setting, if the sign allows it."""
        return self.setting if self.physical else ""

    @property
    def applicable(self) -> bool:
        """Whether the setting may be applied automatically; a delay only without rivals."""
        return bool(self.hint) and not (self.kind in ("delay", "target_delay") and self.rivals)

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of ``summary.json``."""
        names = [name for name, field_ in self.__dataclass_fields__.items() if field_.repr]
        fields = {name: getattr(self, name) for name in names if name != "setting"}
        span = None if self.span is None else list(self.span)
        lists = {"parameters": list(self.parameters), "rivals": list(self.rivals), "span": span}
        return fields | lists | {"hint": self.hint, "moves": dict(self.moves)}


class StoredColumns:
    """Columns of replicates; those of candidates are in temporary files, which are read one by one.

    They would take most of a fit's memory.
    """

    def __init__(self, replicates: Iterable[Columns] = ()) -> None:
        self.parts: list[Columns] = []  # without candidates
        self._files: list[IO[bytes]] = []
        for replicate in replicates:
            self.append(replicate)

    def append(self, replicate: Columns) -> None:
        """Store another replicate."""
        file = TemporaryFile()  # noqa: SIM115 - closed with this object
        finalize(self, file.close)
        self.parts.append(replicate)
        self._files.append(file)
        self[-1] = replicate

    def __setitem__(self, i: int, replicate: Columns) -> None:
        self._files[i].seek(0)
        np.save(self._files[i], replicate.others)
        self.parts[i] = replace(replicate, others=np.empty((replicate.residual.size, 0)))

    def __getitem__(self, i: int) -> Columns:
        self._files[i].seek(0)
        return replace(self.parts[i], others=np.load(self._files[i]))

    def __len__(self) -> int:
        return len(self.parts)

    def __iter__(self) -> Iterator[Columns]:
        return map(self.__getitem__, range(len(self)))


# A simulated recording with known parameters and no torque noise: the true parameters
# (n_parameters,), and columns without candidates, whose residual is the error of encoder and
# filters.
Replicate = tuple[Array, Columns]


@dataclass(eq=False)
class Regression:
    """Forward selection of effects in a residual, tested against replicates of a right model."""

    data: Columns  # of the recordings
    replicates: StoredColumns  # noise is added to their residuals
    scales: Scales
    sizes: Array  # (d,) scale of each parameter
    gradients: Mapping[str, Array]  # (d,) derivatives of each reported quantity by the parameters
    noise_seed: np.random.SeedSequence
    smoothed: str = ""  # shape of the low-pass before logging
    # where outputs are no torque: torques (N, m) of the candidates, of which the columns are what
    # they do to outputs, and these (n, m) with what the model's own terms make of them
    torques: Array | None = None
    effects_on_outputs: Array | None = None
    noise: Autocorrelation = field(init=False)
    included: list[Finding] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        self.groups = candidate_groups(self.data)
        self._clean = [replicate.residual for replicate in self.replicates.parts]
        self._choose_noise()

    # Noise

    def _choose_noise(self, max_count: int = 8, cost: float = 10.0) -> None:
        """Choose the noise on what remains after including effects; add it to the replicates.

        Each effect costs twice the log of the number of candidates.
        """
        self._add_noise(WHITE, [])
        inclusions: list[list[int]] = [[]]
        for effect, extra in self._forward_selection(max_count, for_noise=True):
            if effect.significant:
                inclusions.append([*extra, *effect.columns])
        best, layout = math.inf, self.data.layout
        for picks, extra in enumerate(inclusions):
            noise, bic = choose_autocorrelation(self.data.residual_with(extra), layout)
            bic += len(extra) * math.log(self.data.residual.size) + cost * picks
            if bic < best:
                best, self.noise, chosen = bic, noise, extra
        self._add_noise(self.noise, chosen)
        for i, replicate in enumerate(self.replicates):
            self.replicates[i] = replicate.with_noise(self._noise_of(replicate, chosen))

    def _noise_of(self, d: Columns, extra: Sequence[int]) -> Autocorrelation:
        """Choose the noise about its mean: the autocorrelation would absorb an offset."""
        mean = [i for key, columns in self.groups if key.kind == "offset" for i in columns]
        return choose_autocorrelation(d.residual_with([*extra, *mean]), d.layout)[0]

    def _add_noise(self, noise: Autocorrelation, extra: Sequence[int]) -> None:
        """Add noise so that the replicates' residual is as large as the recording's."""
        parts, parameters = self.replicates.parts, self.sizes.size + len(extra)

        def power(d: Columns) -> float:
            return mean_square(d.residual_with(extra), parameters)

        loaded = zip(self.replicates if extra else parts, self._clean, strict=True)
        sensor_power = float(np.mean([power(replace(d, residual=x)) for d, x in loaded]))
        total = power(self.data)
        noise_share = max(1.0 - sensor_power / max(total, 1e-300), 0.1)
        sd = math.sqrt(total * noise_share / noise.variance(self.data.layout))
        rng = np.random.default_rng(self.noise_seed)
        parts[:] = [
            replace(d, residual=x + sd * noise.drawn(d.layout, rng))
            for d, x in zip(parts, self._clean, strict=True)
        ]

    # Ranking

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of candidates that are tested."""
        tested = [key.kind for key, _ in self.groups]
        tested += [key.kind for key in self.data.keys if key.kind == DELAYS[1]]
        return tuple(dict.fromkeys([*tested, SINUSOID, TRANSIENT]))

    @property
    def indistinguishable(self) -> tuple[str, ...]:
        """Kinds that are collinear with the model's own columns on this motion."""
        return tuple(dict.fromkeys(k.kind for k in self.data.keys if k.kind not in self.kinds))

    def effects(self, max_count: int = MAX_EFFECTS) -> list[Finding]:
        """Forward-select missing effects; the last one may be the best that is not significant."""
        effects = [effect for effect, _ in self._forward_selection(max_count)]
        self.included = [effect for effect in effects if effect.significant]
        return effects

    def _forward_selection(
        self, max_count: int, *, for_noise: bool = False
    ) -> Iterator[tuple[Finding, list[int]]]:
        """Include one candidate after the other; yield each with the columns included before it.

        With ``for_noise`` the noise is white, and only the selected columns are included. It ends
        with a candidate that is not significant.
        """
        extra: list[int] = []
        for _ in range(max_count):
            effect, worth = self._select(extra, for_noise)
            yield effect if for_noise else self._fitted(effect, extra, worth), extra
            if not effect.significant:
                return
            extra = [*extra, *effect.columns]
            single = "gravity", "repeating", SINUSOID, TRANSIENT
            if not for_noise and effect.kind not in single:
                keys = enumerate(self.data.keys)
                same_kind = [i for i, k in keys if k.kind == effect.kind and not k.delay]
                extra += [i for i in same_kind if i not in extra]

    def _select(self, extra: Sequence[int], for_noise: bool) -> tuple[Finding, Array]:
        """Select the significant candidate with the largest penalised gain, searches last.

        A transient is selected only if nothing else is significant, a fault of the recording only
        as the first, and if it is better than any term. If the log is low-passed below its band,
        smoothing is selected: other candidates would explain what it removed. The gains of all are
        returned, too.
        """
        if not for_noise:
            noise = self._noise_of(self.data, extra)
            self.data = replace(self.data, autocorrelation=noise)
        arguments = self.groups, extra, self.scales.transient_width
        recorded = score_candidates(self.data, *arguments)
        simulated = [score_candidates(replicate, *arguments) for replicate in self.replicates]
        z, null = standard_normal_scores(recorded, simulated)
        _, gains, scans = recorded
        largest = null.max(axis=1)
        limit = float(np.quantile(largest, 1.0 - FALSE_ALARMS, method="higher"))
        # few replicates give it to 0.3: at least that of as many independent normals (Bonferroni)
        limit = max(limit, -float(ndtri(0.5 * FALSE_ALARMS / z.size)))
        # a shape, or the place of a search, is one more parameter
        shapes = Counter(key.kind for key, _ in self.groups)
        parameters = [len(columns) - 1 + (shapes[key.kind] > 1) for key, columns in self.groups]
        gains = np.append(gains, [scan.peak for scan in scans])
        worth = gains - np.array([*parameters, 2, 1, 1]) * math.log(self.data.residual.size)
        allowed = z > limit
        kinds = [*(key.kind for key, _ in self.groups), *(scan.kind for scan in scans)]
        if for_noise:  # the noise's drift, of up to 1 Hz, is not known yet
            drift = {TRANSIENT, "drift", *([SINUSOID] if scans[0].place < 1.0 else [])}
            allowed &= [kind not in drift for kind in kinds]
        transient = np.array([kind == TRANSIENT for kind in kinds])
        if (allowed & ~transient).any():
            allowed &= ~transient
        log_filter = SMOOTHED, self.smoothed
        smoothed = not extra and log_filter in [(key.kind, key.shape) for key, _ in self.groups]
        allowed[len(self.groups) :] &= not smoothed
        for i, (key, columns) in enumerate(self.groups):
            kind = BY_NAME[key.kind]
            if smoothed:
                allowed[i] = (key.kind, key.shape) == log_filter
            elif key.kind == SMOOTHED or (extra and kind.of_recording):
                # the remainder of an included term may look like a fault
                allowed[i] = False
            elif allowed[i] and kind.least:
                coefficients = self._fit([*extra, *columns])[0][-len(columns) :]
                allowed[i] = self._share(columns, coefficients) > kind.least
        significant = bool(allowed.any())
        # a fault has no remedy: a term that explains as much is selected in its place
        faults = np.array([kind in BY_NAME and BY_NAME[kind].of_recording for kind in kinds])
        ranked = np.where(allowed, worth - _BETTER * faults, -np.inf)
        best = int(np.argmax(ranked if significant else z))
        p = float((1 + (largest >= z[best]).sum()) / (len(largest) + 1))
        statistic = float(z[best]), p
        selected: dict[str, Any] = {
            "significant": significant,
            "largest": float(z.max()),
            "limit": limit,
        }
        if best < len(self.groups):
            key, columns = self.groups[best]
            selected |= {"shape": key.shape, "columns": columns}
            return Finding(key.kind, "note", *statistic, **selected), worth
        scan = self._tuned(scans[best - len(self.groups)], extra)
        columns = self._scan_columns(scan) if significant or not for_noise else []
        selected |= {"shape": self._scan_shape(scan), "columns": columns, "scan": scan}
        return Finding(scan.kind, "note", *statistic, **selected), worth

    def _fitted(self, effect: Finding, extra: Sequence[int], worth: Array) -> Finding:
        """Fit a selected candidate: its share and place, shifts of parameters, collinear kinds."""
        d, split, scan = self.sizes.size, self.sizes.size + len(extra), effect.scan
        before, _, determined = self._fit(extra)
        after, covariance, remaining = self._fit([*extra, *effect.columns])
        shift, moves, own = after[:d] - before[:d], {}, list[str]()
        for name, gradient in self.gradients.items():
            scaled, collinear = gradient * self.sizes, True
            if _contains(remaining[:d], scaled):
                variance = float(gradient @ covariance[:d, :d] @ gradient)
                moves[name] = float(gradient @ shift) / math.sqrt(variance)
                limits = COLLINEAR * np.sqrt(variance * covariance.diagonal()[split:])
                collinear = bool(np.all(np.abs(gradient @ covariance[:d, split:]) > limits))
            # a parameter that a delay replaces is its rival: neither is then known
            if effect.kind == DELAYS[False] and collinear and _contains(determined[:d], scaled):
                own.append(name.rpartition(".")[2])
        # effect in one recording alone, as a delay
        recording = {f"in {name}": name for name in self.scales.names}.get(effect.shape, "")
        span = None
        if scan is not None and scan.kind == TRANSIENT:
            recording, reach = self.scales.names[scan.recording], 2.0 * self.scales.transient_width
            span = scan.place - reach, scan.place + reach
        rivals = self._collinear(effect, extra, worth) if effect.significant else ()
        return replace(
            effect,
            share=self._share(effect.columns, after[split:]),
            recording=recording,
            span=span,
            coefficients=after[split:],
            moves=moves,
            rivals=tuple(dict.fromkeys([*filter(BY_NAME.get, own), *rivals])),
        )

    def _fit(self, columns: Sequence[int]) -> tuple[Array, Array, Array]:
        """Fit the model's own parameters and columns of candidates."""
        white, size = self.data.whitened, np.append(self.sizes, np.ones(len(columns)))
        return truncated_least_squares(white.with_candidates(columns), white.residual, size)

    def _share(self, columns: Sequence[int], coefficients: Array) -> float:
        """Return the rms of a candidate's torque over that of all torque; 0 if it has none."""
        torques = self.data.others if self.torques is None else self.torques
        if max(columns) >= torques.shape[1]:
            return 0.0
        return rms(torques[:, columns] @ coefficients) / self.scales.torque

    def _collinear(self, effect: Finding, extra: Sequence[int], worth: Array) -> Iterator[str]:
        """List other kinds that explain as much or are collinear; none for disturbances."""
        if effect.kind in (SINUSOID, TRANSIENT):
            return
        white = self.data.whitened
        z = project_out(basis_of(white.with_candidates(extra)), white.others)
        basis, yielded = basis_of(z[:, effect.columns]), {effect.kind}
        ranked = list(zip(self.groups, worth, strict=False))
        mine = [gain for (key, _), gain in ranked if key.kind == effect.kind]
        best = max(mine, default=-math.inf)
        if effect.scan is not None:  # the last search is the delay's
            best = max(best, worth[-1])
        for (key, columns), gain in ranked:
            if key.kind in yielded or BY_NAME[key.kind].of_recording:
                continue
            cosines = np.linalg.svd(basis.T @ basis_of(z[:, columns]), compute_uv=False)
            collinear = cosines.size > 0 and float(cosines.min()) > COLLINEAR
            if gain > best - _BETTER or (collinear and gain > 0.5 * best):
                yielded.add(key.kind)
                yield key.kind

    # Sinusoids, transients and far delays

    def _tuned(self, scan: Scan, extra: Sequence[int]) -> Scan:
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
        return f"{self.scales.names[scan.recording]} at {scan.place:.2f} s"

    def _scan_columns(self, scan: Scan) -> list[int]:
        """Append the columns of a search result to recording and replicates; return indices."""
        if scan.kind in DELAYS:  # these columns exist already
            return [i for i, key in enumerate(self.data.keys) if key.delay == scan.place]
        first = self.data.others.shape[1]

        def extended(d: Columns) -> Columns:
            if scan.kind == SINUSOID:
                columns = sinusoid_columns(d.layout, scan.place)
            else:
                columns = transient_columns(d.layout, scan, self.scales.transient_width)
            keys = (Key(scan.kind, self._scan_shape(scan), i) for i in range(columns.shape[1]))
            if d.others_whitened:
                columns = d.autocorrelation.whitened(columns, d.layout)
            others = np.vstack([d.others.T, columns.T.astype(d.others.dtype)]).T
            return replace(d, others=others, keys=(*d.keys, *keys))

        self.data = extended(self.data)
        for i, replicate in enumerate(self.replicates):
            self.replicates[i] = extended(replicate)
        return list(range(first, self.data.others.shape[1]))

    # Marginalisation

    def missing(self, observations: Sequence[Signals]) -> Missing:
        """Return all candidates for marginalisation, after :meth:`effects`.

        A disturbance or far delay is included only if it was selected, and so is a kind with a
        least share. Columns have the size of all torque, those of friction the size of the model's
        losses. The replicates' mean score is subtracted, half of it counts as spread. The noise is
        that of the whole selection: included effects differ where several explain as much.
        """
        d, keys = replace(self.data, autocorrelation=self.noise).whitened, self.data.keys
        base = basis_of(d.base)
        # a short effect is no larger for that; additional losses are as large as the model's
        losses = [key.kind in BY_NAME and BY_NAME[key.kind].loss for key in keys]
        largest = np.where(losses, self.scales.lost, self.scales.torque)
        if self.torques is None or self.effects_on_outputs is None:
            highest, columns = np.abs(self.data.others).max(axis=0), self.data.others
        else:  # a disturbance of outputs is no torque
            highest, columns = np.zeros(len(keys)), d.others.copy()
            highest[: self.torques.shape[1]] = np.abs(self.torques).max(axis=0)
            columns[:, : self.torques.shape[1]] = self.effects_on_outputs
        nonzero = highest > np.finfo(np.float32).tiny  # of Stribeck friction far below all speeds
        size = np.divide(largest, highest, out=np.zeros_like(highest), where=nonzero)
        columns, residual = columns * size, project_out(base, d.residual)
        cross, slopes, total, unit = projected_moments(base, d.others, residual)
        identified = unit > TESTABLE * total
        groups = [(k.kind, tuple(i)) for k, i in self.groups if not BY_NAME[k.kind].least]
        scans = [e for e in self.included if e.scan is not None and size[list(e.columns)].all()]
        groups += [(e.kind, tuple(e.columns)) for e in scans]
        # shapes between those of a grid
        groups += [(f"beside {k.kind}", (i,)) for i, k in enumerate(keys) if k.nuisance]
        kinds: dict[str, tuple[tuple[int, ...], ...]] = {}
        for kind, members in groups:
            if identified[list(members)].all():
                kinds[kind] = (*kinds.get(kind, ()), members)
        scored = [unit_scores(replicate.whitened) for replicate in self.replicates]
        scores, sds = zip(*scored, strict=True)
        mean, sd = np.mean(scores, axis=0), float(np.mean(sds))
        spread, bias = np.std(scores, axis=0, ddof=1) / sd, mean / sd
        biases = {effect.kind for effect in self.included}
        biases -= {kind.name for kind in KINDS if kind.of_speed}
        return Missing(
            biases_friction=np.array([key.kind in biases for key in keys], dtype=bool),
            observations=tuple(observations),
            columns=columns,
            kinds=kinds,
            gram=(d.others.T @ d.others - cross.T @ cross) * np.outer(size, size),
            scores=(slopes - mean * unit) * size,
            column_errors=np.mean(columns**2, axis=0) / self.noise.variance(self.data.layout),
            power=float(residual @ residual),
            spread=np.hypot(np.maximum(spread, 1.0), MEAN_AS_SPREAD * bias),
            free=residual.size - base.shape[1],
        )


def regression_of(
    chain: Joint,
    recordings: Sequence[Measurement],
    observations: Sequence[Signals],
    processing: Processing,
    values: Array,
    known: Collection[str] = (),
    seed: int = 0,
    number: int = REPLICATES,
) -> tuple[Regression, tuple[Replicate, ...]]:
    """Set up the regression at parameters ``(n_parameters,)``, and simulate its replicates."""
    draws, others, noise = np.random.SeedSequence(seed).spawn(3)
    scales, sizes = scales_of(chain, values, observations), np.maximum(np.abs(values), 1e-12)
    free = np.array([name not in known for name in chain.names])

    def columns_at(
        vector: Array, observed: Sequence[Signals], dtype: DTypeLike = np.float64
    ) -> Columns:
        """Compute the model's and the candidates' columns."""
        blocks = []
        for o, r in zip(observed, recordings, strict=True):
            along = columns_along(MotionSignals(chain, vector, o, r, scales))
            keys, block = filtered_columns(o, along, dtype)
            blocks.append(block)
        steps = free * _STEP * np.maximum(np.abs(vector), 1.0)
        base = torque_jacobian(chain, observed, vector, steps)
        left = [o.measured - filtered_torque(chain, o, vector[None])[0] for o in observed]
        return Columns(
            base, np.concatenate(blocks), np.concatenate(left), Layout.of(observed), tuple(keys)
        )

    data = columns_at(values, observations)
    pairs = zip(observations, recordings, strict=True)
    smoothed = max(MotionSignals(chain, values, o, r, scales).smoothed_at() for o, r in pairs)
    vectors = draw_parameters(chain, values, data, number, np.random.default_rng(draws))
    streams = zip(recordings, observations, others.spawn(len(recordings)), strict=True)
    parts = [
        replicates(chain, vectors, r, o, processing, stream.spawn(number))
        for r, o, stream in streams
    ]
    simulated, columns = [], StoredColumns()
    for vector, repeated in zip(vectors, zip(*parts, strict=True), strict=True):
        usable = [o for o in repeated if o is not None]
        outputs = sum(o.measured.size for o in usable)
        if len(usable) == len(repeated) and outputs >= len(chain.names) + least_outputs(usable):
            columns.append(columns_at(vector, usable, np.float32))
            simulated.append((vector, columns.parts[-1]))
    if len(simulated) < 0.5 * number:
        raise ReplicateError("with parameters like these it hardly moves")
    gradients = {
        name: gradient
        for name, gradient in reported_gradients(chain, values, observations).items()
        if name not in known and np.isfinite(gradient).all()
    }
    cutoff = f"{smoothed:.3g} Hz"
    regression = Regression(data, columns, scales, sizes, gradients, noise, cutoff)
    return regression, tuple(simulated)


def draw_parameters(
    chain: Joint, values: Array, data: Columns, number: int, rng: np.random.Generator
) -> Array:
    """Draw parameters ``(number, n_parameters)`` from the estimate's normal.

    Unidentified directions are left out, and no relative spread is more than a tenth.
    """
    size = np.maximum(np.abs(values), 1e-12)
    rows = data.base * size
    variance = mean_square(data.residual_with([]), values.size)
    power, vectors = np.linalg.eigh(rows.T @ rows)
    determined = power > OPEN * power.max()
    sds = np.minimum(np.sqrt(variance / power[determined]), 0.1)
    drawn = rng.standard_normal((number, int(determined.sum()))) * sds
    lower = np.array([p.lower for p in chain.parameters])
    return np.asarray(np.maximum(values + (drawn @ vectors[:, determined].T) * size, lower))


def reported_gradients(
    chain: Joint, values: Array, observations: Sequence[Signals]
) -> dict[str, Array]:
    """Return derivatives ``(d,)`` of parameters and derived quantities by the parameters."""
    d, load = values.size, typical_load(chain, observations, values)
    steps = _STEP * np.maximum(np.abs(values), 1e-12)
    gradients = dict(zip(chain.names, np.eye(d), strict=True))
    return gradients | {q.name: x for q, _, x in derivatives(chain, values, steps, load)}
