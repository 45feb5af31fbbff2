"""The paper's three methods of estimation, their order, and the start that each needs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from bayesfric.base.errors import BadInput, nearest
from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.knowledge import Estimation, Knowledge
from bayesfric.estimates.least_squares import least_squares
from bayesfric.estimates.output_error import output_error
from bayesfric.estimates.point_estimate import Estimate, Method
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.observation import Observation
from bayesfric.recordings.trajectory import Trajectory


@dataclass(frozen=True)
class EstimationInputs:
    """What estimates are made from."""

    chain: Joint
    observations: Sequence[Observation]
    knowledge: Knowledge
    options: Estimation
    # makes the recordings for simulation, not divided; called only where a method simulates
    trajectories: Callable[[], Sequence[Trajectory]]


@dataclass(frozen=True)
class Estimator:
    """A method of point estimation."""

    name: Method
    title: str  # heading of its results
    # makes the estimate, given earlier ones by name
    estimate: Callable[[EstimationInputs, Mapping[Method, Estimate]], Estimate]
    starts_from: Method | None = None  # method whose estimate it needs
    simulates: bool = False  # slow, and not for every mechanism


def _output_error(inputs: EstimationInputs, earlier: Mapping[Method, Estimate]) -> Estimate:
    arguments = inputs.observations, inputs.knowledge, inputs.options
    return output_error(inputs.chain, inputs.trajectories(), *arguments, earlier["input-error"])


# In the order of METHODS.
ESTIMATORS = {
    estimator.name: estimator
    for estimator in (
        Estimator(
            "least-squares",
            "Least squares, section 4.1, eq. (11): totals at the motor",
            lambda inputs, _: least_squares(inputs.chain, inputs.observations),
        ),
        Estimator(
            "input-error",
            "Direct minimisation of the input error, section 4.2",
            lambda x, _: input_error(x.chain, x.observations, x.knowledge, x.options),
        ),
        Estimator(
            "output-error",
            "Output error of a simulation (recursive identification), section 4.3",
            _output_error,
            starts_from="input-error",
            simulates=True,
        ),
    )
}


def estimate_by(
    methods: Sequence[Method],
    inputs: EstimationInputs,
    earlier: Mapping[Method, Estimate] | None = None,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[Method, Estimate]:
    """Estimate by some methods, and by those they start from unless ``earlier`` has them."""
    for name in methods:
        if name not in ESTIMATORS:
            raise BadInput(f"method {name!r}", "there is none", nearest(name, ESTIMATORS))
    estimates = dict(earlier or {})
    wanted = {name for name in methods if name not in estimates}
    starts = (ESTIMATORS[name].starts_from for name in wanted)
    wanted |= {estimator for estimator in starts if estimator is not None} - estimates.keys()
    for name, estimator in ESTIMATORS.items():
        if name in wanted:
            progress(name)
            estimates[name] = estimator.estimate(inputs, estimates)
    return {name: estimates[name] for name in ESTIMATORS if name in methods}
