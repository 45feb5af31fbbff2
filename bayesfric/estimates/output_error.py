"""Which parameters simulate the position nearest the measured one: output error, section 4.3."""

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

# Segment lengths to try, s. Noise of the torque is integrated, so short segments tell more
# where the encoder is fine, long ones where it is coarse; measured: beyond 1 s drift rules.
LENGTHS = (0.2, 0.5, 1.0)
# Shortest segment, samples: two states come off each.
_LEAST_SAMPLES = 40
# A longer segment is taken where it lowers the logarithm of robust sds by this much.
_CLEARLY = 0.2
# A search that could still lower the sum of squares by this many residual variances, though
# no step does, is at no minimum.
_LEFT = 100.0
# How many times as much torque another minimum leaves.
_MORE = 2.0
# How often recordings and told values are weighed anew.
_WEIGHINGS = 4
# Differences carry errors of 1e-8 of a derivative; what is smaller than this is null.
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
    # Of the two places to start from the nearer one; the other if that one gets stuck.
    starts = [values, _split(chain, observations, knowledge)]
    starts.sort(key=lambda v: problem.distance(v, lengths[0]))
    for begin in starts:
        found = problem.fit(begin, lengths[0])
        if found is not None and (best is None or found.solution.cost < best.solution.cost):
            best = found
        if best is not None and (best.solution.converged or problem.late):
            break
    if best is None:
        raise BadInput(
            ", ".join(f"recording '{t.name}'" for t in trajectories),
            "the joint cannot be simulated: from no start has the torque one bounded motion",
            "check units and sign of the torque, bound the load losses, or shorten 'segment'",
        )
    fits = [best]
    for length in lengths[1:]:
        if problem.late:
            break
        longer = problem.fit(fits[-1].solution.values, length)
        if longer is not None:
            fits.append(longer)
    # The more segments, the sounder the sds: a longer length must be clearly better. One that
    # runs into other bounds only looks better, for bounds count as certain.
    chosen = fits[0]
    for longer in fits[1:]:
        same = np.array_equal(longer.at_bound, fits[0].at_bound) and longer.solution.converged
        if same and _spread(longer) < _spread(chosen) - _CLEARLY:
            chosen = longer
    return problem.estimate(chosen, values)


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit with segments of one length."""

    frame: Frame  # What was held, and where the descent ended
    solution: Solution
    # Of the free parameters, bounds left out: beside one, others would look far too certain
    information: Information
    at_bound: NDArray[np.int_]  # (d,): -1 on the lower bound, 1 on the upper, else 0


class OutputError:
    """Fits of simulated to measured position with segments of any length.

    @@ATTR chain, trajectories, observations, knowledge, options: As for :func:`output_error`. The
    time limit counts from here. | free, columns, limits: Names of the d free parameters, indices
    among the chain's, lower and upper limits. | scalings: Those that nothing known takes away
    (section 4.2). | deadline: CPU time of the process, s. | grain: Standard deviation of a position
    that rounding alone makes, of each recording, rad or m.
    """

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
        # sd of the rounding to counts: no position is measured better
        self.grain = np.array([resolution(t.position[t.samples]) for t in trajectories]) / 12**0.5

    @property
    def late(self) -> bool:
        """Whether the time for the search is over."""
        return time.process_time() >= self.deadline

    def distance(self, values: Array, length: float) -> float:
        """Sum of squares at a start, states fitted; infinite where it cannot be simulated.

        Shapes: values (n_parameters,).
        """
        *_, residual = self._begin(values, length)
        found = float(np.sum(residual**2))
        return found if np.isfinite(found) else np.inf

    def _begin(self, values: Array, length: float) -> tuple[Frame, Array, Array, Array]:
        """Cut the recordings, bring a start within the limits, and fit its states; residuals."""
        cut = [
            divided(t, o, length) for t, o in zip(self.trajectories, self.observations, strict=True)
        ]
        values = values.copy()
        values[self.columns] = self.knowledge.inside(self.chain, values[self.columns])
        frame = self._frame(Shooting(self.chain, cut, self.options.substeps or 1), values)
        states = settle_states(frame, values, frame.shooting.initial)
        return frame, values, states, residual_of(frame, values, states)

    def fit(self, values: Array, length: float) -> Fit | None:
        """Fit from a start with segments of one length.

        Recordings, and values with a standard deviation, are weighed anew four times by the
        residuals. Along an open scaling the fit is moved to the middle of what a gearbox allows.

        Shapes: values (n_parameters,).
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
        """Segment lengths to try, s: the one given, or those that leave segments enough.

        Enough for ``sd_robust`` are two for each free parameter; none is shorter than 40 samples,
        as two states come off each.
        """
        if self.options.segment is not None:
            return (self.options.segment,)
        total = sum(float(np.diff(t.segments, axis=1).sum()) * t.period for t in self.trajectories)
        period = max(t.period for t in self.trajectories)
        needed = LEAST_GROUPS * max(self.columns.size, 1)
        least = _LEAST_SAMPLES * period
        fitting = [length for length in LENGTHS if length >= least and total >= needed * length]
        return tuple(fitting) or (max(LENGTHS[0], least),)

    def estimate(self, fit: Fit, start: Array) -> Estimate:
        """State everything a fit says. Shapes: start (n_parameters,)."""
        unit = "rad" if self.chain.load.motion == "rotary" else "m"
        solution, shooting = fit.solution, fit.frame.shooting
        given = self.chain, self.observations, self.knowledge
        values = fitted.assemble(*given, solution.values, fit.information, fit.at_bound)
        length = float(np.median(np.diff(shooting.borders) * shooting.periods))
        n = shooting.n_segments
        notes = [f"simulated in {n} segments of {length:.3g} s"]
        if n < LEAST_GROUPS * self.columns.size:
            notes.append(
                f"{n} segments are too few for sums over segments: sd_robust takes residuals for "
                "a stationary series and is too small where they drift; give a shorter 'segment'"
            )
        # of residuals that are rounding anyway nothing is left to gain
        variance = float(np.mean(solution.residual**2))
        rounding = 1e-12 * fit.frame.span**2
        near = solution.gain * variance <= _LEFT * max(variance, rounding)
        converged = solution.converged or (near and not self.late)
        if not converged:
            values = tuple(replace(v, sd=np.nan, sd_robust=np.nan, span=None) for v in values)
            why = (
                f"the search was stopped after {self.options.max_seconds:g} s of CPU time (raise "
                "estimation.max_seconds, or give fewer recordings)"
                if self.late
                else "the search stopped in a place that is no minimum (another segment length, or "
                "longer recordings, may help)"
            )
            notes.insert(0, f"NOT CONVERGED, these numbers are no estimate: {why}")
        before, left = self._torque_left(start), self._torque_left(solution.values)
        if converged and left > _MORE * before:
            notes.insert(
                0,
                f"ANOTHER MINIMUM than the input error's: these numbers leave {left / before:.2g} "
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
        """Root mean square of the torque that parameters leave."""
        pairs = (
            (o.measured, filtered_torque(self.chain, o, values[None])) for o in self.observations
        )
        return float(np.sqrt(np.mean(np.concatenate([y - x[0] for y, x in pairs]) ** 2)))

    def _frame(self, shooting: Shooting, values: Array) -> Frame:
        """Lay out what stays the same in a descent; all residuals weigh alike."""
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
        """Change of every parameter that changes the torque by all of itself."""
        values_size = fitted.units_of(self.chain, self.chain.names, values)
        steps = 1e-6 + 1e-4 * values_size
        jacobian = torque_jacobian(self.chain, self.observations, values, steps)
        torque = np.concatenate([o.measured for o in self.observations])
        size = np.sqrt(np.mean(jacobian**2, axis=0))
        whole = float(np.sqrt(np.mean(torque**2)))
        return np.where(size > 0.0, whole / np.where(size > 0.0, size, 1.0), values_size)

    def _weighted(self, frame: Frame, residual: Array) -> Frame:
        """Weigh recordings by one over their residual rms, the encoder's rounding at least."""
        of = frame.shooting.recording_of
        rows = np.ones(residual.size)
        if len(self.trajectories) > 1:
            sizes = np.sqrt(np.bincount(of, residual**2) / np.bincount(of))
            # a joint that stands still is simulated exactly, and measured to a count no better
            sizes = np.maximum(sizes, np.maximum(self.grain, 1e-3 * sizes.max()))
            rows = float(np.sqrt(np.mean(residual**2))) / np.maximum(sizes, 1e-300)[of]
        return replace(frame, rows=rows, sigma=float(np.sqrt(np.mean((residual * rows) ** 2))))

    def _information(self, frame: Frame, solution: Solution) -> Information:
        """Say what determines the free parameters, states taken out, segments as groups."""
        linear = Linearised(frame, solution.values, solution.states)
        projected = linear.elimination.projected
        return Information(
            projected[:, 1:],
            projected[:, 0],
            frame.units,
            places=frame.shooting.places,
            known=frame.told,
            known_null=fitted.open_directions(
                self.chain, self.knowledge, self.observations, solution.values
            ),
            tolerance=_NULL,
            groups=frame.shooting.segment_of,
            lost=linear.elimination.lost,
            least=float(np.min(frame.rows * self.grain[frame.shooting.recording_of])),
        )


def _spread(fit: Fit) -> float:
    """Mean logarithm of the robust standard deviations of what every length determines."""
    d = fit.information.directions
    told = d.rows[~d.null]
    found = [fit.information.sds(row / d.units)[1] for row in told]
    return float(np.mean(np.log(np.maximum(found, 1e-300)))) if found else np.inf


def _split(chain: Joint, observations: Sequence[Observation], knowledge: Knowledge) -> Array:
    """Least-squares totals split into parameters, as a second place to start from."""
    values = starting_values(chain, least_squares(chain, observations), 0.2, 0.5)
    return chain.vector({**values, **knowledge.fixed})


def _check(chain: Joint, trajectories: Sequence[Trajectory], knowledge: Knowledge) -> None:
    """Refuse a mechanism without inertia, and fewer samples than unknowns."""
    inertia = [p.name for p in chain.parameters if p.quantity == "inertia"]
    known = [n for n in inertia if knowledge.fixed.get(n, 1.0) > 0.0]
    if not known and not all(t.inputs.added_mass for t in trajectories):
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
