"""Results of a fleet: the table, and the population that the units are drawn from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from bayesfric.fleet.plan import COLUMNS, FAILED, Unit
from bayesfric.population.population import WithOutliers, with_outliers
from bayesfric.report.comparison.between_runs import shared_quantities
from bayesfric.report.summary.record import PosteriorRow, Summary

if TYPE_CHECKING:
    import pandas as pd

# Probability from which a unit is reported as an outlier.
OUTLIER = 0.5


def results_table(
    units: Sequence[Unit], runs: Mapping[str, Summary], errors: Mapping[str, str]
) -> pd.DataFrame:
    """Tabulate the reported quantities of each unit, or why it failed, and the units' columns."""
    import pandas as pd

    frames = []
    for unit in units:
        if unit.name in errors:
            row = {"outcome": FAILED, "error": errors[unit.name]}
            frames.append(pd.DataFrame([{"unit": unit.name, **row}]))
            continue
        frame = runs[unit.name].frame.rename(columns={"name": "quantity", "unit": "measure"})
        outcome = runs[unit.name].verdict.outcome
        frames.append(frame.assign(unit=unit.name, outcome=outcome))
    parts = [frame.reindex(columns=[*COLUMNS]).astype(COLUMNS) for frame in frames]
    table = pd.concat(parts, ignore_index=True)
    values = {unit.name: unit.values for unit in units}
    columns = pd.DataFrame.from_dict(values, orient="index").convert_dtypes()
    return table.join(columns[[name for name in columns if name not in COLUMNS]], on="unit")


@dataclass(frozen=True, eq=False)
class FleetQuantity:
    """The population of a quantity that the data of two units or more determine."""

    name: str
    units: Mapping[str, PosteriorRow]  # those pooled
    pool: WithOutliers

    @property
    def row(self) -> PosteriorRow:
        """The first unit's row, for unit, symbol, meaning and level."""
        return next(iter(self.units.values()))

    @property
    def outlying(self) -> dict[str, float]:
        """Probability of each unit to be an outlier."""
        return dict(zip(self.units, self.pool.outlying, strict=True))

    def as_json(self) -> dict[str, Any]:
        """Give its part of ``population.json``."""
        described = {key: getattr(self.row, key) for key in ("unit", "meaning", "level")}
        return {"name": self.name, **described, "units": len(self.units)} | {
            "mean": asdict(self.pool.mean),
            "spread": asdict(self.pool.spread),
            "outlier_share": asdict(self.pool.share),
            "outlying": {name: p for name, p in self.outlying.items() if p >= OUTLIER},
        }


def fleet_population(runs: Mapping[str, Summary]) -> list[FleetQuantity]:
    """Pool finished runs, each by the name of its unit.

    Quantities that a unit's data do not identify, and units that did not converge, are left out.
    So is what depends on the open scaling of link and gearbox, which may differ between units.
    """
    population = []
    for name, rows in shared_quantities(runs).items():
        if all(row.gauge_free is not False for row in rows.values()):
            means, sds = zip(*((row.mean, row.reported.sd) for row in rows.values()), strict=True)
            pool = with_outliers(means, sds, next(iter(rows.values())).level)
            population.append(FleetQuantity(name, rows, pool))
    return population


def ranked_units(population: Sequence[FleetQuantity]) -> dict[str, tuple[float, str]]:
    """Rank units by their probability of being an outlier, each in its farthest quantity."""
    worst: dict[str, tuple[float, float, str]] = {}
    for quantity in population:
        mean, spread = quantity.pool.mean.median, quantity.pool.spread.median
        for unit, p in quantity.outlying.items():
            row = quantity.units[unit]
            away = abs(row.mean - mean) / math.hypot(row.reported.sd, spread)
            entry = (round(p, 6), away, quantity.name)
            worst[unit] = max(worst.get(unit, entry), entry)
    ranked = sorted(worst.items(), key=lambda pair: pair[1][:2], reverse=True)
    return {unit: (p, name) for unit, (p, _, name) in ranked}


def population_record(population: Sequence[FleetQuantity]) -> dict[str, Any]:
    """Give the content of ``population.json``."""
    return {
        "quantities": [quantity.as_json() for quantity in population],
        "outliers": [
            {"unit": unit, "probability": p, "quantity": name}
            for unit, (p, name) in ranked_units(population).items()
            if p >= OUTLIER
        ],
    }
