"""Which of the paper's three methods estimate a joint, in which order, and from which start."""

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
    """What may be estimated from."""

    chain: Joint  # The mechanism
    observations: Sequence[Observation]  # Its recordings, prepared
    knowledge: Knowledge  # Known values and bounds; how estimates are made
    options: Estimation
    # Makes the recordings for simulation, not divided; called only where a method simulates
    trajectories: Callable[[], Sequence[Trajectory]]


@dataclass(frozen=True)
class Estimator:
    """A method of point estimation."""

    name: Method  # As it is asked for, and as a heading
    title: str
    # Makes the estimate, from the ones that were made before, by name
    estimate: Callable[[EstimationInputs, Mapping[Method, Estimate]], Estimate]
    starts_from: Method | None = None  # Method whose estimate it needs, if any
    simulates: bool = False  # Whether it is dear, and some mechanisms have none


def _output_error(given: EstimationInputs, found: Mapping[Method, Estimate]) -> Estimate:
    known = given.observations, given.knowledge, given.options
    return output_error(given.chain, given.trajectories(), *known, found["input-error"])


# In the order of METHODS.
ESTIMATORS = {
    one.name: one
    for one in (
        Estimator(
            "least-squares",
            "Least squares, section 4.1, eq. (11): what the motor feels",
            lambda given, _: least_squares(given.chain, given.observations),
        ),
        Estimator(
            "input-error",
            "Direct minimisation of the input error, section 4.2",
            lambda at, _: input_error(at.chain, at.observations, at.knowledge, at.options),
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
    given: EstimationInputs,
    found: Mapping[Method, Estimate] | None = None,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[Method, Estimate]:
    """Estimate by some methods, and by those they start from unless ``found`` has them."""
    for name in methods:
        if name not in ESTIMATORS:
            raise BadInput(f"method {name!r}", "there is none", nearest(name, ESTIMATORS))
    made = dict(found or {})
    wanted = {name for name in methods if name not in made}
    starts = (ESTIMATORS[name].starts_from for name in wanted)
    wanted |= {one for one in starts if one is not None} - made.keys()
    for name, one in ESTIMATORS.items():
        if name in wanted:
            progress(name)
            made[name] = one.estimate(given, made)
    return {name: made[name] for name in ESTIMATORS if name in methods}
