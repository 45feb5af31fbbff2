"""Every recording of the pendulum by itself, and the parts of five without a hand: all defaults.

``python studies/dfki-pendulum/study.py`` writes ``result.json`` and prints the table of the README.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

from bayesfric.fit.model import Model
from bayesfric.problem.config import parse_config

HERE = Path(__file__).resolve().parent
RECORDINGS = ("ddp", "dircol", "ilqr", "es500", "sac", "es1kg")
NUMBERS = ("motor.inertia", "motor.viscous", "motor.coulomb", "gearbox.load", "load.first_moment")
# CAD, kg m: the authors' with 0.5 kg, and half a kilogram more at 0.5 m
CAD = {"es1kg": 0.304 + 0.5 * 0.5}
ONE = """\
[mechanism]
preset = "servo-pendulum"

[[recordings]]
file = "../../../shared/data/dfki-pendulum/{name}.csv"
time = {{ column = "time", unit = "s" }}
position = {{ column = "position", unit = "rad" }}
torque = {{ column = "torque", unit = "N m" }}
"""


def configuration(name: str) -> str:
    """Give a recording's configuration: columns and units, nothing else."""
    return ONE.format(name=name)


def fitted(text: str) -> dict:
    """Fit a configuration that lies in this folder; gives ``summary.json`` without its page."""
    config = parse_config(text, HERE / "study.toml")
    return Model.from_config(config).fit().summary.as_dict()


def told(summary: dict) -> dict:
    """Keep of a summary what the README tells."""
    return {
        "status": summary["sampler"]["status"],
        "explained": summary["fit"]["explained"],
        "noise": summary["noise"]["model"],
        "doubts": [one["kind"] for one in summary["doubts"]],
        "bands": {name: row["band"] for name, row in summary["fit"]["recordings"].items()},
        "parameters": {
            name: {
                key: summary["parameters"][name][key] for key in ("median", "interval", "verdict")
            }
            for name in NUMBERS
        },
    }


def main() -> None:
    """Fit everything."""
    result = {}
    cases = {name: configuration(name) for name in RECORDINGS}
    cases["clean"] = (HERE / "clean.toml").read_text("utf-8")
    for name, text in cases.items():
        began = time.process_time()
        found = told(fitted(text))
        result[name] = found
        row = found["parameters"]["load.first_moment"]
        low, high = row["interval"]
        print(
            f"| {name} | {found['status']} | {100 * found['explained']:.0f} % | "
            f"{row['median']:.3f} [{low:.3f}, {high:.3f}] {row['verdict']} | "
            f"{row['median'] / CAD.get(name, 0.304):.2f} | {', '.join(found['doubts']) or '-'} | "
            f"{time.process_time() - began:.0f} |",
            flush=True,
        )
    (HERE / "result.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
