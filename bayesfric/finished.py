"""A finished posterior to go on with: of a sampled model, or of a run directory."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput
from bayesfric.mechanism.joint import Joint
from bayesfric.model import Model
from bayesfric.report.summary.record import Summary, read_summary_file
from bayesfric.result import Result, result_of

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Finished:
    """What was fitted, and draws that allow for the model's error where recordings show any."""

    model: Model
    summary: Summary
    names: tuple[str, ...]  # of what was sampled, noise scales last
    draws: Array  # (n, len(names)), in SI units
    name: str  # of the run, for messages and captions

    @property
    def joint(self) -> Joint:
        """The mechanism, with the offsets of its recordings."""
        return self.model.chain

    def picked(self, most: int) -> Array:
        """At most so many draws, evenly spread, ``(n, len(names))``."""
        if most >= len(self.draws):
            return self.draws
        return np.asarray(self.draws[np.linspace(0, len(self.draws) - 1, most).astype(int)])

    def values(self, draws: Array) -> Array:
        """Parameters of the joint, fixed ones included: ``(n, d)`` to ``(n, n_parameters)``."""
        found = np.empty((len(draws), len(self.joint.names)))
        for k, name in enumerate(self.joint.names):
            if name in self.names:
                found[:, k] = draws[:, self.names.index(name)]
            else:
                found[:, k] = self.model.priors[name].value
        return found


def finished(posterior: Any) -> Finished:
    """Take a posterior from :meth:`bayesfric.Model.sample`, or the folder of a finished run.

    Raises
    ------
    BadInput
        If the folder holds no run, or none of the recordings that it was fitted to.
    """
    if not isinstance(posterior, str | Path):
        return _sampled(result_of(posterior))
    run = Path(posterior)
    summary = Summary.read(read_summary_file(run), str(run))
    model = Model.from_config(run / "config.toml")
    names = tuple(summary.parameters)
    path = run / "posterior.nc"
    try:
        with h5py.File(path) as file:
            group = file["told" if "told" in file else "posterior"]
            draws = np.stack([np.asarray(group[name][()]).ravel() for name in names], axis=1)
    except (OSError, KeyError, TypeError, ValueError, AttributeError):
        raise BadInput(
            str(path), "holds no draws of the run's parameters", "fit the run again"
        ) from None
    free = [name for name in model.chain.names if not model.priors[name].fixed]
    if missing := [name for name in free if name not in names]:
        raise BadInput(
            str(run / "config.toml"), f"{missing[0]} was not sampled", "fit the run again"
        )
    return Finished(model, summary, names, draws.astype(np.float64), run.resolve().name)


def _sampled(result: Result) -> Finished:
    posterior = result.fit.wide.posterior
    name = result.model.config.path.stem
    return Finished(result.model, result.summary, posterior.names, posterior.flat(), name)
