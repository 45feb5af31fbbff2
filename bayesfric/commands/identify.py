"""``bayesfric identify``: what the recordings can and cannot tell, before sampling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.commands.problem import Problem
from bayesfric.estimates.descent import few_threads
from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.output_error import output_error
from bayesfric.identifiability.identification import Identification, identify
from bayesfric.identifiability.known_quantities import speed_term
from bayesfric.identifiability.local import LocalInformation, local_information
from bayesfric.identifiability.plausible import Point, estimate_point, points_around
from bayesfric.identifiability.sentences import page, plain
from bayesfric.inference.beforehand import beforehand
from bayesfric.inference.target import Target
from bayesfric.recordings.trajectory import trajectory

Array = NDArray[np.float64]


def identification(
    problem: Problem, *, progress: Callable[[str], None] = lambda _: None
) -> Identification:
    """Look at a problem's likelihood at its estimate and at other points.

    Parameters
    ----------
    problem
        From :func:`bayesfric.commands.problem.read_problem`.
    progress
        Called with the name of each stage before it begins.

    Raises
    ------
    BadInput
        If nothing can be estimated from these recordings.
    """
    target, point, local = local_picture(problem, progress)
    # the seed of the whole analysis, in a stream of its own
    seed = np.random.SeedSequence(problem.config.tables.sampling.seed, spawn_key=(4,))
    with problem.config.named(), few_threads(problem.observations):
        others = points_around(target, point, local, np.random.default_rng(seed))
        from_voltage = [r.name for r in problem.recordings if r.torque_origin == "voltage"]
        speed = speed_term(target, point.parameters, from_voltage)
        return identify(target, [point, *others], speed=speed)


def local_picture(
    problem: Problem, progress: Callable[[str], None]
) -> tuple[Target, Point, LocalInformation]:
    """Estimate, and look at the likelihood there; see :func:`identification`."""
    with problem.config.named():
        estimate = _estimate(problem, progress)
    progress("identifiability")
    target = problem.target(estimate)
    with problem.config.named(), few_threads(problem.observations):
        point = estimate_point(target, estimate)
        return target, point, local_information(target, point.parameters)


def open_directions(target: Target, parameters: Array) -> list[dict[str, Any]]:
    """List what is open at one point, why, and what would lift it, ready for JSON.

    Parameters
    ----------
    target
        Likelihood, priors and noise.
    parameters
        ``(d,)`` for example the posterior's median, noise scales last.

    Raises
    ------
    BadInput
        If a simulation fails beside the point.
    """
    found: list[dict[str, Any]] = plain(
        identify(target, [Point("estimate", parameters)]).directions
    )
    return found


def identify_record(found: Identification, problem: Problem) -> dict[str, Any]:
    """Put an identification into the form that ``--json`` prints; what is infinite is ``None``."""
    return {"config": str(problem.config.path), **found.as_json()}


def identify_text(found: Identification, problem: Problem) -> list[str]:
    """Word an identification for a person: first what cannot be told, then the tables."""
    unit = "rad" if problem.chain.load.motion == "rotary" else "m"
    return page("identify.txt", found=found, unit=unit)


def _estimate(problem: Problem, progress: Callable[[str], None]) -> dict[str, float]:
    """Estimate by the method that the likelihood belongs to, load losses held by their priors.

    Where the load never drives the motor, nothing but noise says what is lost when it
    does, and an estimate by the data alone ends in a corner: a gearbox that cannot be driven
    back at all. What the data do tell outweighs these priors by far.
    """
    tables = problem.config.tables
    chain, observations = problem.chain, problem.observations
    known = beforehand(chain, problem.priors)
    losses = {
        p.name: (prior.mean(), prior.sd())
        for p in chain.parameters
        if p.quantity in ("load_drive", "load_back") and not (prior := problem.priors[p.name]).fixed
    }
    finite = {name: pair for name, pair in losses.items() if np.isfinite(pair).all()}
    knowledge = replace(known, told={**finite, **known.told})
    progress("input-error estimate")
    found = input_error(chain, observations, knowledge, tables.estimation)
    if tables.likelihood.method == "output-error":
        progress("output-error estimate")
        whole = [
            trajectory(recording, observation, np.inf)
            for recording, observation in zip(problem.recordings, observations, strict=True)
        ]
        found = output_error(chain, whole, observations, knowledge, tables.estimation, found)
    return dict(found.point)
