"""``fleet.html``: the page of a fleet, one file that fetches nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayesfric.fleet.fleet_figures import fleet_figures, shown
from bayesfric.fleet.fleet_population import OUTLIER, FleetPopulation, sure
from bayesfric.fleet.fleet_units import Unit
from bayesfric.fleet.results import COLUMNS, FAILED, Record
from bayesfric.report.figures.style import save
from bayesfric.report.page.page_figures import PageFigure, page_figure
from bayesfric.report.page.rendering import render
from bayesfric.version import __version__

# Columns of the units that there is room for.
_MOST = 6


@dataclass(frozen=True)
class Line:
    """A unit's line in the table."""

    unit: Unit
    record: Record
    link: str  # its page, or its folder
    probability: float | None  # of being an outlier
    where: str  # the quantity


def draw(folder: Path, found: FleetPopulation) -> list[PageFigure]:
    """Write the figures into ``figures/``, and give them for the page."""
    (folder / "figures").mkdir(exist_ok=True)
    made = []
    for figure, stem, title, caption, words in fleet_figures(found):
        save(figure, folder / "figures", stem)
        made.append(page_figure(folder, stem, title, caption, f"{title}. {words}"))
    return made


def fleet_page(
    folder: Path,
    units: Sequence[Unit],
    records: Mapping[str, Record],
    found: FleetPopulation,
    figures: Sequence[PageFigure],
) -> str:
    """Write the page; units' folders are beside it in ``units/``."""
    lines = list(_lines(folder, units, records, found))
    columns = [name for name in units[0].values if name not in COLUMNS][:_MOST]
    rows = {
        unit: {row["quantity"]: row for row in record["rows"]} for unit, record in records.items()
    }
    told: dict[str, Any] = {
        "title": folder.name,
        "found": found,
        "lines": lines,
        "columns": columns,
        "rows": rows,
        "quantities": shown(found),
        "failed": [one for one in lines if one.record["status"] == FAILED],
        "outliers": [one for one in lines if (one.probability or 0.0) >= OUTLIER],
        "figures": figures,
        "sure": sure,
        "version": __version__,
    }
    return render("fleet.html.j2", **told)


def _lines(
    folder: Path, units: Sequence[Unit], records: Mapping[str, Record], found: FleetPopulation
) -> Iterator[Line]:
    """Order units: outliers first, then as ranked, those without a rank last."""
    ranked = {unit: (p, name) for unit, p, name in found.outliers}
    place = {unit: k for k, unit in enumerate(ranked)}
    for unit in sorted(units, key=lambda one: place.get(one.name, len(place))):
        run = Path("units", unit.name)
        page = run / "report.html"
        p, where = ranked.get(unit.name, (None, ""))
        link = page if (folder / page).is_file() else run
        yield Line(unit, records[unit.name], link.as_posix(), p, where)
