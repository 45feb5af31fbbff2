"""Read the draws of a run directory, and make its fit again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.base.safe_read import open_hdf5, read_array
from bayesfric.inference.fitting import Fit
from bayesfric.inference.posterior import Diagnostics, Posterior, Status, predict_held_out
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.held_out import Part
from bayesfric.report.summary.record import Summary


def read_draws(run: Path, summary: Summary) -> dict[str, dict[str, Array]]:
    """Read the draws of a run's parameters, by group; they are finite and of one shape."""
    path = run / "posterior.nc"
    groups: dict[str, dict[str, Array]] = {}
    try:
        with open_hdf5(path, "fit the run again") as file:
            for group in ("posterior", "widened"):
                if group in file:
                    groups[group] = {n: read_array(file[group][n]) for n in summary.parameters}
            if "sample_stats" in file:
                groups["sample_stats"] = {"lp": read_array(file["sample_stats"]["lp"])}
    except BadInput:
        groups = {}
    whole = len(next((x.shape for x in groups.get("posterior", {}).values()), ())) == 2 and all(
        len({x.shape for x in group.values()}) == 1
        and all(x.size and x.dtype.kind == "f" and np.isfinite(x).all() for x in group.values())
        for group in groups.values()
    )
    if not whole:
        raise BadInput(str(path), "holds no draws of the run's parameters", "fit the run again")
    return groups


def flat_draws(group: Mapping[str, Array]) -> Array:
    """Stack the draws of every parameter, ``(n, d)``."""
    return np.stack([x.ravel() for x in group.values()], axis=1).astype(np.float64)


def saved_fit(
    target: Target,
    parts: Sequence[Part],
    summary: Summary,
    groups: Mapping[str, Mapping[str, Array]],
) -> Fit:
    """Make a run's fit again from its draws, without point estimates."""
    sampler, rows = summary.sampler, summary.parameters
    chains = np.stack([*groups["posterior"].values()], axis=-1).astype(np.float64)
    ensembles = sampler.ensembles or 1
    if len(chains) % ensembles:  # the draws of a light run are one chain
        ensembles = 1
    draws = chains.reshape(ensembles, -1, *chains.shape[1:])
    # light runs keep draws alone
    log_density = groups.get("sample_stats", {}).get("lp", np.full(draws.shape[:-1], np.nan))
    # a walker that never moved has no spread
    moved = np.ptp(draws, axis=2).any(axis=-1)
    posterior = Posterior(
        names=target.names,
        priors=target.priors,
        draws=draws,
        log_density=log_density.reshape(draws.shape[:-1]),
        diagnostics=Diagnostics(
            status=cast(Status, sampler.status),
            problems=tuple(sampler.problems),
            rhat=np.array([row.rhat or np.nan for row in rows.values()]),
            ess=np.array([row.ess or np.nan for row in rows.values()]),
            tau=np.full(len(rows), sampler.tau or np.nan),
            acceptance=moved * (sampler.acceptance or 1.0),
            ensembles=ensembles,
            walkers=draws.shape[1],
            warmup=sampler.warmup or 0,
            steps=sampler.steps or draws.shape[2],
            thin=sampler.thin or 1,
            not_finite=sampler.not_finite or 0,
            seconds=sampler.seconds or 0.0,
        ),
        seed=sampler.seed or 0,
    )
    held_out = predict_held_out(target, posterior, parts) if parts else ()
    # they were made in the coordinates that were sampled, which differ here
    widened = flat_draws(groups["widened"]) if "widened" in groups else None
    return Fit(target, posterior, (), tuple(held_out), widened_draws=widened)
