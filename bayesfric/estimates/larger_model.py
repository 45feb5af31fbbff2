"""Whether a larger model predicts better: cross-validation, and what is new in it is identified."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesfric.estimates.delay import furthest_delay
from bayesfric.estimates.descent import Terms, TorqueProblem, few_threads, minimise
from bayesfric.estimates.methods import EstimationInputs
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.mechanism.quantities import QUANTITIES

# Quantities that shape other terms.
_SHAPES = {name for name, row in QUANTITIES.items() if row.role == "form"}
# Parts that recordings are cut into, each left out once; steps of a refit from the whole estimate.
_PARTS, _STEPS = 4, 10
# Relative difference of rms that the end of a search may make.
_SAME = 1e-6


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A model and its estimate."""

    inputs: EstimationInputs
    estimate: Estimate  # the input error's

    @property
    def dated(self) -> bool:
        """Whether a delay, if there is one, is determined to less than the range of the search."""
        return all(
            v.known and max(abs(v.value), v.larger_sd) <= furthest_delay(self.inputs.observations)
            for v in self.estimate.parameters
            if v.quantity == "delay"
        )

    @cached_property
    def left_out_rms(self) -> float:
        """Root mean square of residuals in parts that the model was not fitted to, N m or N.

        Four-fold cross-validation (Stone, Journal of the Royal Statistical Society B 36, 1974) with
        quarters of the recordings in a row: a term that fits a single place or minute does not help
        in others.
        """
        inputs = self.inputs
        problem = TorqueProblem(inputs.chain, inputs.observations, inputs.knowledge)
        start = problem.inside(problem.chain.vector(dict(self.estimate.point)))
        squares, n = 0.0, problem.measured.size
        with few_threads(inputs.observations):
            for part in np.array_split(np.arange(n), _PARTS):
                weights = np.ones(n)
                weights[part] = 0.0
                fit = minimise(problem, Terms(weights), start, iterations=_STEPS)
                squares += float(np.sum(problem.residual(fit.x)[part] ** 2))
        return math.sqrt(squares / n)


def predicts_better(larger: FittedModel, smaller: FittedModel) -> bool:
    """Whether a larger model has the smaller left-out error and its new terms are identified.

    The 90 % interval of every new parameter that shapes a term, and of at least one other, must
    exclude zero; a delay that was determined stays so.
    """
    names = {v.name for v in smaller.estimate.parameters}
    new = [v for v in larger.estimate.parameters if v.name not in names]
    shapes = [v.known for v in new if v.quantity in _SHAPES]
    sizes = [v.known for v in new if v.quantity not in _SHAPES]
    if not all(shapes) or (sizes and not any(sizes)):
        return False
    if smaller.dated and not larger.dated:
        return False
    return larger.left_out_rms < (1.0 - _SAME) * smaller.left_out_rms
