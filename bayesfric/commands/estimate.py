"""``bayesfric estimate``: the paper's three methods, side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayesfric.commands.problem import Problem
from bayesfric.errors import BadInput
from bayesfric.estimates.estimate import METHODS, Estimate
from bayesfric.estimates.methods import ESTIMATORS, estimate_by
from bayesfric.report.summary.summary import estimate_summary


def estimates(
    problem: Problem,
    methods: Sequence[str] = METHODS,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Estimate]:
    """Estimate a problem's parameters by one or more methods.

    ``progress`` is called with the name of each method before it begins.

    Raises
    ------
    BadInput
        If a method cannot be used with these recordings.
    """
    with problem.config.named():
        return list(estimate_by(methods, problem.given(), progress=progress).values())


def estimates_beside(
    problem: Problem, *, simulate: bool, progress: Callable[[str], None] = lambda _: None
) -> tuple[list[Estimate], list[str]]:
    """Estimate what stands beside a posterior, with a sentence for what cannot be had.

    An estimate that simulates is asked for, or the likelihood needs it as a place to start from:
    then however long it takes, as sampling that goes on later must start from the same place.
    A mechanism that cannot be simulated still has a posterior of the torque.
    """
    tables = problem.config.tables
    given = problem.given()
    simulating = [one.name for one in ESTIMATORS.values() if one.simulates]
    plain = [name for name in METHODS if name not in simulating]
    found = {e.method: e for e in estimates(problem, plain, progress=progress)}
    if tables.likelihood.method in simulating:
        given = replace(given, options=given.options.model_copy(update={"max_seconds": np.inf}))
    elif not (simulate or tables.estimation.output_error):
        simulating = []
    missing = []
    for name in simulating:
        try:
            found |= estimate_by([name], given, found, progress=progress)
        except BadInput as error:
            missing.append(f"no {name} estimate: {error.what}")
    return list(found.values()), missing


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
        yield ESTIMATORS[estimate.method].title
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
