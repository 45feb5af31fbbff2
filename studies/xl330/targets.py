"""Does a servo's gain come out of its targets and a known mass? MEASURED, one gain at a time.

``python studies/xl330/targets.py`` fits the three driven runs of each gain without the recorded
voltage, and compares kp with the slope of the recorded voltage over the control error times the
0.0906 N m/V of the fit from voltage (README). Writes ``targets.json``; ``--gains 100 200`` for
less.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric import Model
from bayesfric.problem.config import parse_config

HERE = Path(__file__).parent
DATA = HERE.parents[2] / "shared" / "data" / "xl330-pendulum"
# Of the fit from voltage; stall torque of the data sheet, 0.52 N m at 5 V, at the runs' 7.3 V.
PER_VOLT, LIMIT = 0.0906, 0.76
MECHANISM = """
[mechanism.elements.gearbox]
load_loss = "one"
[mechanism.elements.motor]
inertia = true
viscous = true
coulomb = "symmetric"
[mechanism.load]
first_moment = true
inertia = true
gravity_angle = true
[priors]
load = { first_moment = 0.0, inertia = 0.0 }  # the known mass is all that moves
[noise]
scale = "shared"
[sampling]
seed = 330
"""


def runs(gain: int) -> list[tuple[Path, dict[str, Any]]]:
    """Return the runs of a gain but the one whose motor is switched off."""
    read = [(path, json.loads(path.read_text())) for path in sorted(DATA.glob("*.json"))]
    return [
        (p, run) for p, run in read if run["kp"] == gain and run["trajectory"] != "lift_and_drop"
    ]


def from_voltage(gain: int) -> float:
    """Return kp by the slope of the recorded voltage over the control error, N m/rad."""
    entries = [entry for _, run in runs(gain) for entry in run["entries"]]
    duty = np.array([(x["load"] + 32768) % 65536 - 32768 for x in entries]) / 885.0
    volts = duty * np.array([x["input_volts"] for x in entries])
    error = np.array([x["goal_position"] - x["position"] for x in entries])
    inside = np.abs(duty) < 0.85
    return float(PER_VOLT * (error[inside] @ volts[inside]) / (error[inside] @ error[inside]))


def fitted(gain: int) -> dict[str, Any]:
    """Fit the runs of a gain from targets and the known mass."""
    text = MECHANISM + "".join(
        f"""
[[recordings]]
file = "{path}"
time = {{ column = "timestamp", unit = "s" }}
position = {{ column = "position", unit = "rad" }}
added_mass = "0.49 kg"
radius = "0.1 m"
[recordings.target]
column = "goal_position"
unit = "rad"
kp = ["{0.0005 * gain:.6g} N m/rad", "{0.006 * gain:.6g} N m/rad"]
limit = "{LIMIT} N m"
held = true
"""
        for path, _ in runs(gain)
    )
    begun = time.process_time()
    summary = Model.from_config(parse_config(text, HERE / "targets.toml")).fit().summary
    kp, voltage = summary.rows["drive.kp"].reported, from_voltage(gain)
    return {
        "kp": kp.value,
        "sd": kp.sd,
        "interval": kp.interval,
        "status": kp.status,
        "posterior": [summary.rows["drive.kp"].middle, summary.rows["drive.kp"].sd],
        "from_voltage": voltage,
        "off": summary.rows["drive.kp"].middle / voltage - 1.0,
        "z": (summary.rows["drive.kp"].middle - voltage) / kp.sd if kp.sd else None,
        "findings": [finding.kind for finding in summary.findings],
        "doubts": [doubt.kind for doubt in summary.doubts],
        "numbers": {
            name: [row.middle, row.reported.sd, row.reported.status]
            for name, row in summary.parameters.items()
        },
        "cpu_seconds": round(time.process_time() - begun, 1),
    }


def main() -> None:
    """Fit the requested gains, save each, and print the README's table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gains", nargs="*", type=int, default=[100, 200, 400, 800])
    parser.add_argument("--to", type=Path, default=HERE / "targets.json")
    options = parser.parse_args()
    if not DATA.is_dir():
        sys.exit(f"{DATA} is not there")
    results = json.loads(options.to.read_text()) if options.to.is_file() else {}
    print("| gain | kp, N m/rad | status | by voltage | off | z | doubts, findings | CPU s |")
    print("|---|---|---|---|---|---|---|---|")
    for gain in options.gains:
        row = results[str(gain)] = fitted(gain)
        options.to.write_text(json.dumps(results, indent=1) + "\n")
        print(
            f"| {gain} | {row['kp']:.4f} ± {row['sd']:.4f} | {row['status']} "
            f"| {row['from_voltage']:.4f} | {row['off']:+.1%} | {row['z']:+.1f} "
            f"| {', '.join(row['doubts'] + row['findings']) or '–'} | {row['cpu_seconds']:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
