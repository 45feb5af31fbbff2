"""A finished posterior for further commands, of a sampled model or a run directory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput
from bayesfric.base.safe_read import open_hdf5, read_array
from bayesfric.fit.result import Result, result_of
from bayesfric.inference.fitting import Fit
from bayesfric.inference.noise import NoiseChoice
from bayesfric.inference.posterior import Diagnostics, Posterior, Status
from bayesfric.inference.predictive import predict_held_out
from bayesfric.mechanism.joint import Joint
from bayesfric.problem.problem import Problem
from bayesfric.report.summary.record import Summary, read_summary_file

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Finished:
    """Model, summary and draws of a posterior, widened by the model discrepancy if there is any.

    :class:`bayesfric.fit.result.Result` is what sampling returns and what writes a run; this is
    what is left of it in a run directory, and what export, roll-out and plots need.
    """

    model: Problem
    summary: Summary
    names: tuple[str, ...]  # of the sampled parameters, noise scales last
    draws: Array  # (n, len(names)) in SI units
    name: str  # of the run, for messages and captions

    @property
    def joint(self) -> Joint:
        """The joint, with the offsets of its recordings."""
        return self.model.chain

    def picked(self, most: int) -> Array:
        """Return at most so many draws ``(n, len(names))``, evenly spaced."""
        if most >= len(self.draws):
            return self.draws
        return np.asarray(self.draws[np.linspace(0, len(self.draws) - 1, most).astype(int)])

    def values(self, draws: Array) -> Array:
        """Insert fixed parameters: ``(n, d)`` to ``(n, n_parameters)``."""
        parameters = np.empty((len(draws), len(self.joint.names)))
        for k, name in enumerate(self.joint.names):
            if name in self.names:
                parameters[:, k] = draws[:, self.names.index(name)]
            else:
                parameters[:, k] = self.model.priors[name].value
        return parameters


def finished(posterior: Any) -> Finished:
    """Load a posterior of :meth:`bayesfric.Model.sample`, or the folder of a finished run."""
    if not isinstance(posterior, str | Path):
        return _sampled(result_of(posterior))
    run = Path(posterior)
    summary, model, groups = _read(run)
    names = tuple(summary.parameters)
    group = groups.get("widened") or groups["posterior"]
    draws = np.stack([group[name].ravel() for name in names], axis=1)
    return Finished(model, summary, names, draws.astype(np.float64), run.resolve().name)


def fit_of(run: Path) -> tuple[Fit, Summary]:
    """Restore a finished run's fit from its draws and recordings, without point estimates."""
    summary, model, groups = _read(run)
    sampler, rows = summary.sampler, summary.parameters
    chains = np.stack([groups["posterior"][name] for name in rows], axis=-1).astype(np.float64)
    ensembles = sampler.ensembles or 1
    if len(chains) % ensembles:  # the draws of a light run are one chain
        ensembles = 1
    draws = chains.reshape(ensembles, -1, *chains.shape[1:])
    median = np.median(chains.reshape(-1, chains.shape[-1]), axis=0)
    fixed = {n: p.value for n, p in model.priors.items() if p.fixed}
    point = fixed | dict(zip(rows, median.tolist(), strict=True))
    noise = summary.noise
    target = model.target(
        {name: point[name] for name in model.chain.names},
        NoiseChoice(noise.order or 0, (), tuple(noise.memory), noise.room),
    )
    # a walker that never moved has no spread
    moved = np.ptp(draws, axis=2).any(axis=-1)
    posterior = Posterior(
        names=target.names,
        priors=target.priors,
        draws=draws,
        log_density=groups["sample_stats"]["lp"].reshape(draws.shape[:-1]),
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
    held_out = predict_held_out(target, posterior, model.held_out) if model.held_out else ()
    fit = Fit(target, posterior, (), tuple(held_out))
    if "widened" in groups:
        # they were made in the coordinates that were sampled, which differ here
        widened = np.stack([groups["widened"][name].ravel() for name in rows], axis=1)
        fit = replace(fit, widened_draws=widened.astype(np.float64))
    return fit, summary


def _read(run: Path) -> tuple[Summary, Problem, dict[str, dict[str, Array]]]:
    """Read summary, model and draws."""
    summary = Summary.read(read_summary_file(run), str(run))
    model = Problem.from_config(run / "config.toml")
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
    if not _complete(groups):
        raise BadInput(str(path), "holds no draws of the run's parameters", "fit the run again")
    free = [name for name in model.chain.names if not model.priors[name].fixed]
    if missing := [name for name in free if name not in summary.parameters]:
        raise BadInput(
            str(run / "config.toml"), f"{missing[0]} was not sampled", "fit the run again"
        )
    return summary, model, groups


def _complete(groups: dict[str, dict[str, Array]]) -> bool:
    """Whether there are draws, finite and of one shape in each group."""
    return len(next((x.shape for x in groups.get("posterior", {}).values()), ())) == 2 and all(
        len({x.shape for x in group.values()}) == 1
        and all(x.size and x.dtype.kind == "f" and np.isfinite(x).all() for x in group.values())
        for group in groups.values()
    )


def _sampled(result: Result) -> Finished:
    posterior = result.fit.wide.posterior
    name = result.model.config.path.stem
    return Finished(result.model, result.summary, posterior.names, posterior.flat(), name)
