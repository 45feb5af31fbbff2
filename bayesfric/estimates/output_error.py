"""Every parameter from the error of a simulated position: the output error, section 4.3."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput
from bayesfric.estimates import assemble as fitted
from bayesfric.estimates.information import LEAST_GROUPS, Information
from bayesfric.estimates.knowledge import Estimation, Knowledge
from bayesfric.estimates.least_squares import least_squares, starting_values
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.estimates.shooting import Shooting, choose_substeps, resolution
from bayesfric.estimates.shooting_fit import (
    Frame,
    Linearised,
    Solution,
    descend_afresh,
    residual_of,
    settle_states,
)  # fmt: skip
from bayesfric.estimates.torque import filtered_torque, torque_jacobian
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation
from bayesfric.recordings.trajectory import Trajectory, divided

# Segment lengths to try, s: short ones suit a fine encoder, as noise of the torque is integrated,
# long ones a coarse one; measured: beyond 1 s drift dominates.
LENGTHS = (0.2, 0.5, 1.0)
# Shortest segment, samples: two states come off each.
_LEAST_SAMPLES = 40
# A longer segment is taken where it lowers the logarithm of robust sds by this much.
_LEAST_GAIN = 0.2
# Residual variances that a full step may promise at a minimum, though no step keeps it.
_LARGEST_GAIN = 100.0
# Ratio of unexplained torque that shows another minimum.
_WORSE = 2.0
# Rounds of reweighting recordings and priors.
_WEIGHINGS = 4
# Finite differences carry errors of 1e-8; smaller relative singular values than this are null.
_NULL = 1e-6


def output_error(
    chain: Joint,
    trajectories: Sequence[Trajectory],
    observations: Sequence[Observation],
    knowledge: Knowledge,
    options: Estimation,
    start: Estimate,
) -> Estimate:
    """Estimate by simulation, section 4.3: the least ``||q - qc||``.

    The measured torque drives the simulated joint; parameters and the state at the start of
    every segment are fitted to the measured position, unfiltered.

    Parameters
    ----------
    chain
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
        If the joint has no inertia or cannot be simulated, or there are not more samples than
        unknowns.

    Notes
    -----
    ``sd`` is for white noise of the position. Noise of the torque drives the simulated joint, so
    residuals within a segment drift together; ``sd_robust`` rests on segments being independent of
    each other. Segments of 0.2, 0.5 and 1 s are tried, as far as there are two for each parameter;
    a longer one is taken where it clearly lowers the robust standard deviations. The search begins
    at the input error or the split totals of least squares, whichever simulates better, and at the
    other if that gets stuck.
    """
    _check(chain, trajectories, knowledge)
    problem = OutputError(chain, trajectories, observations, knowledge, options)
    values = chain.vector({**dict(start.point), **knowledge.fixed})
    lengths = problem.lengths()
    best: Fit | None = None
    # the start that simulates better; the other if the search from it gets stuck
    starts = [values, _split_totals(chain, observations, knowledge)]
    starts.sort(key=lambda v: problem.distance(v, lengths[0]))
    for vector in starts:
        fit = problem.fit(vector, lengths[0])
        if fit is not None and (best is None or fit.solution.cost < best.solution.cost):
            best = fit
        if best is not None and (best.solution.converged or problem.late):
            break
    if best is None:
        raise BadInput(
            ", ".join(f"recording '{t.name}'" for t in trajectories),
            "the joint cannot be simulated: from no start does the torque give a bounded motion",
            "check units and sign of the torque, bound the load_loss, or shorten 'segment'",
        )
    fits = [best]
    for length in lengths[1:]:
        if problem.late:
            break
        longer = problem.fit(fits[-1].solution.values, length)
        if longer is not None:
            fits.append(longer)
    # more segments make better sds, so a longer length must clearly gain; on other bounds it only
    # seems to, as bounds count as certain
    chosen = fits[0]
    for longer in fits[1:]:
        same = np.array_equal(longer.at_bound, fits[0].at_bound) and longer.solution.converged
        if same and _spread(longer) < _spread(chosen) - _LEAST_GAIN:
            chosen = longer
    return problem.estimate(chosen, values)


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit with segments of one length."""

    frame: Frame
    solution: Solution
    # of the free parameters, those on a bound included: held, others would look far too certain
    information: Information
    at_bound: NDArray[np.int_]  # (d,): -1 on the lower bound, 1 on the upper, else 0


class OutputError:
    """Fits of simulated to measured position with segments of any length."""

    def __init__(
        self,
        chain: Joint,
        trajectories: Sequence[Trajectory],
        observations: Sequence[Observation],
        knowledge: Knowledge,
        options: Estimation,
    ) -> None:
        self.chain, self.knowledge, self.options = chain, knowledge, options
        self.trajectories, self.observations = tuple(trajectories), tuple(observations)
        self.free = knowledge.free(chain)
        self.columns = np.array([chain.names.index(n) for n in self.free], dtype=np.int64)
        self.limits = knowledge.limits(chain)
        self.scalings = fitted.open_scalings(chain, knowledge, observations)
        self.deadline = time.process_time() + options.max_seconds
        # sd of the rounding to counts, of each recording, rad or m
        self.grain = np.array([resolution(t.position[t.samples]) for t in trajectories]) / 12**0.5

    @property
    def late(self) -> bool:
        """Whether the time for the search is over."""
        return time.process_time() >= self.deadline

    def distance(self, values: Array, length: float) -> float:
        """Sum of squares at a start ``(n_parameters,)``, states fitted; infinite if unstable."""
        *_, residual = self._begin(values, length)
        squares = float(np.sum(residual**2))
        return squares if np.isfinite(squares) else np.inf

    def _begin(self, values: Array, length: float) -> tuple[Frame, Array, Array, Array]:
        """Divide the recordings, put a start within the limits, and fit its states."""
        cut = [
            divided(t, o, length) for t, o in zip(self.trajectories, self.observations, strict=True)
        ]
        values = values.copy()
        values[self.columns] = self.knowledge.inside(self.chain, values[self.columns])
        frame = self._frame(Shooting(self.chain, cut, self.options.substeps or 1), values)
        states = settle_states(frame, values, frame.shooting.initial)
        return frame, values, states, residual_of(frame, values, states)

    def fit(self, values: Array, length: float) -> Fit | None:
        """Fit from a start ``(n_parameters,)`` with segments of one length; ``None`` if unstable.

        Recordings and priors are reweighted four times by the residuals. Along an open scaling the
        fit is moved to the middle of what a gearbox allows.
        """
        frame, values, states, residual = self._begin(values, length)
        shooting = frame.shooting
        if not np.isfinite(residual).all():
            return None
        if self.options.substeps is None:
            substeps, _ = choose_substeps(shooting, values, states)
            if substeps != shooting.substeps:
                frame = self._frame(Shooting(self.chain, shooting.trajectories, substeps), values)
        several = len(self.trajectories) > 1
        for _ in range(_WEIGHINGS if several or self.knowledge.priors else 1):
            frame = self._weighted(frame, residual)
            solution = descend_afresh(frame, values, states)
            if not np.isfinite(solution.cost):
                return None
            values, states, residual = solution.values, solution.states, solution.residual
        middle = fitted.centred(self.chain, self.knowledge, self.observations, values).copy()
        middle[self.columns] = self.knowledge.on_turn(self.chain, middle[self.columns])
        if not np.array_equal(middle, values):
            moved = residual_of(frame, middle, states)
            solution = replace(solution, values=middle, residual=moved)
        at_bound = fitted.bounds_met(solution.values[self.columns], *self.limits, frame.units)
        information = self._information(frame, solution)
        return Fit(frame, solution, information, at_bound)

    def lengths(self) -> tuple[float, ...]:
        """Segment lengths to try, s: the configured one, or those with two segments a parameter.

        ``sd_robust`` needs these; two states come off each segment, so none is below 40 samples.
        """
        if self.options.segment is not None:
            return (self.options.segment,)
        total = sum(float(np.diff(t.segments, axis=1).sum()) * t.period for t in self.trajectories)
        period = max(t.period for t in self.trajectories)
        needed = LEAST_GROUPS * max(self.columns.size, 1)
        shortest = _LEAST_SAMPLES * period
        fitting = [length for length in LENGTHS if length >= shortest and total >= needed * length]
        return tuple(fitting) or (max(LENGTHS[0], shortest),)

    def estimate(self, fit: Fit, start: Array) -> Estimate:
        """Make the estimate of a fit; ``start`` is the input error's vector.

        Warnings come first in its notes: no convergence, or a minimum that leaves more than twice
        the input error's unexplained torque.
        """
        unit = "rad" if self.chain.load.motion == "rotary" else "m"
        solution, shooting = fit.solution, fit.frame.shooting
        data = self.chain, self.observations, self.knowledge
        values = fitted.assemble(*data, solution.values, fit.information, fit.at_bound)
        length = float(np.median(np.diff(shooting.borders) * shooting.periods))
        n = shooting.n_segments
        notes = [f"simulated in {n} segments of {length:.3g} s"]
        if n < LEAST_GROUPS * self.columns.size:
            notes.append(
                f"{n} segments are too few for sums over segments: sd_robust treats residuals as "
                "a stationary series and is too small where they drift; give a shorter 'segment'"
            )
        # residuals that are rounding cannot be lowered
        variance = float(np.mean(solution.residual**2))
        rounding = 1e-12 * fit.frame.span**2
        near_minimum = solution.gain * variance <= _LARGEST_GAIN * max(variance, rounding)
        converged = solution.converged or (near_minimum and not self.late)
        if not converged:
            values = tuple(replace(v, sd=np.nan, sd_robust=np.nan, span=None) for v in values)
            reason = (
                f"the search was stopped after {self.options.max_seconds:g} s of CPU time (raise "
                "estimation.max_seconds, or give fewer recordings)"
                if self.late
                else "the search stopped away from a minimum (another segment length, or "
                "longer recordings, may help)"
            )
            notes.insert(0, f"NOT CONVERGED, these numbers are not an estimate: {reason}")
        before, after = self._torque_left(start), self._torque_left(solution.values)
        if converged and after > _WORSE * before:
            notes.insert(
                0,
                f"ANOTHER MINIMUM than the input error's: these numbers leave {after / before:.2g} "
                "times as much of the torque; believe the input error",
            )
        return Estimate(
            method="output-error",
            values=values,
            residual_rms=float(np.sqrt(np.mean(solution.residual**2))),
            n_outputs=solution.residual.size,
            assumption="sd: uncorrelated noise of the position; sd_robust: residuals correlated "
            "in any way within segments, as noise of the torque makes them",
            residual_unit=unit,
            notes=tuple(notes),
            point=tuple(zip(self.chain.names, solution.values.tolist(), strict=True)),
            converged=converged,
        )

    def _torque_left(self, values: Array) -> float:
        """Root mean square of the unexplained torque."""
        pairs = (
            (o.measured, filtered_torque(self.chain, o, values[None])) for o in self.observations
        )
        return float(np.sqrt(np.mean(np.concatenate([y - x[0] for y, x in pairs]) ** 2)))

    def _frame(self, shooting: Shooting, values: Array) -> Frame:
        """Collect what a descent keeps fixed, with equal weights."""
        rows, targets = self.knowledge.rows(self.chain)
        speeds = np.concatenate([o.qd for o in self.observations])
        return Frame(
            shooting,
            self.columns,
            self._units(values)[self.columns],
            self.limits,
            self.scalings,
            rows,
            targets,
            speed=max(float(np.sqrt(np.mean(speeds**2))), 1e-12),
            span=max(float(np.ptp(t.position)) for t in self.trajectories) or 1e-12,
            rows=np.ones(shooting.measured.size),
            sigma=1.0,
            deadline=self.deadline,
        )

    def _units(self, values: Array) -> Array:
        """Give the change of each parameter that changes the torque by its rms."""
        sizes = fitted.units_of(self.chain, self.chain.names, values)
        steps = 1e-6 + 1e-4 * sizes
        jacobian = torque_jacobian(self.chain, self.observations, values, steps)
        torque = np.concatenate([o.measured for o in self.observations])
        effect = np.sqrt(np.mean(jacobian**2, axis=0))
        torque_rms = float(np.sqrt(np.mean(torque**2)))
        return np.where(effect > 0.0, torque_rms / np.where(effect > 0.0, effect, 1.0), sizes)

    def _weighted(self, frame: Frame, residual: Array) -> Frame:
        """Weight recordings by one over their residual rms, the encoder's rounding at least."""
        recording_of = frame.shooting.recording_of
        rows = np.ones(residual.size)
        if len(self.trajectories) > 1:
            sizes = np.sqrt(np.bincount(recording_of, residual**2) / np.bincount(recording_of))
            # a joint at standstill is simulated exactly, but measured to a count only
            sizes = np.maximum(sizes, np.maximum(self.grain, 1e-3 * sizes.max()))
            rows = float(np.sqrt(np.mean(residual**2))) / np.maximum(sizes, 1e-300)[recording_of]
        return replace(frame, rows=rows, sigma=float(np.sqrt(np.mean((residual * rows) ** 2))))

    def _information(self, frame: Frame, solution: Solution) -> Information:
        """Give the information on the free parameters, states eliminated, segments as groups."""
        linear = Linearised(frame, solution.values, solution.states)
        projected = linear.elimination.projected
        return Information(
            projected[:, 1:],
            projected[:, 0],
            frame.units,
            places=frame.shooting.places,
            known=frame.prior_rows,
            known_null=fitted.open_directions(
                self.chain, self.knowledge, self.observations, solution.values
            ),
            tolerance=_NULL,
            groups=frame.shooting.segment_of,
            lost=linear.elimination.lost,
            least=float(np.min(frame.rows * self.grain[frame.shooting.recording_of])),
        )


def _spread(fit: Fit) -> float:
    """Mean logarithm of the robust standard deviations of identified directions."""
    d = fit.information.directions
    identified = d.rows[~d.null]
    sds = [fit.information.sds(row / d.units)[1] for row in identified]
    return float(np.mean(np.log(np.maximum(sds, 1e-300)))) if sds else np.inf


def _split_totals(chain: Joint, observations: Sequence[Observation], knowledge: Knowledge) -> Array:
    """Split the least-squares totals into parameters, as a second start."""
    values = starting_values(chain, least_squares(chain, observations), 0.2, 0.5)
    return chain.vector({**values, **knowledge.fixed})


def _check(chain: Joint, trajectories: Sequence[Trajectory], knowledge: Knowledge) -> None:
    """Refuse a mechanism without inertia, and fewer samples than unknowns."""
    inertia = [p.name for p in chain.parameters if p.quantity == "inertia"]
    inertias = [n for n in inertia if knowledge.fixed.get(n, 1.0) > 0.0]
    if not inertias and not all(t.inputs.added_mass for t in trajectories):
        raise BadInput(
            "mechanism",
            "has no inertia, so a torque does not determine a motion to compare with",
            "give an element or the load inertia, or use the input error",
        )
    unknowns = len(knowledge.free(chain)) + 2 * len(trajectories)
    samples = sum(t.samples.size for t in trajectories)
    if samples <= unknowns:
        raise BadInput(
            ", ".join(f"recording '{t.name}'" for t in trajectories),
            f"{samples} samples cannot determine {unknowns} unknowns",
            "use a longer recording",
        )
