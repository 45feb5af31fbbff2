"""What sampling starts from: point estimates, the noise they ask for, and the log-posterior."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from bayesfric.errors import BadInput
from bayesfric.estimates.methods import ESTIMATORS, estimate_by
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.inference.likelihood.noise_choice import Choice
from bayesfric.inference.target import Target
from bayesfric.problem.problem import Problem
from bayesfric.progress import Shown, by_method, silent


@dataclass(frozen=True)
class StartingPoint:
    """What sampling starts from."""

    estimates: list[Estimate]  # least squares first
    missing: list[str]  # a sentence for each that was wanted and cannot be had
    choice: Choice | None  # how the order of the noise was chosen, where it was
    target: Target  # the log-posterior

    @property
    def searched(self) -> Estimate:
        """The first estimate that tells every parameter; there always is one."""
        return next(one for one in self.estimates if one.point)


def starting_point(
    problem: Problem, *, output_error: bool = False, progress: Shown = silent
) -> StartingPoint:
    """Estimate, choose the noise, and make the log-posterior that is sampled.

    The output error simulates. It is asked for, or its likelihood needs a place to start
    from: then however long it takes, as sampling that goes on later must start from the
    same place. A mechanism that cannot be simulated still has a posterior of the torque.
    """
    tables, given = problem.config.tables, problem.evidence
    simulating = [one.name for one in ESTIMATORS.values() if one.simulates]
    plain = [name for name in ESTIMATORS if name not in simulating]
    made = {e.method: e for e in problem.estimates(plain, progress=progress)}
    if tables.likelihood.method in simulating:
        given = replace(given, options=given.options.model_copy(update={"max_seconds": np.inf}))
    elif not (output_error or tables.estimation.output_error):
        simulating = []
    missing = []
    for name in simulating:
        try:
            with problem.config.named():
                made |= estimate_by([name], given, made, progress=by_method(progress))
        except BadInput as error:
            missing.append(f"no {name} estimate: {error.what}")
    found = list(made.values())
    points = [dict(e.point) for e in found if e.point]
    choice = problem.noise_choice(points[0])
    return StartingPoint(found, missing, choice, _first_target(problem, points, choice))


def _first_target(
    problem: Problem, points: Sequence[Mapping[str, float]], choice: Choice | None
) -> Target:
    """Make the log-posterior; where it simulates, near the first point that can be simulated.

    The simulation is linearised there first, and anew at every mode this leads to.
    """
    for point in points[:-1]:
        with suppress(BadInput):
            return problem.target(point, choice)
    return problem.target(points[-1], choice)
