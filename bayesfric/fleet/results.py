"""Results of a fleet: the table, and the population that the units are drawn from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesfric.fleet.plan import COLUMNS, FAILED, Unit
from bayesfric.population.population import WithOutliers, with_outliers
from bayesfric.report.comparison.between_runs import read_draws, shared_quantities
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

    rows: list[dict[str, Any]] = []
    for unit in units:
        if unit.name in errors:
            rows.append({"unit": unit.name, "outcome": FAILED, "error": errors[unit.name]})
            continue
        summary = runs[unit.name]
        for name, row in summary.rows.items():
            reported = row.reported
            rows.append(
                {
                    "unit": unit.name,
                    "outcome": summary.verdict.outcome,
                    "quantity": name,
                    "value": reported.value,
                    "sd": reported.sd,
                    "low": reported.interval[0],
                    "high": reported.interval[1],
                    "level": row.level,
                    "measure": row.unit,
                    "status": reported.status,
                    "findings": ", ".join(row.doubted if row.doubtful else ()),
                }
            )
    table = pd.DataFrame(rows, columns=[*COLUMNS]).astype(COLUMNS)
    values = {unit.name: unit.values for unit in units}
    columns = pd.DataFrame.from_dict(values, orient="index").convert_dtypes()
    return table.join(columns[[name for name in columns if name not in COLUMNS]], on="unit")


@dataclass(frozen=True, eq=False)
class FleetQuantity:
    """The population of a quantity that the data of two units or more determine."""

    name: str
    units: Mapping[str, PosteriorRow]  # those pooled
    pool: WithOutliers
    outlying: Mapping[str, float]  # probability of each unit
    distance: Mapping[str, float]  # of each from the mean, in sds of both

    @property
    def row(self) -> PosteriorRow:
        """The first unit's row, for unit, symbol, meaning and level."""
        return next(iter(self.units.values()))

    def as_json(self) -> dict[str, Any]:
        """Give its part of ``population.json``."""
        return {
            "name": self.name,
            "unit": self.row.unit,
            "meaning": self.row.meaning,
            "level": self.row.level,
            "units": len(self.units),
            "mean": asdict(self.pool.mean),
            "spread": asdict(self.pool.spread),
            "outlier_share": asdict(self.pool.share),
            "outlying": {name: p for name, p in self.outlying.items() if p >= OUTLIER},
        }


def fleet_population(folder: Path, runs: Mapping[str, Summary]) -> list[FleetQuantity]:
    """Pool the finished runs in ``folder``, each named after its unit.

    Quantities that a unit's data do not identify, and units that did not converge, are left out.
    """
    draws = {unit: read_draws(folder / unit, summary) for unit, summary in runs.items()}
    population = []
    for quantity in shared_quantities(runs, draws):
        if quantity.row.gauge_free is False:
            continue  # an open scaling of link and gearbox may differ between units
        pool = with_outliers(list(quantity.likelihoods.values()), quantity.row.level)
        outlying = dict(zip(quantity.likelihoods, pool.outlying, strict=True))
        distance = {
            name: abs(x.mean - pool.mean.median) / math.hypot(x.sd, pool.spread.median)
            for name, x in quantity.likelihoods.items()
        }
        population.append(FleetQuantity(quantity.name, quantity.runs, pool, outlying, distance))
    return population


def ranked_units(population: Sequence[FleetQuantity]) -> dict[str, tuple[float, str]]:
    """Rank units by their probability of being an outlier, each in its farthest quantity."""
    worst: dict[str, tuple[float, float, str]] = {}
    for quantity in population:
        for unit, p in quantity.outlying.items():
            entry = (round(p, 6), quantity.distance[unit], quantity.name)
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
