"""A run directory: made beside, moved into place when it is whole."""

from __future__ import annotations

import json
import platform
import shutil
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.base import __version__
from bayesfric.base.atomic_write import new_folder
from bayesfric.base.progress import Progress, Shown, silent
from bayesfric.inference.archive import as_chains, write_archive
from bayesfric.inference.fitting import Fit
from bayesfric.inference.posterior import Posterior
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Measurement
from bayesfric.report.figures.registry import Declared, FinishedRun, captions, run_figures
from bayesfric.report.figures.style import ALL_KINDS, ON_PAGE, save
from bayesfric.report.page.pages import run_page
from bayesfric.report.paper.tables import latex_texts, summary_texts
from bayesfric.report.summary.derived_quantities import Group, coefficients
from bayesfric.report.summary.record import Readable, Summary
from bayesfric.report.summary.rows import PosteriorRow

# Draws kept of the groups that hold a number for every draw and every output: at most, at least,
# and between them as many as make so many numbers.
_POINTWISE_DRAWS, _LEAST_DRAWS, _POINTWISE = 400, 12, 1_000_000
# Draws kept that allow for the model's error.
_TOLD_DRAWS = 4000

FIGURES = run_figures()


def write_run(
    folder: Path,
    fit: Fit,
    summary: Readable,
    config_text: str,
    recordings: list[Measurement],
    saved: Path | None = None,
    draws: int | None = None,
    *,
    paper: bool = False,
    progress: Shown = silent,
) -> None:
    """Write a run directory that :func:`check_output_folder` let pass.

    ``config_text`` is the configuration as read; of ``recordings`` it keeps the SHA-256; what
    the folder ``saved`` holds belongs into it. With a number of ``draws`` it is a light one:
    so many are kept, and neither figures, tables nor page are made, as of one of hundreds nobody
    looks at. ``paper`` adds what a paper wants: tables in LaTeX, references, and figures as PDF and
    PNG.
    """
    summary = Summary.read(summary)
    with new_folder(folder) as beside:
        if saved is not None:
            shutil.copytree(saved, beside, dirs_exist_ok=True)
        (beside / "config.toml").write_text(config_text, encoding="utf-8")
        indent = 1 if draws is None else None
        (beside / "summary.json").write_text(
            json.dumps(summary.as_dict(), indent=indent, ensure_ascii=False, allow_nan=False)
            + "\n",
            encoding="utf-8",
        )
        progress(Progress("draws"))
        archive = archived(fit, summary, config_text, recordings, draws)
        write_archive(beside / "posterior.nc", **archive)
        if draws is not None:
            return
        run = FinishedRun(fit, summary)
        kinds = ALL_KINDS if paper else ON_PAGE
        drawn = draw(beside / "figures", run, kinds, progress)
        texts = summary_texts(summary, folder.name) | {
            "text/captions.md": captions(run, drawn),
        }
        if paper:
            texts |= latex_texts(summary, folder.name)
        for name, text in texts.items():
            (beside / name).parent.mkdir(exist_ok=True)
            (beside / name).write_text(text, encoding="utf-8")
        progress(Progress("page"))
        # last: it is made from what lies there
        page = run_page(beside, summary, folder.name)
        (beside / "report.html").write_text(page, encoding="utf-8")


def draw(
    folder: Path,
    run: FinishedRun,
    kinds: Sequence[str],
    progress: Shown,
) -> list[Declared]:
    """Draw a run's figures into ``folder``, and give those that show anything."""
    folder.mkdir(exist_ok=True)
    drawn = []
    for stem, one in FIGURES.items():
        progress(Progress(f"figure {stem}"))
        if (figure := one.draw(run)) is not None:
            save(figure, folder, stem, kinds)
            drawn.append(one)
    return drawn


def archived(
    fit: Fit,
    summary: Summary,
    config_text: str,
    recordings: list[Measurement],
    draws: int | None = None,
) -> dict[str, Any]:
    """Put together what :func:`~bayesfric.inference.archive.make_archive` takes of a run.

    ``posterior`` holds every kept draw, a walker being a chain, and ``derived`` what follows from
    it; their variables carry units, symbol, meaning and verdict. ``told`` holds both with room for
    the model's error, where recordings show any: what simulations go on with. ``ensemble`` of
    ``sample_stats`` says which walkers belong together. ``log_likelihood`` and
    ``posterior_predictive`` hold a number for each output and a part of the draws. A light run has
    so many ``draws`` of the posterior, with what follows from them, and of its prior.
    """
    posterior, outputs = fit.posterior, fit.target.likelihood.outputs
    rng = np.random.default_rng(np.random.SeedSequence(posterior.seed, spawn_key=(1,)))
    told = {name: _told(row) for name, row in summary.rows.items()}
    made = coefficients(fit)
    if draws is None:
        groups = _every_draw(fit, made, rng)
    else:
        groups = {"posterior": _some(posterior, made, draws)}
    if fit.wide is not fit:
        groups["told"] = _some(fit.wide.posterior, made, draws or _TOLD_DRAWS)
    groups["prior"] = {
        # of a light run for a density that is smoothed anyway
        name: prior.draw(draws or 2000, rng)[None].astype(np.float32 if draws else np.float64)
        for name, prior in zip(posterior.names, posterior.priors, strict=True)
    }
    return {
        "groups": groups,
        "dims": {o.name: [f"time_{o.name}"] for o in outputs} if draws is None else {},
        "coords": {f"time_{o.name}": o.time for o in outputs} if draws is None else {},
        "attrs": _told_of_run(fit, summary, config_text, recordings),
        "variable_attrs": dict.fromkeys(("posterior", "derived", "prior", "told"), told),
    }


def _every_draw(fit: Fit, made: Group, rng: np.random.Generator) -> dict[str, dict[str, Array]]:
    posterior = fit.posterior
    chains = {name: as_chains(posterior[name]) for name in posterior.names}
    n_chains, n_draws = next(iter(chains.values())).shape
    walkers = posterior.draws.shape[1]
    ensemble = np.repeat(np.arange(n_chains) // walkers, n_draws).reshape(n_chains, n_draws)
    log_likelihood, predictive = _pointwise(fit, rng)
    # totals as least squares would see them need the recordings, and are in the summary only
    every = as_chains(posterior.draws)
    derived = made.named(every.reshape(-1, every.shape[-1]))
    return {
        "posterior": chains,
        **(
            {"derived": {n: x.reshape(n_chains, n_draws) for n, x in derived.items()}}
            if derived
            else {}
        ),
        "log_likelihood": log_likelihood,
        "sample_stats": {"lp": as_chains(posterior.log_density), "ensemble": ensemble},
        "posterior_predictive": predictive,
        "observed_data": {o.name: o.measured for o in fit.target.likelihood.outputs},
    }


def _some(posterior: Posterior, made: Group, draws: int) -> dict[str, Array]:
    """Take so many draws of every parameter and of what follows from it, ``(1, draws)`` each."""
    kept = posterior.flat(draws)
    parameters = dict(zip(posterior.names, kept.T, strict=True))
    return {name: x[None] for name, x in (parameters | made.named(kept)).items()}


def _told_of_run(
    fit: Fit, summary: Summary, config_text: str, recordings: list[Measurement]
) -> dict[str, str]:
    """Say what is needed to repeat a run."""
    return {
        "bayesfric": __version__,
        "versions": json.dumps(
            {"python": platform.python_version()}
            | {name: version(name) for name in ("numpy", "scipy", "emcee", "arviz", "numba")}
        ),
        "seed": str(fit.posterior.seed),
        "config": config_text,
        "recordings": json.dumps({r.name: r.sha256 for r in recordings}),
        "spans": json.dumps({o.name: [o.stamps[0], o.stamps[-1]] for o in fit.observations}),
        "noise": json.dumps(summary.noise.as_dict()),
        "fixed": json.dumps({name: row.as_dict() for name, row in summary.fixed.items()}),
        "status": summary.sampler.status,
    }


def _told(row: PosteriorRow) -> dict[str, str]:
    """Say what a variable is: unit, symbol, meaning, verdict and doubts."""
    told = {"units": row.unit or "1", "symbol": row.symbol, "long_name": row.meaning}
    told |= {"verdict": row.verdict, "doubted": ", ".join(row.doubted)}
    return {key: text for key, text in told.items() if text}


def _pointwise(fit: Fit, rng: np.random.Generator) -> tuple[dict[str, Array], dict[str, Any]]:
    """Log-likelihood and a predictive draw of every output, ``(ensembles, draws, outputs)``."""
    e, w, s, d = fit.posterior.draws.shape
    each = fit.posterior.draws.reshape(e, w * s, d)
    outputs = sum(o.measured.size for o in fit.target.likelihood.outputs)
    most = max(min(_POINTWISE_DRAWS, _POINTWISE // outputs), _LEAST_DRAWS) // e
    n = min(w * s, max(most, 1))
    picked = each[:, np.linspace(0, w * s - 1, n).astype(int)]
    flat = picked.reshape(-1, d)
    likelihood = fit.target.likelihood
    scales = fit.target.noise.scales(flat[:, len(fit.target.free) :])
    values = fit.target.chain_values(flat)
    log_likelihood, predictive = {}, {}
    for o, density, predicted, noise in zip(
        likelihood.outputs,
        likelihood.pointwise(values, scales),
        likelihood.predict(values),
        likelihood.draw_noise(scales, rng),
        strict=True,
    ):
        # the position's terms are combinations of outputs, two fewer a segment
        same = density.shape[1] == o.measured.size
        name = o.name if same else f"{o.name}.terms"
        log_likelihood[name] = density.reshape(e, n, -1)
        predictive[o.name] = (predicted + noise).reshape(e, n, -1).astype(np.float32)
    return log_likelihood, predictive
