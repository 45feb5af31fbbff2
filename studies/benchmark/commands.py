"""How long commands take, beside what importing the libraries takes in the same minute.

``python studies/benchmark/commands.py [--source OLDER-TREE] [--runs 7]`` runs each command so often
as a process of its own, in turn with the imports, on the packaged (SIMULATED) knee, and prints
medians: seconds by the clock until the first line of the answer and until the end, CPU seconds, and
ratios to the imports. ``--source`` is another checkout of this repository to be timed in place of
this one. Writes ``commands.json`` (``commands-before.json`` with ``--source``).
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

HERE = Path(__file__).resolve().parent
IMPORTS = "import numpy, scipy.stats, emcee, arviz, matplotlib"
BAYESFRIC = ["-m", "bayesfric"]
COMMANDS: dict[str, list[str]] = {
    "the libraries' imports": ["-c", IMPORTS],
    "import bayesfric": ["-c", "import bayesfric"],
    "check": [*BAYESFRIC, "check", "knee.toml"],
    "identify": [*BAYESFRIC, "identify", "knee.toml"],
    "estimate": [*BAYESFRIC, "estimate", "knee.toml", "--method", "input-error"],
    "demo": [*BAYESFRIC, "demo", "-o", "RUN"],
    "demo --paper": [*BAYESFRIC, "demo", "--paper", "-o", "RUN"],
}


def timed(words: list[str], source: Path, folder: Path) -> tuple[float, float, float]:
    """Run once; give seconds to the first line, to the end, and of the processors."""
    run = folder / "RUN"
    shutil.rmtree(run, ignore_errors=True)
    before, began = os.times(), time.monotonic()
    with subprocess.Popen(
        [sys.executable, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(source)},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        first = time.monotonic() - began
        process.stdout.read()
    end, after = time.monotonic() - began, os.times()
    if process.returncode not in (0, 3):
        raise SystemExit(f"{words}: {process.returncode}")
    cpu = after.children_user + after.children_system
    return first, end, cpu - before.children_user - before.children_system


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--source", type=Path, help="another checkout to time")
    parser.add_argument("--runs", type=int, default=7)
    given = parser.parse_args()
    source = (given.source or HERE.parents[1]).absolute()
    words = dict(COMMANDS)
    if given.source:
        words.pop("demo --paper")  # it was no option
    took: dict[str, list[tuple[float, float, float]]] = {name: [] for name in words}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file in ("knee.toml", "knee.csv"):
            shutil.copy(source / "bayesfric" / "examples" / file, folder)
        for command in words.values():
            timed(command, source, folder)  # compiles, and fills the disk's cache
        for _ in range(given.runs):
            for command, line in words.items():
                took[command].append(timed(line, source, folder))
    base = median(end for _, end, _ in took["the libraries' imports"])
    told: dict[str, Any] = {
        "machine": f"{os.cpu_count()} cores, Python {platform.python_version()}",
        "runs": given.runs,
        "commands": {
            name: {
                "first_line": median(one[0] for one in runs),
                "seconds": median(one[1] for one in runs),
                "cpu_seconds": median(one[2] for one in runs),
                "first_line_over_imports": median(one[0] for one in runs) / base,
                "over_imports": median(one[1] for one in runs) / base,
            }
            for name, runs in took.items()
        },
    }
    for name, row in told["commands"].items():
        print(f"{name:24}" + "".join(f"{value:9.2f}" for value in row.values()))
    path = HERE / ("commands-before.json" if given.source else "commands.json")
    path.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
