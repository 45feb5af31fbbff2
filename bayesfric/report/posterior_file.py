"""``posterior.nc``: draws, predictions and data of a run in ArviZ's groups."""

from __future__ import annotations

import io
import json
import platform
from collections.abc import Mapping
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from bayesfric.base import __version__
from bayesfric.inference.fitting import Fit
from bayesfric.inference.posterior import Posterior
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Measurement
from bayesfric.report.summary.derived_quantities import Group, coefficients
from bayesfric.report.summary.record import PosteriorRow, Summary

if TYPE_CHECKING:
    import xarray as xr

# Groups whose variables are parameters and derived quantities, in their units.
_IN_UNITS = ("posterior", "derived", "prior", "widened")

# Some arrays are of whole numbers, or of single precision.
Arrays = dict[str, NDArray[Any]]


def posterior_tree(
    fit: Fit, summary: Summary, config_text: str, recordings: list[Measurement]
) -> xr.DataTree:
    """Return the contents of ``posterior.nc`` for xarray and ArviZ."""
    import xarray as xr  # takes half a second

    content = posterior_bytes(fit, summary, config_text, recordings)
    return xr.load_datatree(io.BytesIO(content), engine="h5netcdf")


def posterior_bytes(
    fit: Fit,
    summary: Summary,
    config_text: str,
    recordings: list[Measurement],
    draws: int | None = None,
) -> bytes:
    """Return ``posterior.nc``, NetCDF 4: HDF5 whose dimensions are scales.

    It is made in memory: on a full disk HDF5 would end the process. In ``posterior`` and
    ``derived`` a walker is a chain. ``widened`` holds both with model discrepancy, where recordings
    show any: the draws that simulations use. ``log_likelihood`` and ``posterior_predictive`` hold a
    number for each output and a subset of the draws. A light run has so many ``draws`` of posterior
    and prior.
    """
    posterior, outputs = fit.posterior, fit.target.likelihood.outputs
    rng = np.random.default_rng(np.random.SeedSequence(posterior.seed, spawn_key=(1,)))
    derived = coefficients(fit)
    if draws is None:
        groups = _every_draw(fit, derived, rng)
    else:
        groups = {"posterior": _subset(posterior, derived, draws)}
    if fit.wide is not fit:
        groups["widened"] = _subset(fit.wide.posterior, derived, draws or 4000)
    groups["prior"] = {
        # of a light run for a density that is smoothed anyway
        name: prior.draw(draws or 2000, rng)[None].astype(np.float32 if draws else np.float64)
        for name, prior in zip(posterior.names, posterior.priors, strict=True)
    }
    times = {f"time_{o.name}": o.time for o in outputs}
    described = {name: _description(row) for name, row in summary.rows.items()}
    with h5py.File("posterior.nc", "w", driver="core", backing_store=False, track_order=True) as f:
        f.attrs.update(_provenance(fit, summary, config_text, recordings))
        for name, arrays in groups.items():
            group = f.create_group(name, track_order=True)
            _write(group, arrays, times, described if name in _IN_UNITS else {})
        f.flush()
        return bytes(f.id.get_file_image())


def _write(
    group: h5py.Group,
    arrays: Arrays,
    times: Mapping[str, Array],
    described: Mapping[str, dict[str, str]],
) -> None:
    """Write arrays with their dimensions: chain and draw, then the time of the outputs."""
    for name, array in arrays.items():
        dims = [] if group.name == "/observed_data" else ["chain", "draw"]
        if len(dims) < array.ndim:
            time = f"time_{name}"
            dims = [*dims, time if time in times else f"term_{name}"]
        variable = group.create_dataset(name, data=array)
        variable.attrs.update(described.get(name, {}))
        for axis, dim, size in zip(variable.dims, dims, array.shape, strict=True):
            if dim not in group:
                group.create_dataset(dim, data=times.get(dim, np.arange(size))).make_scale(dim)
            axis.attach_scale(group[dim])


def _every_draw(fit: Fit, derived: Group, rng: np.random.Generator) -> dict[str, Arrays]:
    posterior = fit.posterior
    ensembles, walkers, steps, d = posterior.draws.shape
    chains = (ensembles * walkers, steps)
    flat = posterior.draws.reshape(-1, d)
    named = dict(zip(posterior.names, flat.T, strict=True))
    densities = {
        name: prior.log_density(named[name])
        for name, prior in zip(posterior.names, posterior.priors, strict=True)
    }
    log_likelihood, predictive = _pointwise(fit, rng)
    ensemble = np.repeat(np.arange(ensembles), walkers * steps)
    by_chain: dict[str, Arrays] = {
        "posterior": named,
        # totals of least squares need the recordings, and are in the summary only
        "derived": derived.named(flat),
        "log_prior": densities,
        "sample_stats": {"lp": posterior.log_density, "ensemble": ensemble},
    }
    return {
        **{g: {n: x.reshape(chains) for n, x in of.items()} for g, of in by_chain.items() if of},
        "log_likelihood": log_likelihood,
        "posterior_predictive": predictive,
        "observed_data": {o.name: o.measured for o in fit.target.likelihood.outputs},
    }


def _subset(posterior: Posterior, derived: Group, draws: int) -> Arrays:
    flat = posterior.flat(draws)
    parameters = dict(zip(posterior.names, flat.T, strict=True))
    return {name: x[None] for name, x in (parameters | derived.named(flat)).items()}


def _pointwise(
    fit: Fit, rng: np.random.Generator, *, draws: tuple[int, int] = (12, 400), size: int = 1_000_000
) -> tuple[Arrays, Arrays]:
    """Log-likelihood and a predictive draw of every output, ``(ensembles, draws, outputs)``.

    At least and at most so many ``draws``, between them as many as make arrays of a ``size``.
    """
    e, w, s, d = fit.posterior.draws.shape
    each = fit.posterior.draws.reshape(e, w * s, d)
    outputs = sum(o.measured.size for o in fit.target.likelihood.outputs)
    max_count = max(min(draws[1], size // outputs), draws[0]) // e
    n = min(w * s, max(max_count, 1))
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
        log_likelihood[name] = density.reshape(e, n, -1).astype(np.float32)
        predictive[o.name] = (predicted + noise).reshape(e, n, -1).astype(np.float32)
    return log_likelihood, predictive


def _provenance(
    fit: Fit, summary: Summary, config_text: str, recordings: list[Measurement]
) -> dict[str, str]:
    """Gather what is needed to repeat a run."""
    return {
        "bayesfric": __version__,
        "versions": json.dumps(
            {"python": platform.python_version()}
            | {name: version(name) for name in ("numpy", "scipy", "emcee", "numba", "xarray")}
        ),
        "seed": str(fit.posterior.seed),
        "config": config_text,
        "recordings": json.dumps({r.name: r.sha256 for r in recordings}),
        "spans": json.dumps({o.name: [o.stamps[0], o.stamps[-1]] for o in fit.observations}),
        "noise": json.dumps(summary.noise.as_dict()),
        "fixed": json.dumps({name: row.as_dict() for name, row in summary.fixed.items()}),
        "status": summary.sampler.status,
    }


def _description(row: PosteriorRow) -> dict[str, str]:
    texts = {"units": row.unit or "1", "symbol": row.symbol, "long_name": row.meaning}
    texts |= {"verdict": row.verdict, "doubted": ", ".join(row.doubted)}
    return {key: text for key, text in texts.items() if text}
