"""Noise, searches for disturbances, and the statistics of candidate effects among replicates.

Outputs come in runs with gaps between them. A model that restarts at every gap cannot represent
slow noise, which then looks like a drift or a disturbance: so a Kalman filter predicts across gaps
(Jones, Technometrics 22 (1980) 389-395), and cosines of up to 1 Hz represent 1/f noise.

A search over places (of a sinusoidal or transient disturbance, or a far delay) is one candidate:
its statistic is the maximum over all places, and the maxima of the replicates are its null
distribution. Everything else is least squares of a residual on columns after the model's own
columns, the derivatives by its parameters, are projected out of both (Frisch and Waugh,
Econometrica 1, 1933). ``studies/diagnostics`` measured the thresholds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import betainc, ndtri_exp

from bayesfric.estimates import autoregression as ar
from bayesfric.estimates.autoregression import follows
from bayesfric.recordings.arrays import Array, Flags, Index
from bayesfric.recordings.signals import Signals

# Share of recordings with a right model in which anything is reported as missing.
FALSE_ALARMS = 0.05
# Simulated replicates; and samples of all recordings that are evaluated in full. Longer recordings
# are subsampled to half as many, so that a fit or check ends in reasonable time.
REPLICATES, LONGEST = 24, 100_000
# Outputs that a recording or replicate must have beyond the model's parameters; fewer of points at
# constant speed, whose noise has no autocorrelation.
LEAST_OUTPUTS, LEAST_POINTS = 20, 6
# Share of a candidate's columns that must be left after projecting out the model's own columns;
# below it, this motion does not identify the candidate.
TESTABLE = 0.015
# Largest number of effects included one after the other.
MAX_EFFECTS = 4
# Shares of the largest eigenvalue of a Gram matrix below which a direction is rounding, or
# unidentified.
_ROUNDING, OPEN = 1e-9, 1e-7
# Share of the replicates' mean that counts as spread: the recording may have it or not.
MEAN_AS_SPREAD = 0.5
SINUSOID, TRANSIENT, DELAY, TARGET_DELAY = "tone", "push", "delay", "target_delay"
# Delay of the position, or of a target that the torque is computed from.
DELAYS = DELAY, TARGET_DELAY


# Autocorrelated noise


def least_outputs(observations: Sequence[Signals]) -> int:
    """Return the outputs that are needed beyond the model's parameters."""
    return LEAST_POINTS if all(o.steady for o in observations) else LEAST_OUTPUTS


@dataclass(frozen=True, eq=False)
class Layout:
    """Where outputs lie in time, recording by recording."""

    # (M - 1,) of each recording: whether an output is followed by the next one step later
    runs: tuple[Flags, ...]
    at: tuple[Index, ...]  # (M,) of each: whole steps since its first output
    stamps: tuple[Array, ...]  # (M,) of each, s

    @classmethod
    def of(cls, observations: Sequence[Signals]) -> Layout:
        """Read it from preprocessed recordings."""
        steps = [np.round((o.time - o.time[:1].sum()) / o.period) for o in observations]
        return cls(
            tuple(follows(o) for o in observations),
            tuple(step.astype(np.int64) for step in steps),
            tuple(o.time for o in observations),
        )

    def split(self, x: Array) -> list[Array]:
        """Split rows ``(n, ...)`` by recording."""
        return np.split(x, np.cumsum([a.size for a in self.at])[:-1])

    @cached_property
    def timed(self) -> bool:
        """Whether any output follows another; points at constant speeds are in any order."""
        return any(flags.any() for flags in self.runs)

    @cached_property
    def outputs(self) -> int:
        """Number of outputs."""
        return sum(a.size for a in self.at)

    @cached_property
    def grid(self) -> tuple[float, float, int, Index]:
        """Grid of the periodogram: step and longest span in s, size, and index ``(n,)`` of outputs.

        Each recording has a part of its own, of ``size``.
        """
        steps = [float(np.median(np.diff(t))) for t in self.stamps if t.size > 1]
        step, span = float(np.median(steps)), max(float(np.ptp(t)) for t in self.stamps)
        size = 1 << math.ceil(math.log2(2.0 * span / step + 2.0))
        places = [
            np.round((t - t[0]) / step).astype(np.int64) + k * size
            for k, t in enumerate(self.stamps)
        ]
        return step, span, size, np.concatenate(places)

    @cached_property
    def members(self) -> list[Array]:
        """Indicator ``(n,)`` of each recording's outputs."""
        number = np.repeat(np.arange(len(self.at)), [a.size for a in self.at])
        return [(number == k).astype(np.float64) for k in range(len(self.at))]

    def drift_cosines(self) -> list[Array]:
        """Make cosines ``(M, K)`` a recording, ``cos(pi k (t - t0) / S) / sqrt(k)``, S its span.

        With independent normal coefficients of equal variance they are 1/f noise of up to 1 Hz. One
        for eight outputs at most, and sixty.
        """
        columns = []
        for t in self.stamps:
            span = float(np.ptp(t))
            count = int(min(max(2.0 * span, 4), t.size / 8, 60))
            order = np.arange(1, count + 1)
            phase = np.pi * order * (t - t[0])[:, None] / span
            columns.append(np.cos(phase) / np.sqrt(order))
        return columns


@dataclass(frozen=True, eq=False)
class Autocorrelation:
    """Autocorrelation of noise: autoregressive, plus low-frequency drift."""

    partial: Array  # (p,) partial autocorrelations, each between -1 and 1
    drift: float = 0.0  # standard deviation of its slowest cosine over the innovations'

    def whitened(self, x: Array, layout: Layout) -> Array:
        """Whiten columns ``(n, m)``, a few at once.

        With W the whitened cosines times their size, the drift is whitened by ``(I + W
        W')^(-1/2)``, which is ``I - W (R + R^2)^-1 W'`` with ``R = (I + W' W)^(1/2)``.
        """
        out, innovations = np.empty_like(x), ar.across_gaps(self.partial)
        cosines = layout.drift_cosines() if self.drift else [np.empty((0, 0))] * len(layout.at)
        for part, into, at, waves in zip(
            layout.split(x), layout.split(out), layout.at, cosines, strict=True
        ):
            if self.drift:
                wave = innovations(waves, at)[0] * self.drift
                size, vectors = np.linalg.eigh(wave.T @ wave)
                root, turned = np.sqrt(1.0 + size)[:, None], wave @ vectors
            for columns in blocks(x.shape[1]):
                white = innovations(part[:, columns].astype(np.float64), at)[0]
                if self.drift:
                    white = white - turned @ ((turned.T @ white) / (root + root**2))
                into[:, columns] = white
        return out

    def drawn(self, layout: Layout, rng: np.random.Generator) -> Array:
        """Draw one series ``(n,)`` with unit innovations."""
        parts = []
        for at in layout.at:
            joined = np.ones(int(at[-1]), dtype=np.bool_)
            parts.append(ar.simulated(self.partial, joined, 1, rng)[0][at])
        x = np.concatenate(parts)
        if self.drift:
            drifts = [x @ rng.standard_normal(x.shape[1]) for x in layout.drift_cosines()]
            x = x + self.drift * np.concatenate(drifts)
        return x

    def variance(self, layout: Layout) -> float:
        """Mean variance of an output over the innovations' variance."""
        variance = float(ar.variances(self.partial[None])[0][0])
        if self.drift:
            power = sum(float((cosines**2).sum()) for cosines in layout.drift_cosines())
            variance += self.drift**2 * power / layout.outputs
        return variance


WHITE = Autocorrelation(np.zeros(0))


def choose_autocorrelation(
    left: Array,
    layout: Layout,
    sizes: Sequence[float] = (0.0, 0.15, 0.45, 1.35, 4.0),
    outputs: int = 20,
) -> tuple[Autocorrelation, float]:
    """Choose order and drift of the noise of a residual ``(n,)`` by BIC, which is returned, too.

    ``sizes`` of the drift are tried, over the innovations' standard deviation; each order needs
    ``outputs``. For each size the order is chosen by ``n sum(log(1 - partial^2)) + p log(n)``;
    sizes are compared by the exact density, ``n log(variance) + log det + p log(n)`` (Schwarz,
    Annals of Statistics 6 (1978) 461-464).
    """
    n, best, least, cosines = left.size, WHITE, math.inf, layout.drift_cosines()
    for size in sizes if n > 2 * outputs else sizes[:1]:
        rest = left
        if size:  # the order describes what the drift leaves
            rest = left - _expected_drift(left, best.partial, size, layout, cosines)[0]
        order = min(6, n // outputs)
        partial = ar.burg(layout.split(rest), layout.runs, order)
        costs = n * np.cumsum(np.log1p(-(partial**2))) + np.arange(1, order + 1) * math.log(n)
        partial = partial[: int(np.argmin(np.append(0.0, costs)))]
        _, power, cost = _expected_drift(left, partial, size, layout, cosines)
        bic = n * math.log(max(power, 1e-300) / n) + cost + partial.size * math.log(n)
        if bic < least:
            least, best = bic, Autocorrelation(partial, size)
        elif best.drift:
            break
    return best, least


def _expected_drift(
    left: Array, partial: Array, size: float, layout: Layout, cosines: Sequence[Array]
) -> tuple[Array, float, float]:
    """Return the expected drift ``(n,)``, the power it leaves, and the log determinant.

    It is a ridge regression on whitened cosines.
    """
    drift, power, logs, innovations = [], 0.0, 0.0, ar.across_gaps(partial)
    for part, at, waves in zip(layout.split(left), layout.at, cosines, strict=True):
        white, log = innovations(np.column_stack([waves * size, part] if size else [part]), at)
        wave, y = white[:, :-1], white[:, -1]
        inner = wave.T @ wave + np.eye(wave.shape[1])
        scores = wave.T @ y
        shares = np.linalg.solve(inner, scores)
        if size:
            drift.append(size * (waves @ shares))
        power += float(y @ y - scores @ shares)
        logs += log + float(np.linalg.slogdet(inner)[1])
    return np.concatenate(drift or [left]), power, logs


# Searches for sinusoidal and transient disturbances


@dataclass(frozen=True)
class Scan:
    """Maximum of one search."""

    kind: str  # SINUSOID, TRANSIENT, or one of :data:`DELAYS`
    # reduction of the residual's sum of squares over the residual's variance, about twice the rise
    # of the log-likelihood; for sinusoids and delays the variance is that after the fit
    peak: float
    place: float  # Hz of a sinusoid, s of a transient or delay
    recording: int = 0  # index of the recording with the transient


def sinusoidal_disturbance(y: Array, layout: Layout) -> Scan:
    """Find the largest peak of the periodogram of a whitened residual ``(n,)``.

    The power P of a frequency is chi squared with two degrees of freedom in white noise; the gain
    is ``P / (1 - P/n)``, which orders peaks as Fisher's test does (Proceedings of the Royal Society
    A 125 (1929) 54-59). Frequencies are from two periods of the recording to 0.45 of the rate.
    """
    step, span, size, places = layout.grid
    rows = np.bincount(places, y, len(layout.at) * size).reshape(-1, size)
    power = (np.abs(np.fft.rfft(rows)) ** 2).sum(axis=0)
    f = np.fft.rfftfreq(size, step)
    inside = (f >= 2.0 / span) & (f <= 0.45 / step) & layout.timed
    power = np.where(inside, power, 0.0) / (0.5 * float(y @ y))
    power = power / np.maximum(1.0 - power / y.size, 1e-6)
    i = int(np.argmax(power))
    return Scan(SINUSOID, float(power[i]), float(f[i]))


def transient_disturbance(y: Array, layout: Layout, width: float) -> Scan:
    """Find the window in which the mean of a whitened residual ``(n,)`` deviates most.

    It is three widths long, and has at least three outputs.
    """
    best = Scan(TRANSIENT, 0.0, 0.0)
    variance = float(np.mean(y**2))
    for k, (t, x) in enumerate(zip(layout.stamps, layout.split(y), strict=True)):
        if not layout.timed:
            break
        centres = np.arange(t[0] + width, t[-1], width)
        first = np.searchsorted(t, centres - 1.5 * width)
        last = np.searchsorted(t, centres + 1.5 * width)
        sums = np.concatenate([[0.0], np.cumsum(x)])
        counts = last - first
        gains = np.where(counts >= 3, (sums[last] - sums[first]) ** 2, 0.0)
        gains /= np.maximum(counts, 1) * variance
        if gains.size and gains.max() > best.peak:
            i = int(np.argmax(gains))
            best = Scan(TRANSIENT, float(gains[i]), float(centres[i]), k)
    return best


def sinusoid_columns(layout: Layout, hertz: float) -> Array:
    """Return sine and cosine for each of K recordings, ``(n, 2 K)``."""
    angle = 2.0 * np.pi * hertz * np.concatenate(layout.stamps)
    members = layout.members
    return np.stack(
        [wave(angle) * member for member in members for wave in (np.sin, np.cos)], axis=1
    )


def transient_columns(layout: Layout, scan: Scan, width: float) -> Array:
    """Return five bell curves ``(n, 5)`` around a transient, spaced by their sd ``width``, s."""
    t = np.concatenate(layout.stamps)[:, None]
    bells = np.exp(-0.5 * ((t - scan.place) / width - np.arange(-2, 3)) ** 2)
    return np.asarray(bells * layout.members[scan.recording][:, None])


def tune_frequency(
    y: Array, layout: Layout, hertz: float, project: Callable[[Array], Array]
) -> float:
    """Refine a sinusoid's frequency so that it leaves least of a residual ``(n,)``.

    It is less than a period of the longest recording off. ``project`` whitens columns and projects
    the model's out.
    """
    period = max(float(np.ptp(stamps)) for stamps in layout.stamps)

    def power(f: float) -> float:
        x = project(sinusoid_columns(layout, f))
        return float(((y - x @ np.linalg.lstsq(x, y, rcond=1e-9)[0]) ** 2).sum())

    bounds = hertz - 0.8 / period, hertz + 0.8 / period
    best = minimize_scalar(power, bounds=bounds, method="bounded", options={"xatol": 1e-5 / period})
    return float(best.x)


# Columns of candidates


@dataclass(frozen=True)
class Key:
    """Candidate that a column belongs to."""

    kind: str
    shape: str
    number: int
    # Whether it is a nuisance column, which only represents shapes between those of a grid.
    nuisance: bool = False
    # Far delay, s, or 0: its first column has coefficient one, the second is the torque's rate.
    delay: float = 0.0


@dataclass(frozen=True, eq=False)
class Columns:
    """Filtered regression columns of one recording or replicate, or of several together."""

    base: Array  # (n, d) derivatives of the torque by the model's parameters
    # (n, m) columns of the candidates, each contiguous; of replicates in single precision
    others: Array
    residual: Array  # (n,) torque less the model's, N m or N
    layout: Layout
    keys: tuple[Key, ...]
    autocorrelation: Autocorrelation = WHITE  # of the noise
    others_whitened: bool = False  # whether the candidates' columns are whitened by it already

    @property
    def whitened(self) -> Columns:
        """The same with whitened noise."""
        # not cached: a reference to itself would keep it in memory
        return self if self.autocorrelation is WHITE else self._whitened

    @cached_property
    def _whitened(self) -> Columns:
        with_residual = np.column_stack([self.base, self.residual])
        white, others = self.autocorrelation.whitened(with_residual, self.layout), self.others
        if not self.others_whitened:
            others = self.autocorrelation.whitened(others, self.layout)
        base, residual = white[:, :-1], white[:, -1]
        return replace(self, base=base, others=others, residual=residual, autocorrelation=WHITE)

    def with_noise(self, noise: Autocorrelation) -> Columns:
        """Whiten the candidates' columns once for all."""
        others = noise.whitened(self.others, self.layout)
        return replace(self, others=others, others_whitened=True, autocorrelation=noise)

    def with_candidates(self, extra: Sequence[int]) -> Array:
        """Append columns of candidates, by number, to the model's own: ``(n, d + k)``."""
        return np.column_stack([self.base, self.others[:, extra]]) if len(extra) else self.base

    def residual_with(self, extra: Sequence[int]) -> Array:
        """Return the residual ``(n,)`` when columns ``extra`` are fitted, too."""
        return project_out(basis_of(self.with_candidates(extra)), self.residual)


def candidate_groups(d: Columns, equal: float = 0.9999) -> list[tuple[Key, list[int]]]:
    """Group columns by candidate; drop those collinear with the model's or each other.

    Columns of a correlation above ``equal`` are the same.
    """
    groups: dict[tuple[str, str], list[int]] = {}
    for i, key in enumerate(d.keys):
        if not (key.nuisance or key.delay):
            groups.setdefault((key.kind, key.shape), []).append(i)
    base = basis_of(d.base)
    candidates: list[tuple[Key, list[int]]] = []
    singles: list[Array] = []
    for members in groups.values():
        independent, basis = [], base
        for i in members:
            column = d.others[:, i]
            remainder = project_out(basis, project_out(basis, column))
            if np.linalg.norm(remainder) > TESTABLE * np.linalg.norm(column) > 0.0:
                independent.append(i)
                basis = np.column_stack([basis, remainder / np.linalg.norm(remainder)])
        if not independent:
            continue
        if len(independent) == 1:
            remainder = project_out(base, d.others[:, independent[0]])
            remainder = remainder / np.linalg.norm(remainder)
            # one column of several may equal another candidate
            if len(members) > 1 and any(abs(remainder @ x) > equal for x in singles):
                continue
            singles.append(remainder)
        candidates.append((d.keys[independent[0]], independent))
    return candidates


# Least squares


def basis_of(x: Array) -> Array:
    """Return an orthonormal basis ``(n, k)`` of the span of columns ``(n, d)``."""
    size = np.sqrt((x**2).sum(axis=0))
    x = x[:, size > 0.0] / size[size > 0.0]
    if not x.size:
        return np.zeros((len(x), 0))
    power, vectors = np.linalg.eigh(x.T @ x)
    nonzero = power > _ROUNDING * power.max()
    return np.asarray(x @ (vectors[:, nonzero] / np.sqrt(power[nonzero])))


def project_out(basis: Array, x: Array) -> Array:
    """Project an orthonormal basis ``(n, k)`` out of a column ``(n,)`` or columns ``(n, m)``."""
    return np.asarray(x - basis @ (basis.T @ x))


def blocks(count: int, size: int = 64) -> list[slice]:
    """Split a number of columns into blocks, whose copies in double precision are small."""
    return [slice(first, first + size) for first in range(0, count, size)]


def projected_moments(basis: Array, x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
    """Return moments of columns ``(n, m)``, a few at once, and a residual ``(n,)`` without a basis.

    ``basis'x`` ``(k, m)``, ``x'y`` ``(m,)``, and the columns' norms before and after the basis is
    projected out. The residual is orthogonal to it.
    """
    cross, (scores, squares) = np.empty((basis.shape[1], x.shape[1])), np.empty((2, x.shape[1]))
    for columns in blocks(x.shape[1]):
        part = x[:, columns].astype(np.float64)
        cross[:, columns], scores[columns] = basis.T @ part, y @ part
        squares[columns] = np.einsum("ij,ij->j", part, part)
    remaining = np.maximum(squares - (cross**2).sum(axis=0), 0.0)
    return cross, scores, np.sqrt(squares), np.sqrt(remaining)


def mean_square(x: Array, parameters: int = 0) -> float:
    """Return the variance of a residual ``(n,)`` after fitting a number of parameters."""
    return float(x @ x) / max(x.size - parameters, 1)


def truncated_least_squares(x: Array, y: Array, size: Array) -> tuple[Array, Array, Array]:
    """Solve ``x b = y`` along the directions that the columns ``(n, d)`` determine.

    Returns estimate ``(d,)``, covariance ``(d, d)`` and these directions ``(d, k)``; ``size``
    ``(d,)`` scales the parameters.
    """
    rows = x * size
    unit = np.sqrt((rows**2).sum(axis=0))
    unit[unit == 0.0] = 1.0
    power, vectors = np.linalg.eigh((rows / unit).T @ (rows / unit))
    identified = power > OPEN * power.max()
    inverse = (
        (vectors[:, identified] / power[identified])
        @ vectors[:, identified].T
        / np.outer(unit, unit)
    )
    solution = inverse @ (rows.T @ y)
    variance = mean_square(y - rows @ solution, int(identified.sum()))
    directions = np.linalg.qr(vectors[:, identified] * unit[:, None])[0]
    return solution * size, variance * inverse * np.outer(size, size), directions


# Statistics of one recording or replicate: joint t ``(k,)`` of each candidate's k coefficients, NaN
# if not identified; gains ``(m,)`` in chi squared; and the largest sinusoidal and transient
# disturbance and far delay.
CandidateScores = tuple[list[Array], Array, tuple[Scan, ...]]


def score_candidates(
    d: Columns,
    groups: Sequence[tuple[Key, list[int]]],
    extra: Sequence[int],
    width: float,
    singular: float = 1e-4,
) -> CandidateScores:
    """Test every candidate in addition to the model's own columns and those already included.

    With whitened columns z and residual y, the model's own projected out, ``b = (z'z)^-1 z'y``; t
    is b over its standard deviations, and the gain ``b'z'y`` over the variance of the residual.
    Columns with an eigenvalue below ``singular`` are collinear.
    """
    white = d.whitened
    basis = basis_of(white.with_candidates(extra))
    y = project_out(basis, white.residual)
    free, power = y.size - basis.shape[1], float(y @ y)
    cross, scores, size, remaining = projected_moments(basis, white.others, y)
    identified = remaining > TESTABLE * size
    unit = np.where(remaining > 0.0, remaining, 1.0)
    slopes = scores / unit

    def gram_of(members: Index) -> Array:
        x, shares = white.others.T[members].astype(np.float64), cross[:, members]
        return np.asarray(x @ x.T - shares.T @ shares)

    has_delay = any(d.keys[i].delay for i in extra)
    delay = _delayed(() if has_delay else d.keys, gram_of, scores, power, free)
    t_values = [np.full(len(members), np.nan) for _, members in groups]
    gains = np.zeros(len(groups))
    for k in {len(members) for _, members in groups}:  # all of one size at once
        same_size = np.array([i for i, (_, members) in enumerate(groups) if len(members) == k])
        members = np.array([groups[i][1] for i in same_size])
        gram = np.ones((len(members), 1, 1))
        if k > 1:
            gram = np.array([gram_of(group) for group in members])
            gram /= unit[members][:, :, None] * unit[members][:, None, :]
        least, axes = np.linalg.eigh(gram)
        solvable = identified[members].all(axis=1) & (least[:, 0] >= singular)
        inverse = (axes[solvable] / least[solvable][:, None]) @ axes[solvable].mT
        slope = slopes[members[solvable]]
        b = np.einsum("gij,gj->gi", inverse, slope)
        explained = (b * slope).sum(axis=1)
        variance = np.maximum(power - explained, 1e-12 * power) / max(free - k, 1)
        spread = variance[:, None] * np.diagonal(inverse, axis1=1, axis2=2)
        gains[same_size[solvable]] = explained / variance
        for i, t in zip(same_size[solvable], b / np.sqrt(spread), strict=True):
            t_values[i] = t
    scans = sinusoidal_disturbance(y, d.layout), transient_disturbance(y, d.layout, width), delay
    return t_values, gains, scans


def _delayed(
    keys: Sequence[Key],
    gram_of: Callable[[Index], Array],
    scores: Array,
    power: float,
    free: int,
) -> Scan:
    """Find the far delay with the smallest residual, from moments of columns and residual.

    Its first column has coefficient one; only that of the torque's rate is fitted.
    """
    first = [i for i, key in enumerate(keys) if key.delay and key.number == 0]
    if not first:
        return Scan(DELAY, 0.0, 0.0)
    change, rate = np.array(first), np.add(first, 1)
    grams = np.array([gram_of(pair) for pair in np.transpose([change, rate])])
    shifted = power - 2.0 * scores[change] + grams[:, 0, 0]
    explained = (scores[rate] - grams[:, 0, 1]) ** 2 / np.maximum(grams[:, 1, 1], 1e-300)
    remaining = np.maximum(shifted - explained, 1e-12 * power)
    gains = (power - remaining) / remaining * (free - 2)
    best = int(np.argmax(gains))
    return Scan(keys[first[0]].kind, max(float(gains[best]), 0.0), keys[first[best]].delay)


def standard_normal_scores(
    recorded: CandidateScores, others: Sequence[CandidateScores]
) -> tuple[Array, Array]:
    """Score each statistic among the replicates' as a standard normal, disturbances last.

    The squared distance of a candidate's t from the replicates' mean, in their covariance, is
    Hotelling's (Annals of Mathematical Statistics 2 (1931) 360-378). The maximum of a disturbance
    search is assumed to be Gumbel distributed, with the replicates' mean and standard deviation.
    Returns scores ``(m,)`` of the recording and ``(n, m)`` of the replicates.
    """
    recorded_t, _, scans = recorded
    n, m = len(others), len(recorded_t)
    z, null = np.zeros(m + len(scans)), np.zeros((n, m + len(scans)))
    for i, x in enumerate(recorded_t):
        t = np.array([other_t[i] for other_t, *_ in others])
        if np.isnan(x).any() or np.isnan(t).any():
            continue
        mean, cov = t.mean(axis=0), np.atleast_2d(np.cov(t.T))
        wide = _shrunk(cov) + MEAN_AS_SPREAD**2 * np.outer(mean, mean)
        distance = float((x - mean) @ np.linalg.solve(wide, x - mean))
        z[i] = float(_normal(np.array(distance), x.size, n))
        # each replicate is left out of mean and covariance
        deviation = (t - mean) * n / (n - 1)
        pairs = deviation[:, :, None] * deviation[:, None, :]
        covariances = _shrunk(((n - 1) * cov - (n - 1) / n * pairs) / (n - 2))
        h = np.einsum("ij,ijk,ik->i", deviation, np.linalg.inv(covariances), deviation)
        null[:, i] = _normal(h, x.size, n - 1)
    for i, scan in enumerate(scans):
        peaks = np.array([other_scans[i].peak for *_, other_scans in others])
        mean = (peaks.sum() - peaks) / (n - 1)
        sd = np.array([np.delete(peaks, k).std(ddof=1) for k in range(n)])
        # at least a unit of chi squared
        sd, all_sd = np.maximum(sd, 1.0), max(float(peaks.std(ddof=1)), 1.0)
        z[m + i] = _extreme(np.array((scan.peak - peaks.mean()) / all_sd))
        null[:, m + i] = _extreme((peaks - mean) / sd)
    return z, null


def _shrunk(covariance: Array) -> Array:
    """Shrink the off-diagonal elements of covariances ``(..., k, k)`` by a tenth."""
    identity = np.eye(covariance.shape[-1])
    return np.asarray(covariance * (0.9 + 0.1 * identity) + 1e-9 * identity)


def _normal(square: Array, k: int, n: int) -> Array:
    """Convert Hotelling's squared distance, k-dimensional, to a standard normal score."""
    f = square * n / (n + 1) / (n - 1)
    p = betainc(0.5 * (n - k), 0.5 * k, 1.0 / (1.0 + f))
    return np.asarray(-ndtri_exp(np.minimum(np.log(np.maximum(p, 1e-300) / 2.0), -1e-12)))


def _extreme(u: Array) -> Array:
    """Convert a standardised Gumbel variable to a normal score."""
    g = u * math.pi / math.sqrt(6.0) + float(np.euler_gamma)
    small = np.maximum(-np.expm1(-np.exp(-np.minimum(g, 20.0))), 1e-12)
    logs = np.where(g > 20.0, -g, np.log(small))
    return np.asarray(-ndtri_exp(logs - math.log(2.0)))


def unit_scores(d: Columns) -> tuple[Array, float]:
    """Return scores of unit columns of a whitened replicate, and the residual's sd."""
    base = basis_of(d.base)
    residual = project_out(base, d.residual)
    _, scores, _, unit = projected_moments(base, d.others, residual)
    return scores / np.where(unit > 0.0, unit, np.inf), math.sqrt(
        mean_square(residual, base.shape[1])
    )
