"""Simulate MEASURED runs of the XL330 in closed loop from a posterior of other runs.

``python studies/xl330/rollout.py`` fits the runs of three position gains and simulates the fourth
by its targets, for every gain and two models. Then it fits all sixteen runs
by targets in place of voltage. Writes ``rollout.json``. Minutes on one core.
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from time import process_time
from typing import Any

from held_out import GAINS

import bayesfric as bf
from bayesfric.base.atomic_write import jsonable
from bayesfric.problem.config import document_text, parse_config

PATH = Path(__file__).with_name("xl330-rollout.toml")
# Terms that `bayesfric explain` names first on these runs.
MODELS: dict[str, dict[str, Any]] = {
    "the preset": {},
    "with cogging 6 times a turn and the square of the load": {
        "motor": {"cogging": [6]},
        "gearbox": {"load_square": True},
    },
}


def model(held_out: tuple[str, ...], elements: dict[str, Any], effort: str = "voltage") -> bf.Model:
    """Build the model of all runs but some; ``effort`` is the source of the torque."""
    document = tomllib.loads(PATH.read_text(encoding="utf-8"))
    if elements:
        document["mechanism"]["elements"] = elements
    document["validation"] = {"recordings": [f"2026-01-15_{name}" for name in held_out]}
    if effort == "target":
        for recording in document["recordings"]:
            del recording["voltage"]
    return bf.Model.from_config(parse_config(document_text(document), PATH))


def played(gain: int, elements: dict[str, Any]) -> dict[str, Any]:
    """Simulate the runs of a gain from the posterior of the others."""
    start = process_time()
    sampled = model(GAINS[gain], elements).sample()
    fitted = process_time()
    rolled = jsonable(bf.rollout(sampled).summary)
    return rolled | {"fit_seconds": fitted - start, "rollout_seconds": process_time() - fitted}


def fitted(effort: str) -> dict[str, Any]:
    """Fit all runs by voltage or targets; return medians and intervals."""
    summary = bf.summary(model((), {}, effort).sample())
    rows = {
        name: {
            "median": row.median,
            "interval": [row.reported.low, row.reported.high],
            "sd": row.reported.sd,
        }
        for name, row in summary.parameters.items()
    }
    return {"parameters": rows, "residual_rms": summary.fit.residual_rms}


def main() -> None:
    """Print a row for each gain and model, and the fits by either source of torque."""
    result: dict[str, Any] = {"rollouts": {}, "fits": {}}
    print("| model | gain played | MAE (mrad) | RMSE (mrad) | inside 90 % | parameters alone |")
    print("|---|---|---|---|---|---|")
    for name, elements in MODELS.items():
        for gain in GAINS:
            rolled = result["rollouts"].setdefault(name, {})[str(gain)] = played(gain, elements)
            e = rolled["pooled"]["position"]
            print(
                f"| {name} | {gain} | {1e3 * e['mae']:.1f} | {1e3 * e['rmse']:.1f} | "
                f"{100 * e['inside']:.0f} % | {100 * e['inside_alone']:.0f} % |",
                flush=True,
            )
    print("\n| quantity | by voltage | by targets |\n|---|---|---|")
    for effort in ("voltage", "target"):
        result["fits"][effort] = fitted(effort)
    a, b = (result["fits"][effort]["parameters"] for effort in ("voltage", "target"))
    for name, row in a.items():
        cells = [
            f"{x['median']:.4g} [{x['interval'][0]:.4g}, {x['interval'][1]:.4g}]"
            for x in (row, b[name])
        ]
        print(f"| {name} | {' | '.join(cells)} |")
    path = PATH.with_name("rollout.json")
    path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
