"""Estimates by any of the paper's three methods, and whether a larger model is the better one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesfric.base.errors import BadInput, nearest
from bayesfric.estimates import METHODS, Method
from bayesfric.estimates.input_error import TorqueProblem, few_threads, input_error
from bayesfric.estimates.least_squares import least_squares
from bayesfric.estimates.point_estimate import Estimate, Estimation, Knowledge
from bayesfric.estimates.trajectory import Trajectory
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import QUANTITIES
from bayesfric.recordings.signals import Signals

# Headings of results.
TITLES: Mapping[Method, str] = {
    "least-squares": "Least squares, section 4.1, eq. (11): totals at the motor",
    "input-error": "Direct minimisation of the input error, section 4.2",
    "output-error": "Output error of a simulation (recursive identification), section 4.3",
}


@dataclass(frozen=True)
class EstimationInputs:
    """What estimates are made from."""

    chain: Joint
    observations: Sequence[Signals]
    knowledge: Knowledge
    options: Estimation
    # makes the recordings for simulation, not divided; called only where a method simulates
    trajectories: Callable[[], Sequence[Trajectory]]


def estimate_by(
    methods: Sequence[Method],
    inputs: EstimationInputs,
    earlier: Mapping[Method, Estimate] | None = None,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[Method, Estimate]:
    """Estimate by some methods, and by those they start from unless ``earlier`` has them."""
    for name in methods:
        if name not in METHODS:
            raise BadInput(f"method {name!r}", "there is none", nearest(name, METHODS))
    estimates = dict(earlier or {})
    wanted = {name for name in methods if name not in estimates}
    if "output-error" in wanted and "input-error" not in estimates:
        wanted.add("input-error")
    arguments = inputs.observations, inputs.knowledge, inputs.options
    for name in METHODS:
        if name not in wanted:
            continue
        progress(name)
        if name == "least-squares":
            estimates[name] = least_squares(inputs.chain, inputs.observations)
        elif name == "input-error":
            estimates[name] = input_error(inputs.chain, *arguments)
        else:
            from bayesfric.estimates.output_error import output_error

            start = estimates["input-error"]
            estimates[name] = output_error(inputs.chain, inputs.trajectories(), *arguments, start)
    return {name: estimates[name] for name in METHODS if name in methods}


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A model and its estimate."""

    inputs: EstimationInputs
    estimate: Estimate  # the input error's

    @cached_property
    def left_out_rms(self) -> float:
        """Root mean square of residuals in parts that the model was not fitted to, N m or N.

        Four-fold cross-validation (Stone, Journal of the Royal Statistical Society B 36, 1974) with
        quarters of the recordings in a row: a term that fits a single place or minute does not help
        in others.
        """
        joint, observations = self.inputs.chain, self.inputs.observations
        problem = TorqueProblem(joint, observations, self.inputs.knowledge)
        start = problem.inside(joint.vector(dict(self.estimate.point)))
        squares, n = 0.0, problem.measured.size
        with few_threads(observations):
            for part in np.array_split(np.arange(n), 4):
                weights = np.ones(n)
                weights[part] = 0.0
                _, x = problem.weighted(weights).minimise(start, steps=10)
                squares += float(np.sum(problem.torque_error(x)[part] ** 2))
        return math.sqrt(squares / n)

    def predicts_better(self, smaller: FittedModel, *, same: float = 1e-6) -> bool:
        """Whether this larger model has the smaller left-out error, and identified new terms.

        The 90 % interval of every new parameter that shapes a term, and of at least one other, must
        exclude zero. A search may end the share ``same`` of an rms above its minimum.
        """
        forms = {name for name, row in QUANTITIES.items() if row.role == "form"}
        names = {v.name for v in smaller.estimate.parameters}
        new = [v for v in self.estimate.parameters if v.name not in names]
        shapes = [v.known for v in new if v.quantity in forms]
        sizes = [v.known for v in new if v.quantity not in forms]
        if not all(shapes) or (sizes and not any(sizes)):
            return False
        return self.left_out_rms < (1.0 - same) * smaller.left_out_rms
