"""Runs whose numbers stay what they are while the code is written anew.

``python -m tests.golden.golden`` runs every configuration below from the command line and writes
``golden.json``: of each number its median, sd, interval and status, and the kinds of findings.
``python -m tests.golden.golden NAME ...`` does so for some. Presets and the arm are SIMULATED, the
others measured (``../shared/data``).
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.arm import bench
from tests.arm.test_arm import TRUTH

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
STUDIES = ROOT / "studies"
DATA = ROOT.parent / "shared" / "data"
GOLDEN = HERE / "golden.json"
KEYS = ("median", "sd", "interval", "reported")
# of one preset a recording that is simulated from it, by the same command as a user's
PRESETS = ("rabbit-knee", "motor-axis", "servo-pendulum")
SIMULATED = {"scaling": "scaling/alone.toml", "known mass": "scaling/known-mass.toml"}
MEASURED = {
    "EMPS": "emps/emps-white.toml",
    "UR10e": "ur10e/ur10e-joint2.toml",
    "XL330": "xl330/xl330.toml",
    "pendulum": "dfki-pendulum/clean.toml",
    "EMPS, pulses": "emps/emps-pulses.toml",
}


def bayesfric(*words: str | Path, cwd: Path) -> str:
    """Run a command; a fit that did not converge is a result, too."""
    command = [sys.executable, "-m", "bayesfric", *map(str, words)]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True)
    if done.returncode not in (0, 3):
        raise RuntimeError(f"{words}: {done.stderr}")
    return done.stdout


def run_of(directory: Path) -> dict[str, Any]:
    """Read what a run directory says of its numbers."""
    summary = json.loads((directory / "summary.json").read_text())
    rows = {**summary["parameters"], **summary["derived"]}
    return {
        "sampler": summary["sampler"]["status"],
        "findings": sorted(finding["kind"] for finding in summary["findings"]),
        "numbers": {
            name: {key: row[key] for key in KEYS if row.get(key) is not None}
            for name, row in rows.items()
            if row.get("median") is not None
        },
    }


def fitted(config: Path, folder: Path) -> dict[str, Any]:
    """Fit one configuration."""
    bayesfric("fit", config, "-o", folder / "run", cwd=folder)
    return run_of(folder / "run")


def preset(name: str, folder: Path) -> dict[str, Any]:
    """Simulate a preset's recording, and fit it."""
    bayesfric("init", name, "-o", "joint.toml", cwd=folder)
    bayesfric("simulate", "joint.toml", "-o", "recording.csv", cwd=folder)
    return fitted(folder / "joint.toml", folder)


def output_error(folder: Path) -> dict[str, Any]:
    """Fit the motor axis by its simulated position."""
    bayesfric("init", "motor-axis", "-o", "joint.toml", cwd=folder)
    bayesfric("simulate", "joint.toml", "-o", "recording.csv", cwd=folder)
    with (folder / "joint.toml").open("a") as config:
        config.write('\n[likelihood]\nmethod = "output-error"\n')
    return fitted(folder / "joint.toml", folder)


def pooled(folder: Path) -> dict[str, Any]:
    """Pool both recordings of EMPS."""
    (folder / "pool.toml").write_text((HERE / "pool.toml").read_text().replace("DATA/", f"{DATA}/"))
    told = json.loads(bayesfric("pool", "pool.toml", "--json", cwd=folder))
    shared = {row["name"]: row["value"] for row in told["shared"]}
    for row in told["varying"]:
        name, jointly = row["name"], row["jointly"]
        shared |= {f"{name}, mean": jointly["mean"], f"{name}, spread": jointly["spread"]}
        shared |= {f"{name}, {k}": value for k, value in enumerate(jointly["runs"])}
    return {
        "sampler": told["status"],
        "findings": sorted(finding["kind"] for finding in told["findings"]),
        "numbers": {
            name: {
                "median": value["median"],
                "sd": (value["high"] - value["low"]) / 3.29,  # of a normal that is so wide
                "interval": [value["low"], value["high"]],
            }
            for name, value in shared.items()
        },
    }


def arm(folder: Path) -> dict[str, Any]:
    """Fit the tests' arm of two joints, whose bodies are a tenth off."""
    (folder / "arm.urdf").write_text(bench.urdf())
    bench.log(bench.urdf(bench.FACTORS), TRUTH).to_csv(folder / "log.csv", index=False)
    bayesfric("arm", "arm.urdf", "log.csv", "-o", "arm", "--seed", "1", cwd=folder)
    joints = {name: run_of(folder / "arm" / name) for name in TRUTH}
    return {
        "sampler": ", ".join(joint["sampler"] for joint in joints.values()),
        "findings": sorted(kind for joint in joints.values() for kind in joint["findings"]),
        "numbers": {
            f"{name}, {key}": row
            for name, joint in joints.items()
            for key, row in joint["numbers"].items()
        },
    }


def _runs() -> dict[str, Callable[[Path], dict[str, Any]]]:
    runs: dict[str, Callable[[Path], dict[str, Any]]] = {}
    for name in PRESETS:
        runs[name] = lambda folder, name=name: preset(name, folder)
    for name, path in {**SIMULATED, **MEASURED}.items():
        runs[name] = lambda folder, path=path: fitted(STUDIES / path, folder)
    return {**runs, "output error": output_error, "pool": pooled, "arm": arm}


RUNS = _runs()
NEED_DATA = (*MEASURED, "pool")


def main() -> None:
    """Write what the runs give today."""
    golden = json.loads(GOLDEN.read_text()) if GOLDEN.exists() else {}
    for name in sys.argv[1:] or RUNS:
        with TemporaryDirectory() as folder:
            golden[name] = RUNS[name](Path(folder))
        print(name, flush=True)
        runs = [f"{json.dumps(name)}: {json.dumps(run)}" for name, run in golden.items()]
        GOLDEN.write_text("{\n" + ",\n".join(runs) + "\n}\n")


if __name__ == "__main__":
    main()
