"""Compute the result of an arm of ``whose.py``, in the same way for all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import arviz as az
import numpy as np
from given import QUANTILES
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Longer chains are thinned to this for the diagnostics.
_LONGEST = 4000
# Largest error of a correct result; of 36 numbers the largest exceeds 3.2 once in twenty.
RIGHT = 4.0
SETTLED = 1.01


@dataclass(frozen=True)
class Measured:
    """Draws of parameters ``(chains, steps, 12)``, and user plus system CPU seconds."""

    draws: Array
    warm_up: float  # adaptation and burn-in, with compiling
    sampling: float
    evaluations: float  # of the density, or density and gradient, while sampling
    weights: Array | None = None  # (steps,) of one chain
    walkers: int = 1  # chains or walkers
    note: str = ""

    def summary(self, names: tuple[str, ...], reference: Array, reference_ess: float) -> dict:
        """Return rates, and errors of quantiles from the reference ``(3, 12)``."""
        if self.weights is None:
            ess, rhat, off = self._of_chains(reference, reference_ess)
        else:
            ess, rhat, off = self._of_weights(reference, reference_ess)
        worst = int(np.argmin(ess))
        out: dict[str, Any] = {
            "ess": float(ess[worst]),
            "worst": names[worst],
            "warm_up_cpu_seconds": self.warm_up,
            "sampling_cpu_seconds": self.sampling,
            "ess_per_cpu_second": float(ess[worst]) / self.sampling,
            "ess_per_cpu_second_with_warm_up": float(ess[worst]) / (self.sampling + self.warm_up),
            "evaluations": self.evaluations,
            "cpu_microseconds_per_evaluation": 1e6 * self.sampling / self.evaluations,
            "evaluations_per_effective_draw": self.evaluations / float(ess[worst]),
            "walkers": self.walkers,
            "rhat": rhat,
            "quantiles_off_by_errors": off,
            "right": off < RIGHT and (rhat is None or rhat < SETTLED),
            "note": self.note,
        }
        return out

    def _of_chains(self, reference: Array, known: float) -> tuple[Array, float, float]:
        x = self.draws[:, :: -(-self.draws.shape[1] // _LONGEST)]
        if len(x) == 1:  # for R-hat
            quarter = x.shape[1] // 4
            x = x[0, : 4 * quarter].reshape(4, quarter, -1)
        ess = np.array([az.ess(c, method="bulk") for c in np.moveaxis(x, 2, 0)], dtype=float)
        rhat = max(float(az.rhat(c)) for c in np.moveaxis(_grouped(x), 2, 0))
        off = 0.0
        for p, places in zip(QUANTILES, reference, strict=True):
            for c, place in zip(np.moveaxis(x, 2, 0), places, strict=True):
                below = (c < place).astype(float)
                n = max(float(az.ess(below, method="mean")), 1.0) if np.ptp(below) else 1.0
                error = np.sqrt(p * (1.0 - p) * (1.0 / n + 1.0 / known))
                off = max(off, abs(below.mean() - p) / error)
        return ess, rhat, float(off)

    def _of_weights(self, reference: Array, known: float) -> tuple[Array, None, float]:
        """Use Kish's ESS, which ignores dependence between draws."""
        assert self.weights is not None
        w = self.weights / self.weights.sum()
        n = 1.0 / float(w @ w)
        below = np.array([w @ (self.draws[0] < places) for places in reference])
        p = np.array(QUANTILES)[:, None]
        error = np.sqrt(p * (1.0 - p) * (1.0 / n + 1.0 / known))
        return np.full(self.draws.shape[2], n), None, float(np.max(np.abs(below - p) / error))


def _grouped(x: Array) -> Array:
    """Group many short chains ``(chains, steps, d)`` into four long ones, in order of time.

    R-hat of single walkers with a hundred draws each is 1.005 even for perfect ones.
    """
    chains, steps, d = x.shape
    if chains <= 4:
        return x
    each = chains // 4
    groups = x[: 4 * each].reshape(4, each, steps, d)
    return groups.swapaxes(1, 2).reshape(4, steps * each, d)
