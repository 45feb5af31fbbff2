"""A made-up fleet of knees, its runs written without fitting: one worn, one failed."""

import copy
import json

import numpy as np
import pandas as pd

from bayesfric.fleet.page import fleet_page
from bayesfric.fleet.plan import units_of
from bayesfric.fleet.results import fleet_population
from bayesfric.report.summary.record import Summary

from .made_summaries import knee

COUNT = 12
WORN = "knee-03"


def write_fleet(folder):
    """Write a fleet's folder with its page, and give the population."""
    rng = np.random.default_rng(5)
    names = [f"knee-{k:02d}" for k in range(COUNT)]
    rows = [[name, f"2026-05-{k + 1:02d}", f"j{k % 4}"] for k, name in enumerate(names)]
    rows.append(["broken", "2026-06-01", "j0"])
    units = units_of(pd.DataFrame(rows, columns=["unit", "day", "joint"]), None, "units.csv")
    errors = {"broken": "logs/<broken>.csv: is empty; record it again"}
    runs = {}
    for k, unit in enumerate(units[:COUNT]):
        run = copy.deepcopy(knee())
        for row in (*run["parameters"].values(), *run["derived"].values()):
            by = row["sd"] * (2.0 * rng.standard_normal() + (30.0 if unit.name == WORN else 0.0))
            for key in ("mean", "median"):
                row[key] += by
            row["interval"] = [end + by for end in row["interval"]]
        place = folder / "units" / unit.name
        place.mkdir(parents=True)
        (place / "summary.json").write_text(json.dumps(run), encoding="utf-8")
        if k == 0:
            (place / "report.html").write_text("its page", encoding="utf-8")
        runs[unit.name] = Summary.read(run)
    population = fleet_population(runs)
    page = fleet_page(folder, units, runs, errors, population)
    (folder / "fleet.html").write_text(page, encoding="utf-8")
    return population
