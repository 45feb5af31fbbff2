"""Every parameter from the error of a simulated position: the output error, section 4.3.

Every segment of a recording is simulated from its own initial state, driven by the measured
torque: multiple shooting without continuity constraints. Segments do not depend on each other, so
moving all their initial positions (or speeds) at once differentiates by each of them, and one QR
decomposition a segment takes them out of the least-squares problem (variable projection).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from bayesfric.base.errors import BadInput
from bayesfric.estimates.assemble import (
    assemble,
    bounds_met,
    centred,
    open_directions,
    units_of,
)
from bayesfric.estimates.information import LEAST_GROUPS, Information
from bayesfric.estimates.input_error import TorqueProblem
from bayesfric.estimates.point_estimate import Estimate, Estimation, Knowledge
from bayesfric.estimates.torque import torque_jacobian
from bayesfric.estimates.trajectory import Trajectory, divided
from bayesfric.mechanism.forward import simulate_segments
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array, rms
from bayesfric.recordings.signals import Signals

# Relative steps of finite differences: measured, truncation and rounding are below 1e-7.
_STEP = 1e-5
# Repetitions: of weighing recordings and priors, of restarts from measured states, of fits of the
# states alone.
_WEIGHINGS, _RESTARTS, _STATE_STEPS = 4, 3, 20


def output_error(
    joint: Joint,
    trajectories: Sequence[Trajectory],
    observations: Sequence[Signals],
    knowledge: Knowledge,
    options: Estimation,
    start: Estimate,
) -> Estimate:
    """Estimate by simulation, section 4.3: the least ``||q - qc||``.

    The measured torque drives the simulated joint; parameters and the state at the start of
    every segment are fitted to the measured position, unfiltered.

    Parameters
    ----------
    joint
        The mechanism.
    trajectories
        Recordings to simulate, not yet divided into segments.
    observations
        The same recordings, prepared for the input error.
    knowledge
        Fixed values, bounds, and values with a standard deviation, one more residual each.
    options
        Time limit, and segment length and steps where these are given.
    start
        The input error, with a value for every parameter.

    Returns
    -------
    Estimate
        Not converged, and without standard deviations, where the search ended in no minimum or ran
        out of time.

    Raises
    ------
    BadInput
        If the joint has no inertia or cannot be simulated.

    Notes
    -----
    ``sd`` is for white noise of the position. Noise of the torque drives the simulated joint, so
    residuals within a segment drift together; ``sd_robust`` rests on segments being independent of
    each other. They last 0.5 s, or less where that leaves fewer than two for each parameter. The
    search begins at the input error.
    """
    inertia = [p.name for p in joint.parameters if p.quantity == "inertia"]
    inertias = [n for n in inertia if knowledge.fixed.get(n, 1.0) > 0.0]
    if not inertias and not all(t.inputs.added_mass for t in trajectories):
        raise BadInput(
            "mechanism",
            "has no inertia, so a torque does not determine a motion to compare with",
            "give an element or the load inertia, or use the input error",
        )
    problem = OutputError(joint, trajectories, observations, knowledge, options)
    values = joint.vector({**dict(start.point), **knowledge.fixed})
    if not problem.fit(values):
        raise BadInput(
            ", ".join(f"recording '{t.name}'" for t in trajectories),
            "the joint cannot be simulated: the torque gives no bounded motion",
            "check units and sign of the torque, bound the load_loss, or shorten 'segment'",
        )
    return problem.estimate(values)


class Shooting:
    """Simulation of recordings, each of their K segments from its own state."""

    def __init__(self, joint: Joint, trajectories: Sequence[Trajectory], substeps: int) -> None:
        self.chain, self.trajectories, self.substeps = joint, tuple(trajectories), substeps
        # (n,) position inside the segments of all recordings, rad or m; of each sample the
        # recording, the segment counted over all, the place on an even grid of time
        self.measured = np.concatenate([t.position[t.samples] for t in trajectories])
        sizes = [t.samples.size for t in trajectories]
        self.recording_of = np.repeat(np.arange(len(sizes)), sizes)
        lengths = np.concatenate([np.diff(t.segments, axis=1)[:, 0] for t in trajectories])
        # (K + 1,): segment k is borders[k]:borders[k + 1] of these
        self.borders = np.concatenate([[0], np.cumsum(lengths)])
        self.segment_of = np.repeat(np.arange(lengths.size), lengths)
        self.periods = np.repeat(
            [t.period for t in trajectories], [len(t.segments) for t in trajectories]
        )
        # (K, 2) position and speed to start the search for the initial states from
        self.initial = np.concatenate([np.stack([t.q0, t.qd0], axis=1) for t in trajectories])
        # a gap of a tenth of the recording keeps it from being a neighbour of the next
        spans = [t.position.size + t.position.size // 10 + 1 for t in trajectories]
        firsts = np.cumsum([0, *spans[:-1]])
        self.places = np.concatenate(
            [t.samples + first for t, first in zip(trajectories, firsts, strict=True)]
        )

    def positions(self, values: Array, states: Array, substeps: int | None = None) -> Array:
        """Simulate the positions ``(m, n)`` of vectors ``(m, n_parameters)``; NaN if unstable.

        ``states`` are ``(K, 2)``, or ``(m, K, 2)`` for each vector.
        """
        return self.motion(values, states, substeps)[0]

    def motion(
        self, values: Array, states: Array, substeps: int | None = None
    ) -> tuple[Array, Array]:
        """Simulate as :meth:`positions` does; positions and speeds, ``(m, n)`` each."""
        m = values.shape[0]
        states = np.broadcast_to(states, (m, len(self.initial), 2))
        blocks, first = [], 0
        for t in self.trajectories:
            part = states[:, first : first + len(t.segments)]
            first += len(t.segments)
            simulated = simulate_segments(
                self.chain,
                values,
                t.torque,
                t.period,
                t.segments,
                part[..., 0],
                part[..., 1],
                inputs=t.inputs,
                begin=float(t.time[0]),
                hold=t.hold,
                substeps=self.substeps if substeps is None else substeps,
            )
            blocks.append([x[:, t.samples] for x in simulated])
        q, qd = (np.concatenate(both, axis=1) for both in zip(*blocks, strict=True))
        return q, qd

    def sensitivities(
        self, values: Array, states: Array, steps: Array, state_steps: tuple[float, float]
    ) -> tuple[Array, Array, Array]:
        """Simulate and differentiate, all finite differences side by side.

        Gives positions ``(n,)``, their derivatives ``(n, d)`` by the parameters with a step
        ``(n_parameters,)``, and ``(n, 2)`` by position and speed at the start of the segment that
        each sample is in: central differences, one-sided of the same order at an end of the
        support.
        """
        moving = np.flatnonzero(steps)
        d, h = moving.size, steps[moving]
        lower, upper = np.array([(p.lower, p.upper) for p in self.chain.parameters])[moving].T
        first = np.where(values[moving] - h < lower, 1.0, -1.0)
        second = np.where(first > 0, 2.0, np.where(values[moving] + h > upper, -2.0, 1.0))
        # (2 sides, d parameters and both states), then the middle
        widths = np.array([[*(first * h), *state_steps], [*(second * h), *state_steps]])
        widths[1, d:] *= -1.0
        rows = widths.size + 1
        vectors, starts = np.tile(values, (rows, 1)), np.tile(states, (rows, 1, 1))
        for side, changes in enumerate(widths):
            begin = side * (d + 2)
            vectors[begin + np.arange(d), moving] += changes[:d]
            for i in range(2):
                starts[begin + d + i, :, i] += changes[d + i]
        *ends, middle = self.positions(vectors, starts)
        # slope at the middle of the parabola through the three
        a, b = widths[:, :, None]
        up, down = (np.array(ends) - middle).reshape(2, d + 2, -1)
        both = (up * b / a - down * a / b) / (b - a)
        # where one side gives no motion, the other's slope
        one_sided = np.where(np.isfinite(up), up / a, down / b)
        slopes = np.where(np.isfinite(up) & np.isfinite(down), both, one_sided).T
        return middle, slopes[:, :d], slopes[:, d:]

    def follow(
        self, values: Array, states: Array, change: Array, weights: Array
    ) -> tuple[Array, Array]:
        """Give each segment the share of a change of its state ``(K, 2)`` that suits it best.

        States and residuals ``(n,)`` at a vector; NaN where no share gives a motion. Where a
        segment starts at standstill, Newton's steps only ever halve its speed: zero is tried, too.
        """
        starts = np.array([states + share * change for share in (1.0, 0.2, 0.0)])
        starts = np.concatenate([starts, [(states + change) * (1.0, 0.0)]])
        residuals = self.measured - self.positions(np.tile(values, (len(starts), 1)), starts)
        costs = np.add.reduceat((residuals * weights) ** 2, self.borders[:-1], axis=1)
        best = np.argmin(np.where(np.isfinite(costs), costs, np.inf), axis=0)
        left = residuals[best[self.segment_of], np.arange(self.measured.size)]
        return starts[best, np.arange(best.size)], left


def eliminate_states(
    shooting: Shooting, by_state: Array, columns: Array, *, least_reach: float = 1e-2
) -> tuple[Array, Array, int]:
    """Take the states' derivatives ``(n, 2)`` out of columns ``(n, k)``, segment by segment.

    Gives the columns projected, their coefficients in the states ``(K, 2, k)``, and the number of
    states. An initial speed that carries the joint for less than ``least_reach`` of a sample, as
    where it sticks, is noise of the differences, and left out.
    """
    projected = columns.copy()
    onto = np.zeros((len(shooting.initial), 2, columns.shape[1]))
    eliminated = 0
    for k, (a, b) in enumerate(pairwise(shooting.borders)):
        q, r = np.linalg.qr(by_state[a:b])
        rank = 2 if abs(r[1, 1]) > least_reach * shooting.periods[k] * abs(r[0, 0]) else 1
        eliminated += rank
        coefficients = q[:, :rank].T @ columns[a:b]
        projected[a:b] -= q[:, :rank] @ coefficients
        onto[k, :rank] = np.linalg.solve(r[:rank, :rank], coefficients)
    return projected, onto, eliminated


def resolution(position: Array) -> float:
    """Smallest change of position ``(N,)`` that a recording resolves.

    The larger of the smallest step between values and the noise of neighbouring samples (third
    differences: motion itself hardly shows in them).
    """
    span = float(np.ptp(position))
    gaps = np.diff(np.unique(position))
    # rounding of a conversion of units is not a step of the encoder
    gaps = gaps[gaps > 1e-9 * span]
    step = float(gaps.min()) if gaps.size else 0.0
    noise = float(np.median(np.abs(np.diff(position, 3)))) / (0.6745 * np.sqrt(20.0))
    return float(max(step, noise, 1e-9 * span, 1e-12))


def choose_substeps(
    shooting: Shooting,
    values: Array,
    states: Array,
    small: float | None = None,
    limit: int = 64,
) -> tuple[int, float]:
    """Choose integration steps a sample: the fewest powers of two that err little.

    ``small`` is the tolerated error, if left out a hundredth of the encoder's resolution.
    """
    if small is None:
        small = 0.01 * min(resolution(t.position) for t in shooting.trajectories)
    substeps = 1
    coarse = shooting.positions(values[None], states, substeps)[0]
    while True:
        fine = shooting.positions(values[None], states, 2 * substeps)[0]
        error = float(np.nanmax(np.abs(fine - coarse))) * 16.0 / 15.0
        if not error > small or substeps >= limit:
            return substeps, error
        substeps, coarse = 2 * substeps, fine


class OutputError:
    """Fit of simulated to measured position; after :meth:`fit` it has the attributes below."""

    values: Array  # (n_parameters,)
    states: Array  # (K, 2)
    residual: Array  # (n,) measured minus simulated position, rad or m
    weights: Array  # (n,) of the residuals
    units: Array  # (d,) change of each free parameter that changes the torque by its rms
    # of the free parameters, those on a bound included: held, others would look far too certain
    information: Information
    at_bound: NDArray[np.int_]  # (d,): -1 on the lower bound, 1 on the upper, else 0
    converged: bool

    def __init__(
        self,
        joint: Joint,
        trajectories: Sequence[Trajectory],
        observations: Sequence[Signals],
        knowledge: Knowledge,
        options: Estimation,
    ) -> None:
        self.chain, self.knowledge, self.options = joint, knowledge, options
        self.observations = tuple(observations)
        self.torque = TorqueProblem(joint, observations, knowledge)
        self.columns = self.torque.columns
        self.deadline = time.process_time() + options.max_seconds
        length = options.segment or segment_length(trajectories, self.columns.size)
        parts = [divided(t, o, length) for t, o in zip(trajectories, observations, strict=True)]
        self.shooting = Shooting(joint, parts, options.substeps or 1)
        # sd of the rounding to counts, of each recording, rad or m
        self.grain = np.array([resolution(t.position[t.samples]) for t in trajectories]) / 12**0.5
        # steps of the states' differences
        speeds = np.concatenate([o.qd for o in observations])
        self.span = max(float(np.ptp(t.position)) for t in trajectories) or 1e-12
        speed = max(rms(speeds), 1e-12)
        self._state_steps = _STEP * self.span, _STEP * speed

    @property
    def late(self) -> bool:
        """Whether the time for the search is over."""
        return time.process_time() >= self.deadline

    def fit(self, values: Array) -> bool:
        """Fit from a start ``(n_parameters,)``; whether the joint can be simulated there.

        Recordings and priors are weighed four times by the residuals. A bad start can drive a state
        into a separate minimum (a joint that stops where the measured one passes) that no small
        step leaves: segments that fit better from their measured state are fitted again from there.
        Along an open scaling the fit is moved to the middle of what a gearbox allows.
        """
        shooting = self.shooting
        self.values = self.torque.vector(self.torque.inside(values))
        self.states, self.residual = self._with_states()
        if not np.isfinite(self.residual).all():
            return False
        if self.options.substeps is None:
            shooting.substeps, _ = choose_substeps(shooting, self.values, self.states)
        self.units = self._units()
        late = False
        several = len(shooting.trajectories) > 1
        for _ in range(_WEIGHINGS if several or self.knowledge.priors else 1):
            self.weights = self._weights()
            for _ in range(_RESTARTS + 1):
                late = self._search()
                restarted, residual = self._with_states()
                before, after = (
                    np.add.reduceat((self.weights * r) ** 2, shooting.borders[:-1])
                    for r in (self.residual, residual)
                )
                better = after < (1.0 - 1e-6) * before
                if late or (before - after)[better].sum() <= 1e-6 * before.sum():
                    break
                self.states = np.where(better[:, None], restarted, self.states)
        values = centred(self.chain, self.knowledge, self.observations, self.values)
        values = self.torque.vector(self.knowledge.on_turn(self.chain, values[self.columns]))
        self.values = values
        self.residual = shooting.measured - shooting.positions(values[None], self.states)[0]
        self.at_bound = self._bounds_met(values[self.columns])
        projected, _, eliminated = self._linearised(values, self.states)
        rows, _ = self.knowledge.rows(self.chain)
        self.information = Information(
            projected[:, 1:],
            projected[:, 0],
            self.units,
            places=shooting.places,
            known=rows,
            known_null=self._open_directions(values),
            tolerance=1e-6,  # finite differences carry errors of 1e-8
            groups=shooting.segment_of,
            lost=eliminated,
            least=float(np.min(self.weights * self.grain[shooting.recording_of])),
        )
        self.converged = not late and self._at_minimum(projected)
        return True

    def estimate(self, start: Array, worse: float = 2.0) -> Estimate:
        """Make the estimate of the fit; ``start`` is the input error's vector.

        Warnings come first in its notes: no convergence, or a minimum that leaves more than
        ``worse`` times the input error's unexplained torque.
        """
        unit = "rad" if self.chain.load.motion == "rotary" else "m"
        shooting, n = self.shooting, len(self.states)
        data = self.chain, self.observations, self.knowledge
        values = assemble(*data, self.values, self.information, self.at_bound)
        length = float(np.median(np.diff(shooting.borders) * shooting.periods))
        notes = [f"simulated in {n} segments of {length:.3g} s"]
        if n < LEAST_GROUPS * self.columns.size:
            notes.append(
                f"{n} segments are too few for sums over segments: sd_robust treats residuals as "
                "a stationary series and is too small where they drift; give a shorter 'segment'"
            )
        if not self.converged:
            values = tuple(replace(v, sd=np.nan, sd_robust=np.nan, span=None) for v in values)
            reason = (
                f"the search was stopped after {self.options.max_seconds:g} s of CPU time (raise "
                "estimation.max_seconds, or give fewer recordings)"
                if self.late
                else "the search stopped away from a minimum (another segment length, or "
                "longer recordings, may help)"
            )
            notes.insert(0, f"NOT CONVERGED, these numbers are not an estimate: {reason}")
        before, after = (
            rms(self.torque.torque_error(v[self.columns])) for v in (start, self.values)
        )
        if self.converged and after > worse * before:
            notes.insert(
                0,
                f"ANOTHER MINIMUM than the input error's: these numbers leave {after / before:.2g} "
                "times as much of the torque; believe the input error",
            )
        return Estimate(
            method="output-error",
            values=values,
            residual_rms=rms(self.residual),
            n_outputs=self.residual.size,
            assumption="sd: uncorrelated noise of the position; sd_robust: residuals correlated "
            "in any way within segments, as noise of the torque makes them",
            residual_unit=unit,
            notes=tuple(notes),
            point=tuple(zip(self.chain.names, self.values.tolist(), strict=True)),
            converged=self.converged,
        )

    def _with_states(self) -> tuple[Array, Array]:
        """Fit the initial states ``(K, 2)`` alone, from the measured ones; residuals ``(n,)``."""
        shooting, values = self.shooting, self.values
        states, even = shooting.initial, np.ones(shooting.measured.size)
        residual = shooting.measured - shooting.positions(values[None], states)[0]
        held = np.zeros(values.size)
        for _ in range(_STATE_STEPS):
            if not np.isfinite(residual).all():
                break
            _, _, by_state = shooting.sensitivities(values, states, held, self._state_steps)
            _, onto, _ = eliminate_states(shooting, np.nan_to_num(by_state), residual[:, None])
            before = residual
            states, residual = shooting.follow(values, states, onto[:, :, 0], even)
            if residual @ residual >= (1.0 - 1e-6) * (before @ before):
                break
        return states, residual

    def _search(self) -> bool:
        """Minimise the weighted squares of positions and priors within limits, by SciPy.

        States follow a step of the parameters to first order. Whether the time is over.
        """
        shooting, weights, vector = self.shooting, self.weights, self.torque.vector
        rows, targets = self.knowledge.rows(self.chain)
        lower, upper = self.torque.lower, self.torque.upper
        x, states = self.values[self.columns], self.states
        left = shooting.measured - shooting.positions(self.values[None], states)[0]
        sd = rms(weights * left)  # scale of the priors
        # where the states are known to fit, their slopes there, and the last trial
        point, slopes = (x, states), np.zeros((*states.shape, 1 + x.size))
        trial = best = (x, states, left)

        def residual(x: Array) -> Array:
            nonlocal trial
            if self.late:
                raise TimeoutError
            change = slopes[:, :, 0] - slopes[:, :, 1:] @ (x - point[0])
            trial = (x.copy(), *shooting.follow(vector(x), point[1], change, weights))
            return np.concatenate([weights * trial[2], sd * (targets - rows @ x)])

        def jacobian(x: Array) -> Array:
            nonlocal point, slopes, best
            # SciPy differentiates at its best, which is the last that it tried
            if not np.array_equal(x, trial[0]):
                residual(x)
            best, point = trial, trial[:2]
            projected, slopes, _ = self._linearised(vector(x), trial[1])
            return -np.concatenate([projected[:, 1:], sd * rows])

        late = False
        try:
            optimize.least_squares(
                residual, x, jacobian, (lower, upper), x_scale=self.units,
                ftol=1e-9, xtol=1e-9, gtol=1e-15, max_nfev=100,
            )  # fmt: skip
            # what ends next to a limit stands on it
            met = self._bounds_met(best[0])
            on_limits = np.where(met < 0, lower, np.where(met > 0, upper, best[0]))
            ends = [(float(np.sum(residual(x) ** 2)), trial) for x in (best[0], on_limits)]
            best = ends[1][1] if ends[1][0] <= (1.0 + 1e-9) * ends[0][0] else ends[0][1]
        except TimeoutError:
            late = True
        self.values, self.states, self.residual = vector(best[0]), best[1], best[2]
        return late

    def _linearised(self, values: Array, states: Array) -> tuple[Array, Array, int]:
        """Eliminate the states from weighted residual and Jacobian: ``(n, 1 + d)``, as columns.

        Derivatives along the open scalings are zero.
        """
        shooting, units, weights = self.shooting, self.units, self.weights[:, None]
        steps = np.zeros(values.size)
        steps[self.columns] = _STEP * units
        positions, by_parameter, by_state = shooting.sensitivities(
            values, states, steps, self._state_steps
        )
        jacobian = np.nan_to_num(by_parameter) * units
        tangents, _ = np.linalg.qr((self._open_directions(values) / units).T)
        jacobian -= (jacobian @ tangents) @ tangents.T
        columns = np.column_stack([shooting.measured - positions, jacobian / units])
        return eliminate_states(shooting, np.nan_to_num(by_state) * weights, weights * columns)

    def _bounds_met(self, x: Array) -> NDArray[np.int_]:
        return bounds_met(x, self.torque.lower, self.torque.upper, self.units)

    def _open_directions(self, values: Array) -> Array:
        return open_directions(self.chain, self.knowledge, self.observations, values)

    def _at_minimum(self, projected: Array, *, max_count: float = 100.0) -> bool:
        """Whether a full step promises less than ``max_count`` residual variances.

        Kinks of the torque and rounding stop a search although one promises some.
        """
        rows, targets = self.knowledge.rows(self.chain)
        residual, free = self.weights * self.residual, self.at_bound == 0
        variance = float(np.mean(residual**2))
        sd = np.sqrt(variance)
        target = np.concatenate(
            [projected[:, 0], sd * (targets - rows @ self.values[self.columns])]
        )
        matrix = np.concatenate([projected[:, 1:], sd * rows])[:, free] * self.units[free]
        rest = target - matrix @ np.linalg.lstsq(matrix, target, rcond=1e-6)[0]
        by_states = residual @ residual - projected[:, 0] @ projected[:, 0]
        gain = float(by_states + target @ target - rest @ rest)
        # residuals that are rounding cannot be lowered
        return gain <= max_count * max(variance, (1e-6 * self.span) ** 2)

    def _units(self) -> Array:
        sizes = units_of(self.chain, self.chain.names, self.values)
        steps = 1e-6 + 1e-4 * sizes
        jacobian = torque_jacobian(self.chain, self.observations, self.values, steps)
        torque = np.concatenate([o.measured for o in self.observations])
        effect, size = np.sqrt(np.mean(jacobian**2, axis=0)), rms(torque)
        units = np.where(size * effect > 0.0, size / np.where(effect > 0.0, effect, 1.0), sizes)
        return np.asarray(units[self.columns])

    def _weights(self) -> Array:
        """Weight recordings by one over their residual rms, the encoder's rounding at least."""
        residual, recording = self.residual, self.shooting.recording_of
        if self.grain.size == 1:
            return np.ones(residual.size)
        sizes = np.sqrt(np.bincount(recording, residual**2) / np.bincount(recording))
        # a joint at standstill is simulated exactly, but measured to a count only
        sizes = np.maximum(sizes, np.maximum(self.grain, 1e-3 * sizes.max()))
        return np.asarray(np.sqrt(np.mean(residual**2)) / np.maximum(sizes, 1e-300)[recording])


def segment_length(
    trajectories: Sequence[Trajectory],
    n_parameters: int,
    *,
    longest: float = 0.5,
    least_samples: int = 40,
) -> float:
    """Choose how long segments are, s: two for each parameter, as ``sd_robust`` needs.

    Short ones suit a fine encoder, as noise of the torque is integrated, long ones a coarse one;
    measured: beyond 1 s drift dominates. Two states come off each, so none is below 40 samples.
    """
    total = sum(float(np.diff(t.segments, axis=1).sum()) * t.period for t in trajectories)
    shortest = least_samples * max(t.period for t in trajectories)
    return max(min(longest, total / (LEAST_GROUPS * max(n_parameters, 1))), shortest)
