"""Fit each recording of the pendulum, and the parts of five without contact, with defaults.

``python studies/dfki-pendulum/study.py`` writes ``result.json`` and prints the table of the README.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

from bayesfric.fit.model import Model
from bayesfric.problem.config import parse_config

FOLDER = Path(__file__).resolve().parent
RECORDINGS = ("ddp", "dircol", "ilqr", "es500", "sac", "es1kg")
NUMBERS = ("motor.inertia", "motor.viscous", "motor.coulomb", "gearbox.load", "load.first_moment")
# CAD, kg m: the authors' with 0.5 kg, and 0.5 kg more at 0.5 m
CAD = {"es1kg": 0.304 + 0.5 * 0.5}
CONFIGURATION = """\
[mechanism]
preset = "servo-pendulum"

[[recordings]]
file = "../../../shared/data/dfki-pendulum/{name}.csv"
time = {{ column = "time", unit = "s" }}
position = {{ column = "position", unit = "rad" }}
torque = {{ column = "torque", unit = "N m" }}
"""


def configuration(name: str) -> str:
    """Return a recording's configuration: columns and units only."""
    return CONFIGURATION.format(name=name)


def fitted(text: str) -> dict:
    """Fit a configuration of this folder; return ``summary.json``."""
    config = parse_config(text, FOLDER / "study.toml")
    return Model.from_config(config).fit().summary.as_dict()


def key_numbers(summary: dict) -> dict:
    """Select the numbers of a summary that the README quotes."""
    return {
        "status": summary["sampler"]["status"],
        "explained": summary["fit"]["explained"],
        "noise": summary["noise"]["model"],
        "doubts": [doubt["kind"] for doubt in summary["doubts"]],
        "bands": {name: row["band"] for name, row in summary["fit"]["recordings"].items()},
        "parameters": {
            name: {
                key: summary["parameters"][name][key] for key in ("median", "interval", "verdict")
            }
            for name in NUMBERS
        },
    }


def main() -> None:
    """Fit all recordings and print the table."""
    result = {}
    cases = {name: configuration(name) for name in RECORDINGS}
    cases["clean"] = (FOLDER / "clean.toml").read_text("utf-8")
    for name, text in cases.items():
        began = time.process_time()
        outcome = key_numbers(fitted(text))
        result[name] = outcome
        row = outcome["parameters"]["load.first_moment"]
        low, high = row["interval"]
        print(
            f"| {name} | {outcome['status']} | {100 * outcome['explained']:.0f} % | "
            f"{row['median']:.3f} [{low:.3f}, {high:.3f}] {row['verdict']} | "
            f"{row['median'] / CAD.get(name, 0.304):.2f} | {', '.join(outcome['doubts']) or '-'} | "
            f"{time.process_time() - began:.0f} |",
            flush=True,
        )
    (FOLDER / "result.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
