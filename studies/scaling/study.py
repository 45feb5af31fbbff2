"""Study the scaling that changes no torque, on SIMULATED recordings.

``python studies/scaling/study.py`` samples every configuration of this folder, compares the
standard deviations predicted before sampling with those sampled, samples every experiment
that ``identify --advise`` ranks, writes ``result.json`` and draws ``figures/scaling``.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
from experiments import experiments

from bayesfric.fit.model import Model
from bayesfric.inference.fitting import Fit, fit
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.joint import PRESETS
from bayesfric.mechanism.scaling import scalings
from bayesfric.problem.config import read_config
from bayesfric.report.figures.posterior import ridge, ridge_figure
from bayesfric.report.figures.style import save
from bayesfric.report.summary.summary import summarise
from figures import interval_figure, lifted_figure

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
# In the order of the table.
CASES = {
    "alone": "one recording, default priors",
    "flat": "one recording, flat wide priors",
    "datasheet-inertia": "rotor inertia from a data sheet, 2 %",
    "common-mu": "one mu for both (wrong model here)",
    "datasheet-mu": "mu_1 from a data sheet, 10 %",
    "cad-moment": "first moment ml from CAD, 2.5 %",
    "known-mass": "second recording with 2 kg at 0.35 m",
}
SHOWN = ("gearbox.alpha_drive", "gearbox.alpha_back", "load.first_moment", "load.inertia")
PREDICTED = ("known-mass", "cad-moment", "common-mu")
TRUTH = dict(PRESETS["rabbit-knee"].values)


def truths(chain: Any) -> dict[str, float]:
    """Return true parameters and derived quantities."""
    values = chain.vector({n: TRUTH[n] for n in chain.names})
    return {**TRUTH, **{q.name: float(q.values[0]) for q in derive(chain, values[None], 1.0)}}


def sampled(path: Path) -> tuple[Fit, dict[str, Any]]:
    """Sample a configuration as ``bayesfric fit`` does, without its point estimates."""
    problem = Model.from_config(read_config(path))
    estimates = problem.estimates(("least-squares", "input-error"))
    target = problem.target(dict(estimates[-1].point))
    result = fit(target, problem.config.tables.sampling, estimates=estimates)
    return result, summarise(result).as_dict()


def places(result: Fit) -> tuple[np.ndarray, float]:
    """Return each draw's position of the scale between its bounds, and the share outside.

    Positions are 0 at alpha_2 = 1 and 1 at alpha_1 = 1, the bounds by dissipativity.
    """
    scaling = scalings(result.chain)[0]
    draws = result.chain_draws()
    bounds = np.array([scaling.bounds(v) for v in draws])
    low, high = np.log(np.maximum(bounds, 1e-12)).T
    return -low / (high - low), float(np.mean((low > 0.0) | (high < 0.0)))


def row_of(summary: dict[str, Any], name: str) -> dict[str, Any] | None:
    """Return one quantity of a summary; ``None`` if the model lacks it."""
    quantity = summary["parameters"].get(name) or summary["derived"].get(name)
    if quantity is None:
        return None
    return {key: quantity.get(key) for key in ("median", "sd", "interval", "verdict")}


def predicted(path: Path, summary: dict[str, Any]) -> dict[str, Any]:
    """Compare standard deviations predicted by ``identify`` with the sampled ones."""
    identification = Model.from_config(path).identification()
    rows = {}
    for parameter in identification.parameters:
        sampled_row = summary["parameters"][parameter.name]
        rows[parameter.name] = {
            "predicted": parameter.expected_sd,
            "sampled": sampled_row["sd"],
            "ratio": parameter.expected_sd / sampled_row["sd"],
            "verdict": sampled_row["verdict"],
            "on_bound": parameter.on_bound,
        }
    return {"null_directions": sum(d.null for d in identification.directions), "parameters": rows}


def main() -> None:
    """Run the study, and write its result and figures."""
    figures = ROOT / "figures" / "scaling"
    figures.mkdir(parents=True, exist_ok=True)
    result: dict[str, Any] = {"simulated": True, "cases": {}, "predicted": {}}
    rows_by_case: dict[str, dict[str, Any]] = {}
    scale: dict[str, np.ndarray] = {}
    for case, knowledge in CASES.items():
        path = FOLDER / f"{case}.toml"
        fitted, summary = sampled(path)
        rows = {name: row_of(summary, name) for name in SHOWN}
        result["cases"][case] = {
            "what": knowledge,
            "status": summary["sampler"]["status"],
            "null_directions": len(summary["identifiability"]["null_directions"]),
            "rows": rows,
        }
        rows_by_case[case] = rows
        print(case, summary["sampler"]["status"], {n: r and r["verdict"] for n, r in rows.items()})
        if scalings(fitted.chain):
            scale[case], outside = places(fitted)
            quantiles = np.quantile(scale[case], [0.0, 0.05, 0.5, 0.95, 1.0])
            result["cases"][case]["place_of_scale"] = {
                "quantiles_0_5_50_95_100": quantiles.tolist(),
                "outside": outside,
            }
        if case == "alone":
            along = ridge(fitted)
            figure = ridge_figure(fitted)
            assert along is not None
            assert figure is not None
            torques = fitted.target.likelihood.predict(along[2][[0, 50, 100]])
            changes = [float(np.abs(torque - torque[1]).max()) for torque in torques]
            result["torque_along_the_ridge_changes_by"] = max(changes)
            save(figure, figures, "ridge")
        if case == "known-mass":
            figure = ridge_figure(fitted)
            assert figure is not None
            save(figure, figures, "ridge-known-mass")
        if case in PREDICTED:
            result["predicted"][case] = predicted(path, summary)
    truth = truths(PRESETS["rabbit-knee"].chain())
    save(
        interval_figure({c: scale[c] for c in ("flat", "cad-moment", "known-mass")}),
        figures,
        "interval",
    )
    save(lifted_figure(CASES, rows_by_case, truth, SHOWN[:3]), figures, "lifted")
    saved = FOLDER / "result.json"
    if "--no-advice" in sys.argv and saved.exists():
        result["advice"] = json.loads(saved.read_text(encoding="utf-8")).get("advice")
    if "--no-advice" not in sys.argv:
        runs = ROOT / "studies-runs" / "advice"
        shutil.rmtree(runs, ignore_errors=True)
        runs.mkdir(parents=True)
        result["advice"] = experiments(FOLDER / "alone.toml", "gearbox.alpha_drive", runs)
    (FOLDER / "result.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
