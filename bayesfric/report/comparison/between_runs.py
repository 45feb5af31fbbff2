"""What several runs say together: pooled values, and how far they differ beyond intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import brentq

from bayesfric.report.comparison.cell import has_converged
from bayesfric.report.comparison.comparison import on_one_turn
from bayesfric.report.summary.record import PosteriorRow, Summary, of_noise

Array = NDArray[np.float64]

# Runs disagree where runs of one truth would differ as much more seldom than this.
_SELDOM = 0.05


@dataclass(frozen=True)
class Pool:
    """Several measurements of one quantity, taken together."""

    # of the mean over all runs there could be
    mean: float
    sd: float
    # ends of its interval
    low: float
    high: float
    between_sd: float  # standard deviation of the true values between runs
    # Cochran's Q of one common truth, and how often chance alone gives as much
    q: float
    p_value: float

    @property
    def agree(self) -> bool:
        """Whether the measurements differ by no more than their intervals let expect."""
        return self.p_value >= _SELDOM


@dataclass(frozen=True)
class PooledQuantity:
    """One quantity that the data of every run determine; ``runs`` are the rows pooled."""

    name: str
    runs: Mapping[str, PosteriorRow]
    pool: Pool

    @property
    def told(self) -> PosteriorRow:
        """What the first run says of it: unit, symbol, meaning, level."""
        return next(iter(self.runs.values()))


def pool(values: Sequence[float], sds: Sequence[float], level: float) -> Pool:
    r"""Pool measurements ``y_i ~ N(theta_i, s_i^2)`` of ``theta_i ~ N(mu, tau^2)``.

    ``tau^2`` solves ``sum w_i (y_i - mu)^2 = k - 1`` with ``w_i = 1/(s_i^2 + tau^2)`` and
    ``mu`` the weighted mean [1]_, [2]_; it is zero where the left side is smaller at
    zero already. The interval of ``mu`` takes Student's t of ``k - 1`` degrees of
    freedom [3]_, and never a variance below ``1/sum w_i`` [4]_: with the few runs there
    usually are a normal one would be far too narrow.

    Parameters
    ----------
    values, sds
        Of each run, ``k >= 2``; sds greater than zero.
    level
        Share that the interval shall hold.

    Raises
    ------
    ValueError
        With fewer than two, or a sd that is not positive.

    References
    ----------
    .. [1] R. C. Paule, J. Mandel, "Consensus values and weighting factors", J. Res. Natl.
       Bur. Stand. 87 (1982) 377-385.
    .. [2] R. DerSimonian, R. Kacker, "Random-effects model for meta-analysis of clinical
       trials: an update", Contemp. Clin. Trials 28 (2007) 105-114.
    .. [3] G. Knapp, J. Hartung, "Improved tests for a random effects meta-regression with
       a single covariate", Stat. Med. 22 (2003) 2693-2710.
    .. [4] C. Röver, G. Knapp, T. Friede, "Hartung-Knapp-Sidik-Jonkman approach and its
       modification for random-effects meta-analysis with few studies", BMC Med. Res.
       Methodol. 15 (2015) 99.
    """
    y, s = np.asarray(values, dtype=float), np.asarray(sds, dtype=float)
    if y.size < 2 or y.shape != s.shape or not np.all(s > 0):
        raise ValueError("two measurements or more with positive sds")
    # of order one, so that the search for tau is as sharp for 1e-5 as for 10
    scale, middle = float(s.min()), float(y.mean())
    y, s = (y - middle) / scale, s / scale
    k = y.size

    def excess(tau2: float) -> float:
        return _spread(y, s, tau2) - (k - 1)

    q = _spread(y, s, 0.0)
    tau2 = 0.0
    if q > k - 1:
        # sum (y - mean)^2/tau^2 bounds the left side from above
        tau2 = float(brentq(excess, 0.0, float(np.sum((y - y.mean()) ** 2)) + 1.0, xtol=1e-14))
    weights = 1.0 / (s**2 + tau2)
    mean = float(np.average(y, weights=weights))
    sd = 1.0 / math.sqrt(float(weights.sum()))
    half = float(stats.t.ppf(0.5 + level / 2.0, k - 1)) * sd
    return Pool(
        mean=middle + scale * mean,
        sd=scale * sd,
        low=middle + scale * (mean - half),
        high=middle + scale * (mean + half),
        between_sd=scale * math.sqrt(tau2),
        q=q,
        p_value=float(stats.chi2.sf(q, k - 1)),
    )


def _spread(y: Array, s: Array, tau2: float) -> float:
    weights = 1.0 / (s**2 + tau2)
    return float(np.sum(weights * (y - np.average(y, weights=weights)) ** 2))


def between_runs(runs: Mapping[str, Summary]) -> list[PooledQuantity]:
    """Pool every quantity that the data of every run, on recordings of its own, determine.

    What any run's prior has a say in is left out: pooled, it would count one prior
    several times. So is a run whose ensembles disagree or stand still: it has no posterior.
    """
    tables = {
        name: run.rows
        for name, run in on_one_turn(runs).items()
        if run.sampler.status != "unusable"
    }
    if len(tables) < 2:
        return []
    first = next(iter(tables.values()))
    found = []
    for name in first:
        rows = {run: table[name] for run, table in tables.items() if name in table}
        if of_noise(name) or len(rows) < len(tables):
            continue
        if any(row.verdict != "data" or not row.sd for row in rows.values()):
            continue
        if not all(has_converged(row, runs[run].sampler.status) for run, row in rows.items()):
            continue
        one = pool(
            [row.mean for row in rows.values()],
            [row.told_sd for row in rows.values()],
            first[name].level,
        )
        found.append(PooledQuantity(name, rows, one))
    return found


def between_runs_csv(found: Sequence[PooledQuantity]) -> str:
    """Lay pooled values out as CSV text, every number in full."""
    import pandas as pd

    columns = ["name", "unit", "runs", "mean", "sd", "low", "high", "level"]
    columns += ["between_sd", "q", "p_value", "agree"]
    lines = [
        {"name": one.name, "unit": one.told.unit, "runs": len(one.runs), "level": one.told.level}
        | asdict(one.pool)
        | {"agree": one.pool.agree}
        for one in found
    ]
    return str(pd.DataFrame(lines, columns=columns).to_csv(index=False))
