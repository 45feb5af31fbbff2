"""Repeat section 4 of the paper on a recording SIMULATED from its Table 3.

``python studies/rabbit_knee/study.py`` estimates by all methods, samples both posteriors,
prints the tables of README.md, writes ``result.json`` and draws
``figures/rabbit_knee``. About five minutes on two cores.
"""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from bayesfric.commands.fit import fit
from bayesfric.estimates import METHODS
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.fit.model import Model
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.joint import PRESETS
from bayesfric.problem.config import Config, read_config
from bayesfric.report.figures.style import save
from figures import cutoff_figure, fit_figure, forest

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
TRUTH = PRESETS["rabbit-knee"].values
# Values of the paper, which has no intervals.
TABLE_1 = {
    "total.inertia": 4.7e-4,
    "total.viscous": 6.5e-3,
    "total.coulomb": 0.203,
    "total.offset": -0.0025,
}
TABLE_2 = {
    "motor.inertia": 3.2e-4,
    "motor.viscous": 2.4e-3,
    "motor.coulomb_positive": 0.106,
    "motor.coulomb_negative": 0.100,
    "gearbox.alpha_drive": 0.75,
    "gearbox.alpha_back": 1.31,
    "load.inertia": 0.24,
    "joint.viscous": 6.9,
    "joint.coulomb_positive": 4.51,
    "joint.coulomb_negative": 4.75,
    "load.first_moment": 0.58,
}
TABLE_3 = {
    **{name: value for name, value in TRUTH.items() if not name.startswith("gearbox")},
    "gearbox.alpha_drive": 0.7432,
    "gearbox.alpha_back": 1.408,
}
# Section 4.4, all at the motor; the efficiencies at Fr/Ts = 0.1, that is Ts = 50.9 N m.
COMPARED = {
    "Jm + Jc/N² (kg m²)": 4.38e-4,
    "fm + fc/N² (N m s)": 5.25e-3,
    "Cm1 + Cc1/N (N m)": 0.188,
    "driving efficiency": 0.692,
    "back-driving efficiency": 0.607,
}
TRANSMITTED = 50.9
CUTOFFS = (15.0, 25.0, 40.0, 60.0, 100.0, 150.0, 250.0, 400.0)


def compared(chain: Any, values: np.ndarray) -> np.ndarray:
    """Compute the combinations of section 4.4 from parameter vectors, ``(5, n)``."""
    columns = {name: values[:, i] for i, name in enumerate(chain.names)}
    n = chain.ratio
    derived = {q.name: q.values for q in derive(chain, values, TRANSMITTED)}
    return np.stack(
        [
            columns["motor.inertia"] + columns["load.inertia"] / n**2,
            columns["motor.viscous"] + columns["joint.viscous"] / n**2,
            columns["motor.coulomb_positive"] + columns["joint.coulomb_positive"] / n,
            derived["gearbox.efficiency_drive"],
            derived["gearbox.efficiency_back"],
        ]
    )


def sampled(config: Config, folder: Path, problem: Model) -> tuple[dict[str, Any], np.ndarray]:
    """Sample a posterior; return its summary and draws of the chain's parameters."""
    if folder.exists():
        shutil.rmtree(folder)
    summary = fit(config, folder)
    draws = xr.load_datatree(folder / "posterior.nc")["posterior"]
    free = [name for name in problem.chain.names if not problem.priors[name].fixed]
    columns = {name: np.asarray(draws[name]).ravel() for name in free}
    size = columns[free[0]].size
    values = np.stack(
        [
            columns.get(name, np.full(size, problem.priors[name].value))
            for name in problem.chain.names
        ],
        axis=1,
    )
    return summary, values


def at_cutoff(config: Config, cutoff: float) -> dict[str, Estimate]:
    """Estimate with another cut-off frequency of the low-pass, in Hz."""
    processing = config.tables.processing.model_copy(update={"lowpass": cutoff})
    tables = config.tables.model_copy(update={"processing": processing})
    problem = Model.from_config(replace(config, tables=tables))
    return {e.method: e for e in problem.estimates(("input-error", "output-error"))}


def main() -> None:
    """Run the study."""
    config = read_config(FOLDER / "knee.toml")
    problem = Model.from_config(config)
    estimates = {e.method: e for e in problem.estimates()}
    runs = ROOT / "studies-runs"
    runs.mkdir(exist_ok=True)
    posteriors = {
        name: sampled(read_config(FOLDER / f"{name}.toml"), runs / name, problem)
        for name in ("knee", "knee-output-error")
    }
    by_cutoff = {cutoff: at_cutoff(config, cutoff) for cutoff in CUTOFFS}

    result = {
        "simulated": True,
        "table_1": _table(TABLE_1, estimates, ("least-squares",), posteriors),
        "table_2": _table(TABLE_2, estimates, ("input-error",), posteriors),
        "table_3": _table(TABLE_3, estimates, ("output-error",), posteriors),
        "section_4_4": _section_4_4(problem, estimates, posteriors),
        "residual_rms": {m: [e.residual_rms, e.residual_unit] for m, e in estimates.items()},
        "cutoff": {
            f"{cutoff:g}": {
                method: {v.name: [v.value, _number(v.sd), _number(v.sd_robust)] for v in e.values}
                for method, e in each.items()
            }
            for cutoff, each in by_cutoff.items()
        },
        "notes": {m: list(e.notes) for m, e in estimates.items()},
    }
    (FOLDER / "result.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    target = ROOT / "figures" / "rabbit_knee"
    target.mkdir(parents=True, exist_ok=True)
    save(fit_figure(problem, estimates["output-error"]), target, "fig6")
    save(cutoff_figure(by_cutoff, TRUTH), target, "cutoff")
    save(forest({name: summary for name, (summary, _) in posteriors.items()}), target, "methods")
    print(markdown(result))


def _table(
    printed: dict[str, float],
    estimates: dict[str, Estimate],
    methods: tuple[str, ...],
    posteriors: dict[str, Any],
) -> dict[str, Any]:
    rows: dict[str, Any] = {}
    for name, value in printed.items():
        rows[name] = {"printed": value, "truth": TABLE_3.get(name)}
        for method in methods:
            if name in estimates[method]:
                estimate = estimates[method][name]
                rows[name][method] = [
                    estimate.value,
                    _number(estimate.sd),
                    _number(estimate.sd_robust),
                ]
        for run, (summary, _) in posteriors.items():
            row = (summary["parameters"] | summary["derived"]).get(name)
            if row:
                rows[name][run] = [row["median"], *row["interval"], row["verdict"]]
    return rows


def _section_4_4(
    problem: Model, estimates: dict[str, Estimate], posteriors: dict[str, Any]
) -> dict[str, Any]:
    chain = problem.chain
    columns: dict[str, Any] = {
        "truth": compared(chain, chain.vector(TRUTH)[None])[:, 0].tolist(),
    }
    for method in METHODS[1:]:
        point = chain.vector(dict(estimates[method].point))
        columns[method] = compared(chain, point[None])[:, 0].tolist()
    for run, (_, values) in posteriors.items():
        draws = compared(chain, values)
        # a negative back-driving efficiency means that the gearbox is irreversible
        low, middle, high = np.nanquantile(draws, [0.05, 0.5, 0.95], axis=1)
        undefined = np.isnan(draws).mean(axis=1)
        columns[run] = np.stack([middle, low, high], axis=1).tolist()
        for cell, share in zip(columns[run], undefined, strict=True):
            if share > 0.005:
                cell.append(f"irreversible in {100 * share:.0f} % of the draws")
    return {
        label: {"printed": printed} | {key: column[i] for key, column in columns.items()}
        for i, (label, printed) in enumerate(COMPARED.items())
    }


def markdown(result: dict[str, Any]) -> str:
    """Format the result as the tables of README.md."""
    lines = []
    for number, method in ((1, "least-squares"), (2, "input-error"), (3, "output-error")):
        lines += [
            f"\n**Table {number}**, {method}\n",
            f"| | printed | simulated from | {method} ± sd (sd, correlated) | "
            "posterior, input error | posterior, output error |",
            "|---|---|---|---|---|---|",
        ]
        for name, row in result[f"table_{number}"].items():
            truth = f"{row['truth']:.4g}" if row["truth"] is not None else "–"
            lines.append(
                f"| `{name}` | {row['printed']:.4g} | {truth} | {_pm(row.get(method))} | "
                f"{_interval(row.get('knee'))} | {_interval(row.get('knee-output-error'))} |"
            )
    lines += [
        "\n**Section 4.4**\n",
        "| | printed | simulated from | input error | output error | posterior, input error | "
        "posterior, output error |",
        "|---|---|---|---|---|---|---|",
    ]
    for label, row in result["section_4_4"].items():
        lines.append(
            f"| {label} | {row['printed']:.4g} | {row['truth']:.4g} | {row['input-error']:.4g} | "
            f"{row['output-error']:.4g} | {_interval(row['knee'])} | "
            f"{_interval(row['knee-output-error'])} |"
        )
    return "\n".join(lines)


def _pm(cell: list[Any] | None) -> str:
    if cell is None:
        return "known"
    value, sd, robust = cell
    if sd is None:
        return f"{value:.4g} (on a bound or not determined)"
    return f"{value:.4g} ± {sd:.2g} ({robust:.2g})" if robust else f"{value:.4g} ± {sd:.2g}"


def _interval(cell: list[Any] | None) -> str:
    if cell is None:
        return "known"
    middle, low, high = cell[:3]
    remark = f" ({cell[3]})" if len(cell) > 3 and cell[3] != "data" else ""
    return f"{middle:.4g} [{low:.4g}, {high:.4g}]{remark}"


def _number(x: float) -> float | None:
    return x if math.isfinite(x) else None


if __name__ == "__main__":
    main()
