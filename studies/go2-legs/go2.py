"""Twelve joints of a quadruped from targets and encoders. MEASURED, ``../shared/data/go2-legs``.

``python studies/go2-legs/go2.py`` fits each half of the recording, simulates the second half from
its targets by the fit of the first, and compares halves and legs; ``--parts first`` or ``second``
for one half. Writes ``go2.json``; ``--table`` prints what is saved.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from bayesfric.arm.arm import Arm
from bayesfric.arm.arm_rollout import rollout

HERE = Path(__file__).parent
DATA = HERE.parents[2] / "shared" / "data" / "go2-legs"
LEGS, KINDS = ("FL", "FR", "RL", "RR"), ("hip", "thigh", "calf")
NAMES = [f"{leg}_{kind}_joint" for leg in LEGS for kind in KINDS]
# Rms error in mrad of the second half (shared/motion-only.md): MuJoCo with the robot's own file,
# and with least squares on the first half's torque by the targets.
FILE = (16, 16, 18, 13, 17, 21, 17, 18, 27, 15, 13, 19)
DELAY, FRICTION = "target.delay", ("motor.coulomb", "motor.viscous")
LEAST_SQUARES = (4.7, 4.4, 9.4, 4.9, 2.0, 6.7, 3.6, 2.6, 23.6, 5.3, 4.2, 9.9)


def halves(folder: Path) -> dict[str, Path]:
    """Write the first and the second half of the recording."""
    header, *rows = (DATA / "chirp.csv").read_text(encoding="utf-8").splitlines()
    parts = {"first": rows[: len(rows) // 2], "second": rows[len(rows) // 2 :]}
    for name, part in parts.items():
        (folder / f"{name}.csv").write_text("\n".join([header, *part, ""]), encoding="utf-8")
    return {name: folder / f"{name}.csv" for name in parts}


def fitted(half: str, joints: list[str] = NAMES, *, rolled: bool = False) -> dict[str, Any]:
    """Fit joints on one half, and simulate the other from its targets."""
    options = (HERE / "arm.toml").read_text(encoding="utf-8")
    options += "".join(f"[joints.{name}]\nfit = false\n" for name in NAMES if name not in joints)
    with TemporaryDirectory() as folder:
        files, begun = halves(Path(folder)), time.process_time()
        config = Path(folder) / "arm.toml"
        config.write_text(options, encoding="utf-8")
        other = next(file for name, file in files.items() if name != half)
        arm = Arm(DATA / "go2.urdf", config).fit(
            files[half], predict=other if rolled else None, seed=1
        )
        record = arm.as_json()
        out = {"cpu_seconds": round(time.process_time() - begun, 1), "timing": record["timing"]}
        out["joints"] = {
            name: {key: joint[key] for key in ("findings", "parameters")}
            for name, joint in record["joints"].items()
            if name in joints
        }
        if rolled:
            played = rollout(arm, seconds=np.inf, draws=20, seed=1)
            out["rms_mrad"] = {name: 1e3 * x for name, x in played.rms.items()}
            out["held"] = played.coverage
            out["cpu_seconds_rolled"] = round(time.process_time() - begun, 1)
    return out


def cell(row: dict[str, Any], scale: float = 1.0) -> str:
    """Write a number with its sd, or a bound."""
    if row["value"] is None:
        return "–" if row["bound"] is None else f"< {scale * row['bound']:.3g}"
    return f"{scale * row['value']:.3g} ± {scale * row['sd']:.2g}"


def table(results: dict[str, dict[str, Any]]) -> str:
    """Return the README's tables."""
    lines = list[str]()
    for half, result in results.items():
        joints, timing = result["joints"], result["timing"]
        (delay, sd), (instants, _) = timing["delay"], timing["instants"]
        lines += [
            f"Fitted on the {half} half: targets {1e3 * delay:.2f} ± {1e3 * sd:.2f} ms late, "
            f"instants uncertain by {1e3 * instants:.2f} ms; {result['cpu_seconds']:.0f} CPU s.",
            "",
            "| joint | delay alone, ms | armature, 1e-4 kg m² | Coulomb, N m | viscous, N m s/rad "
            "| rms error of the other half, mrad | by the robot's file | least squares "
            "| bands hold |",
            "|---|---|---|---|---|---|---|---|---|",
        ]
        for name, by_file, squares in zip(NAMES, FILE, LEAST_SQUARES, strict=True):
            rows, (alone, alone_sd) = joints[name]["parameters"], timing["joints"][name][DELAY]
            numbers = (cell(rows["motor.inertia"], 1e4), *(cell(rows[key]) for key in FRICTION))
            rolled = "– | – | – | –"
            if "held" in result:
                rolled = f"{result['rms_mrad'][name]:.1f} | {by_file} | {squares} "
                rolled += f"| {result['held'][name]:.0%}"
            lines.append(
                f"| {name.removesuffix('_joint')} | {1e3 * alone:.1f} ± {1e3 * alone_sd:.1f} "
                f"| {' | '.join(numbers)} | {rolled} |"
            )
        if "held" in result:
            columns = (list(result["rms_mrad"].values()), FILE, LEAST_SQUARES)
            means = " | ".join(f"{np.mean(x):.1f}" for x in columns)
            held = np.mean(list(result["held"].values()))
            lines.append(f"| mean | | | | | {means} | {held:.0%} |")
    return "\n".join(lines)


def main() -> None:
    """Fit the requested halves, save, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parts", nargs="*", default=["first", "second"])
    parser.add_argument("--to", type=Path, default=HERE / "go2.json")
    parser.add_argument("--table", action="store_true", help="print what is saved")
    options = parser.parse_args()
    if not DATA.is_dir():
        sys.exit(f"{DATA} is not there")
    for half in [] if options.table else options.parts:
        result = fitted(half, rolled=half == "first")
        results = json.loads(options.to.read_text()) if options.to.is_file() else {}
        options.to.write_text(json.dumps({**results, half: result}, indent=1) + "\n")
    print(table(json.loads(options.to.read_text())))


if __name__ == "__main__":
    main()
