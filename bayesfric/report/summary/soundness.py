"""Which derived quantities have converged, where the sampling as a whole has not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bayesfric.inference.fit import Fit
from bayesfric.inference.sampling.convergence import (
    autocorrelation_time,
    effective_sample_size,
    nested_rhat,
    without_stuck,
)

Array = NDArray[np.float64]


def sound_quantities(
    fit: Fit, values: Callable[[Array], Array], number: int, most: int
) -> NDArray[np.bool_]:
    """Judge quantities by R-hat and independent draws of their own, ``(number,)``.

    What no scaling changes may be known where the parameters it is made of still wander.

    Parameters
    ----------
    fit
        A finished fit.
    values
        The chain's parameters ``(n, n_parameters)`` to the quantities, ``(number, n)``.
    number
        Of quantities.
    most
        Draws to look at.
    """
    diagnostics = fit.posterior.diagnostics
    if diagnostics.status == "reliable":
        return np.ones(number, dtype=np.bool_)
    draws = without_stuck(fit.posterior.draws, diagnostics.acceptance)
    ensembles, walkers, steps, d = draws.shape
    draws = draws[:, :, :: max(1, -(-ensembles * walkers * steps // most))]
    if draws.shape[2] < 2:
        return np.zeros(number, dtype=np.bool_)
    found = values(fit.target.chain_values(draws.reshape(-1, d)))
    with np.errstate(invalid="ignore"):
        middle = np.nanmedian(np.where(np.isfinite(found), found, np.nan), axis=1, keepdims=True)
    # draws that do not have a quantity say nothing against it
    found = np.where(np.isfinite(found), found, middle)
    series = np.moveaxis(found.reshape(number, *draws.shape[:3]), 0, -1)
    ess = effective_sample_size(series, autocorrelation_time(series))
    return diagnostics.sound(nested_rhat(series), ess)
