"""Rank statistics: coverage, and simultaneous uniformity of ranks."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]

LEVEL = 0.99


def simultaneous(n: int, ranked: int, level: float = LEVEL, trials: int = 4000) -> float:
    """Return the pointwise probability whose binomial bands hold simultaneously at this level.

    For ``n`` uniform ranks among ``ranked`` draws, by simulation (Säilynoja, Bürkner and Vehtari,
    Stat. Comput. 32, 2022).
    """
    rng = np.random.default_rng(1)
    z = np.arange(1, ranked + 1) / (ranked + 1.0)
    ranks = rng.integers(0, ranked + 1, size=(trials, n))
    counts = np.stack([np.bincount(row, minlength=ranked + 1) for row in ranks])
    below = np.cumsum(counts, axis=1)[:, :-1]
    # two-sided tail probability of each count, and the smallest of each trial
    tail = 2.0 * np.minimum(stats.binom.cdf(below, n, z), stats.binom.sf(below - 1, n, z))
    return float(np.quantile(tail.min(axis=1), 1.0 - level))


def band(n: int, ranked: int, probability: float) -> tuple[Array, Array, Array]:
    """Return quantiles, and the lowest and highest share of ranks below each."""
    z = np.arange(1, ranked + 1) / (ranked + 1.0)
    low = stats.binom.ppf(probability / 2.0, n, z) / n
    high = stats.binom.ppf(1.0 - probability / 2.0, n, z) / n
    return z, low, high


def summary_of(rows: list[dict[str, Any]], ranked: int) -> dict[str, Any]:
    """Summarise the recordings of one case."""
    names = rows[0]["names"]
    ranks = np.array([row["rank"] for row in rows])
    covered = np.array([row["covered"] for row in rows])
    contraction = np.array([row["contraction"] for row in rows]).mean(axis=0)
    n = len(rows)
    # the level is shared among all quantities of the case
    probability = simultaneous(n, ranked, 1.0 - (1.0 - LEVEL) / len(names))
    z, low, high = band(n, ranked, probability)
    quantities = {}
    for j, name in enumerate(names):
        below = np.array([(ranks[:, j] < k).mean() for k in range(1, ranked + 1)])
        quantities[name] = {
            "coverage": float(covered[:, j].mean()),
            "inside": bool(np.all((below >= low) & (below <= high))),
            "contraction": float(contraction[j]) if j < contraction.size else None,
            "difference": (below - z).round(5).tolist(),
        }
    return {
        "recordings": n,
        "ranked": ranked,
        "band": [(low - z).round(5).tolist(), (high - z).round(5).tolist()],
        "statuses": dict(Counter(row["status"] for row in rows)),
        "seconds": float(np.median([row["seconds"] for row in rows])),
        "quantities": quantities,
    }
