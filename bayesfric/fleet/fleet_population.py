"""The population that a fleet's units are drawn from, by weighting their draws anew."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.fleet.fleet_units import Unit, places_of
from bayesfric.population.levels import Levels, levels
from bayesfric.population.outliers import WithOutliers, with_outliers
from bayesfric.report.comparison.between_runs import RunDraws, Told, read_draws, told_by_runs
from bayesfric.report.summary.record import Summary, read_summary_file
from bayesfric.report.summary.rows import PosteriorRow

# What is likelier an outlier than not has no say in spreads of joints and trends.
OUTLIER = 0.5


@dataclass(frozen=True, eq=False)
class FleetQuantity:
    """One quantity that the data of two units or more determine."""

    name: str
    units: Mapping[str, PosteriorRow]  # those pooled
    pool: WithOutliers
    levels: Levels
    outlying: Mapping[str, float]  # probability of each unit
    away: Mapping[str, float]  # distance of each from the mean, in sds of the two

    @property
    def told(self) -> PosteriorRow:
        """What the first unit says of it: unit, symbol, meaning, level."""
        return next(iter(self.units.values()))

    def as_json(self, per: str) -> dict[str, Any]:
        """Give what ``population.json`` holds of it; ``per`` is the unit of a trend."""
        spreads = {k: v and asdict(v) for k, v in vars(self.levels).items() if k != "slope"}
        slope = self.levels.slope
        return {
            "name": self.name,
            "unit": self.told.unit,
            "meaning": self.told.meaning,
            "level": self.told.level,
            "units": len(self.units),
            "mean": asdict(self.pool.mean),
            "spread": asdict(self.pool.spread),
            "outlier_share": asdict(self.pool.share),
            "between_joints": spreads["between"],
            "within_joints": spreads["within"],
            "trend": slope and {**asdict(slope), "per": per, "sure": sure(slope.low, slope.high)},
            "outlying": {name: p for name, p in self.outlying.items() if p >= OUTLIER},
        }


def sure(low: float, high: float) -> bool:
    """Whether an interval leaves zero out."""
    return low > 0.0 or high < 0.0


@dataclass(frozen=True, eq=False)
class FleetPopulation:
    """What a fleet's units say together."""

    quantities: Sequence[FleetQuantity] = ()
    per: str = ""  # unit of what trends are over
    over: Mapping[str, float] = field(default_factory=dict)  # its value, by unit

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
            "quantities": [one.as_json(self.per) for one in self.quantities],
            "outliers": [
                {"unit": unit, "probability": p, "quantity": name}
                for unit, p, name in self.outliers
                if p >= OUTLIER
            ],
        }

    def texts(self) -> dict[str, str]:
        """Write ``population.json`` and ``.csv``, by name."""
        made = json.dumps(self.as_json(), indent=1, ensure_ascii=False, allow_nan=False)
        return {"population.json": f"{made}\n", "population.csv": self._csv()}

    def _csv(self) -> str:
        import pandas as pd

        lines = []
        for one in self.quantities:
            told = one.as_json(self.per)
            line = {key: told[key] for key in ("name", "unit", "units", "level")}
            for key in ("mean", "spread", "between_joints", "within_joints", "trend"):
                for end in ("median", "low", "high"):
                    column = key if end == "median" else f"{key}_{end}"
                    line[column] = told[key] and told[key][end]
            lines.append(line | {"outliers": len(told["outlying"])})
        columns = list(lines[0]) if lines else ["name"]
        return str(pd.DataFrame(lines, columns=columns).to_csv(index=False))


def fleet_population(
    folder: Path,
    units: Sequence[Unit],
    *,
    joint: str | None = None,
    over: str | None = None,
) -> FleetPopulation:
    """Pool the finished runs in ``folder``, each named after its unit.

    What the data of a unit leave open does not count, nor does a unit that did not converge.
    ``joint`` and ``over`` are columns.
    """
    runs: dict[str, Summary] = {}
    draws: dict[str, RunDraws] = {}
    for unit in units:
        run = folder / unit.name
        if not (run / "summary.json").is_file():
            continue
        summary = Summary.read(read_summary_file(run), str(run))
        runs[unit.name], draws[unit.name] = summary, read_draws(run, summary)
    by_name = {unit.name: unit for unit in units}
    joints = {name: str(one.values[joint]) for name, one in by_name.items()} if joint else {}
    places, per = places_of(units, over) if over else ({}, "")
    quantities = [
        _pooled(one, joints, places)
        for one in told_by_runs(runs, draws)
        # what a scaling of leg and gearbox changes is a unit's own only where its data tell
        if next(iter(one.runs.values())).gauge_free is not False
    ]
    return FleetPopulation(quantities, per, places)


def _pooled(one: Told, joints: Mapping[str, str], places: Mapping[str, float]) -> FleetQuantity:
    level = next(iter(one.runs.values())).level
    pool = with_outliers(list(one.likelihoods.values()), level)
    outlying = dict(zip(one.likelihoods, pool.outlying, strict=True))
    kept = [name for name, p in outlying.items() if p < OUTLIER and (not places or name in places)]
    found = [one.likelihoods[name] for name in kept]
    parts = Levels(None, None, None)
    if kept:
        parts = levels(
            np.array([x.mean for x in found]),
            np.array([x.sd for x in found]),
            [joints[name] for name in kept] if joints else None,
            np.array([places[name] for name in kept]) if places else None,
            level,
        )
    spread = pool.spread.median
    away = {
        name: abs(x.mean - pool.mean.median) / math.hypot(x.sd, spread)
        for name, x in one.likelihoods.items()
    }
    return FleetQuantity(one.name, one.runs, pool, parts, outlying, away)
