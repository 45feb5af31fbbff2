"""``bayesfric estimate``: the paper's three methods, side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from bayesfric.commands.problem import Problem
from bayesfric.errors import BadInput
from bayesfric.estimates.estimate import METHODS, Estimate, Method
from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.least_squares import least_squares
from bayesfric.estimates.options import Estimation
from bayesfric.estimates.output_error import output_error
from bayesfric.inference.beforehand import beforehand
from bayesfric.recordings.trajectory import trajectory
from bayesfric.report.summary.summary import estimate_summary


def estimates(
    problem: Problem,
    methods: Sequence[Method] = METHODS,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Estimate]:
    """Estimate a problem's parameters by one or more methods.

    Parameters
    ----------
    problem
        From :func:`bayesfric.commands.problem.read_problem`.
    methods
        Which; the output error starts from the input error's result.
    progress
        Called with the name of each method before it begins.

    Raises
    ------
    BadInput
        If a method cannot be used with these recordings.
    """
    chain, observations = problem.chain, problem.observations
    options = problem.config.tables.estimation
    knowledge = beforehand(chain, problem.priors)
    found: list[Estimate] = []
    with problem.config.named():
        if "least-squares" in methods:
            progress("least-squares")
            found.append(least_squares(chain, observations))
        if "input-error" in methods or "output-error" in methods:
            progress("input-error")
            direct = input_error(chain, observations, knowledge, options)
            if "input-error" in methods:
                found.append(direct)
            if "output-error" in methods:
                found.append(_output_error(problem, direct, options, progress))
    return found


def _output_error(
    problem: Problem, start: Estimate, options: Estimation, progress: Callable[[str], None]
) -> Estimate:
    progress("output-error")
    whole = [
        trajectory(recording, observation, np.inf)
        for recording, observation in zip(problem.recordings, problem.observations, strict=True)
    ]
    knowledge = beforehand(problem.chain, problem.priors)
    return output_error(problem.chain, whole, problem.observations, knowledge, options, start)


def estimates_beside(
    problem: Problem, *, simulate: bool, progress: Callable[[str], None] = lambda _: None
) -> tuple[list[Estimate], list[str]]:
    """Estimate what stands beside a posterior, with a sentence for what cannot be had.

    The output error simulates. It is asked for, or its likelihood needs a place to start from:
    then however long it takes, as sampling that goes on later must start from the same place.
    A mechanism that cannot be simulated still has a posterior of the torque.
    """
    tables = problem.config.tables
    options = tables.estimation
    found = estimates(problem, ("least-squares", "input-error"), progress=progress)
    if tables.likelihood.method == "output-error":
        options = options.model_copy(update={"max_seconds": np.inf})
    elif not (simulate or options.output_error):
        return found, []
    try:
        return [*found, _output_error(problem, found[-1], options, progress)], []
    except BadInput as error:
        return found, [f"no output-error estimate: {error.what}"]


def estimate_record(found: Sequence[Estimate], problem: Problem) -> dict[str, Any]:
    """Put estimates into the form of ``summary.json``."""
    return {
        "config": str(problem.config.path),
        "estimates": {estimate.method: estimate_summary(estimate) for estimate in found},
        "references": problem.references(),
    }


def estimate_text(found: Sequence[Estimate], problem: Problem) -> Iterator[str]:
    """Word estimates for a person, line by line."""
    references = problem.references()
    for estimate in found:
        yield _TITLES[estimate.method]
        yield (
            f"  {estimate.n_outputs} residuals, rms {estimate.residual_rms:.4g} "
            f"{estimate.residual_unit}. {estimate.assumption}."
        )
        yield f"  {'':<30} {'value':>11}   {'sd':>9}   {'sd HAC':>9}   {'sd %':>6}"
        for v in estimate.values:
            yield "  " + _row(v, references.get(v.name), estimate.converged)
        for note in estimate.notes:
            yield f"  {note}"
        yield ""


_TITLES: dict[Method, str] = {
    "least-squares": "Least squares, section 4.1, eq. (11): what the motor feels",
    "input-error": "Direct minimisation of the input error, section 4.2",
    "output-error": "Output error of a simulation (recursive identification), section 4.3",
}


def _row(v: Any, reference: dict[str, Any] | None, converged: bool) -> str:
    beside = f"   {reference['source']}: {reference['value']:.5g}" if reference else ""
    unit = f" {v.unit}" if v.unit else ""
    if not converged:
        return f"{v.name:<30} {'-':>11}   not converged{unit}{beside}"
    if v.at_bound:
        return f"{v.name:<30} {v.value:>11.5g}   on its {v.at_bound} bound{unit}{beside}"
    if not v.determined:
        span = f"; {v.span[0]:.3g} to {v.span[1]:.3g} fit as well" if v.span else ""
        return f"{v.name:<30} {'-':>11}   not determined{span}{unit}{beside}"
    robust = f"{v.sd_robust:>9.2g}" if np.isfinite(v.sd_robust) else f"{'-':>9}"
    percent = f"{v.relative_sd:>6.1f}" if np.isfinite(v.relative_sd) else f"{'-':>6}"
    return f"{v.name:<30} {v.value:>11.5g} ± {v.sd:>9.2g}   {robust}   {percent}{unit}{beside}"
