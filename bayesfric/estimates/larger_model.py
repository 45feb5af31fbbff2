"""Whether a larger model is the better one: by the torque of parts that it was not fitted to."""

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

# Quantities that shape others.
_SHAPES = {name for name, row in QUANTITIES.items() if row.role == "form"}
# Parts that recordings are cut into, one after the other, of which each is left out once; and steps
# downhill in which a model settles on the others, which is where it stood already or near.
_PARTS, _STEPS = 4, 10
# Searches end this close to each other, so two models that are the same one look no better.
_SAME = 1e-6


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model, and its estimate of the input error."""

    given: EstimationInputs  # Mechanism, observations, knowledge and options
    estimate: Estimate  # By :func:`bayesfric.estimates.input_error.input_error` from these

    @property
    def dated(self) -> bool:
        """Whether a delay, if there is one, is determined, and to less than the range of search."""
        return all(
            v.known and max(abs(v.value), v.larger_sd) <= furthest_delay(self.given.observations)
            for v in self.estimate.parameters
            if v.quantity == "delay"
        )

    @cached_property
    def left_out_rms(self) -> float:
        """Root mean square of residuals in parts that the model was not fitted to, N m or N.

        Four-fold cross-validation (Stone, Journal of the Royal Statistical Society B 36, 1974). The
        parts are quarters of the recordings in a row, so what one of them says alone, as a term
        that fits a single place or minute, does not help with the others. Each fit takes at most
        ten steps from the whole estimate.
        """
        given = self.given
        problem = TorqueProblem(given.chain, given.observations, given.knowledge)
        start = problem.inside(problem.chain.vector(dict(self.estimate.point)))
        squares, n = 0.0, problem.measured.size
        with few_threads(given.observations):
            for part in np.array_split(np.arange(n), _PARTS):
                weights = np.ones(n)
                weights[part] = 0.0
                found = minimise(problem, Terms(weights), start, iterations=_STEPS)
                squares += float(np.sum(problem.residual(found.x)[part] ** 2))
        return math.sqrt(squares / n)


def better(larger: Candidate, smaller: Candidate) -> bool:
    """Whether a larger model predicts better, and what is new in it is identified."""
    before = {v.name for v in smaller.estimate.parameters}
    new = [v for v in larger.estimate.parameters if v.name not in before]
    shapes = [v.known for v in new if v.quantity in _SHAPES]
    sizes = [v.known for v in new if v.quantity not in _SHAPES]
    if not all(shapes) or (sizes and not any(sizes)):
        return False
    if smaller.dated and not larger.dated:
        return False
    return larger.left_out_rms < (1.0 - _SAME) * smaller.left_out_rms
