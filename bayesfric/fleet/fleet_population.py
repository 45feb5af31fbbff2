"""The population that a fleet's units are drawn from, by weighting their draws anew."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bayesfric.population.outliers import WithOutliers, with_outliers
from bayesfric.report.comparison.between_runs import SharedQuantity, read_draws, shared_quantities
from bayesfric.report.summary.record import Summary
from bayesfric.report.summary.rows import PosteriorRow

# What is likelier an outlier than not is told as one.
OUTLIER = 0.5


@dataclass(frozen=True, eq=False)
class FleetQuantity:
    """One quantity that the data of two units or more determine."""

    name: str
    units: Mapping[str, PosteriorRow]  # those pooled
    pool: WithOutliers
    outlying: Mapping[str, float]  # probability of each unit
    away: Mapping[str, float]  # distance of each from the mean, in sds of the two

    @property
    def told(self) -> PosteriorRow:
        """What the first unit says of it: unit, symbol, meaning, level."""
        return next(iter(self.units.values()))

    def as_json(self) -> dict[str, Any]:
        """Give what ``population.json`` holds of it."""
        return {
            "name": self.name,
            "unit": self.told.unit,
            "meaning": self.told.meaning,
            "level": self.told.level,
            "units": len(self.units),
            "mean": asdict(self.pool.mean),
            "spread": asdict(self.pool.spread),
            "outlier_share": asdict(self.pool.share),
            "outlying": {name: p for name, p in self.outlying.items() if p >= OUTLIER},
        }


@dataclass(frozen=True, eq=False)
class FleetPopulation:
    """What a fleet's units say together."""

    quantities: Sequence[FleetQuantity] = ()

    @property
    def outliers(self) -> list[tuple[str, float, str]]:
        """Units with their probability and in which quantity; the likeliest first."""
        worst: dict[str, tuple[float, float, str]] = {}
        for one in self.quantities:
            for unit, p in one.outlying.items():
                told = (round(p, 6), one.away[unit], one.name)
                worst[unit] = max(worst.get(unit, told), told)
        ranked = sorted(worst.items(), key=lambda pair: pair[1][:2], reverse=True)
        return [(unit, p, name) for unit, (p, _, name) in ranked]

    def as_json(self) -> dict[str, Any]:
        """Give what ``population.json`` holds."""
        return {
            "quantities": [one.as_json() for one in self.quantities],
            "outliers": [
                {"unit": unit, "probability": p, "quantity": name}
                for unit, p, name in self.outliers
                if p >= OUTLIER
            ],
        }


def fleet_population(folder: Path, runs: Mapping[str, Summary]) -> FleetPopulation:
    """Pool the finished runs in ``folder``, each named after its unit.

    What the data of a unit leave open does not count, nor does a unit that did not converge.
    """
    draws = {unit: read_draws(folder / unit, summary) for unit, summary in runs.items()}
    quantities = [
        _pooled(one)
        for one in shared_quantities(runs, draws)
        # what a scaling of leg and gearbox changes is a unit's own only where its data tell
        if next(iter(one.runs.values())).gauge_free is not False
    ]
    return FleetPopulation(quantities)


def _pooled(one: SharedQuantity) -> FleetQuantity:
    level = next(iter(one.runs.values())).level
    pool = with_outliers(list(one.likelihoods.values()), level)
    outlying = dict(zip(one.likelihoods, pool.outlying, strict=True))
    spread = pool.spread.median
    away = {
        name: abs(x.mean - pool.mean.median) / math.hypot(x.sd, spread)
        for name, x in one.likelihoods.items()
    }
    return FleetQuantity(one.name, one.runs, pool, outlying, away)
