"""Time commands, relative to importing the libraries.

``python studies/benchmark/commands.py [--source OLDER-TREE] [--runs 7]`` runs each command in a
separate process, alternating with the imports, on the packaged (SIMULATED) knee, and prints
medians: seconds and CPU seconds until the first line, which is that of the table, and until the
end, and the ratios of CPU seconds to the imports: a busy machine changes them least. A first run
has nothing compiled. ``--source`` is another checkout to time. Writes ``commands.json``
(``commands-before.json`` with ``--source``), under the version of Python.
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

FOLDER = Path(__file__).resolve().parent
IMPORTS = "import numpy, scipy, emcee, arviz, matplotlib.pyplot"
FIRST = "demo, first run"
BAYESFRIC = ["-m", "bayesfric"]
COMMANDS: dict[str, list[str]] = {
    "the libraries' imports": ["-c", IMPORTS],
    "import bayesfric": ["-c", "import bayesfric"],
    "check": [*BAYESFRIC, "check", "knee.toml"],
    "identify": [*BAYESFRIC, "identify", "knee.toml"],
    "estimate": [*BAYESFRIC, "estimate", "knee.toml", "--method", "input-error"],
    "demo": [*BAYESFRIC, "demo", "-o", "RUN"],
    FIRST: [*BAYESFRIC, "demo", "-o", "RUN"],
    "demo --paper": [*BAYESFRIC, "demo", "--paper", "-o", "RUN"],
}


def cpu_seconds(process: int) -> float:
    """Return the CPU seconds of a running process so far, on Linux."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


def timed(
    words: list[str], source: Path, folder: Path, **environment: str
) -> tuple[float, float, float, float]:
    """Run once; return seconds to the first line and the end, then CPU seconds, end first."""
    run = folder / "RUN"
    shutil.rmtree(run, ignore_errors=True)
    before, began = os.times(), time.monotonic()
    with subprocess.Popen(
        [sys.executable, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(source), **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        first, first_cpu = time.monotonic() - began, cpu_seconds(process.pid)
        process.stdout.read()
    end, after = time.monotonic() - began, os.times()
    if process.returncode not in (0, 3):
        raise SystemExit(f"{words}: {process.returncode}")
    cpu = after.children_user + after.children_system
    return first, end, cpu - before.children_user - before.children_system, first_cpu


def main() -> None:
    """Time all commands and print medians."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--source", type=Path, help="another checkout to time")
    parser.add_argument("--runs", type=int, default=7)
    options = parser.parse_args()
    source = (options.source or FOLDER.parents[1]).absolute()
    words = dict(COMMANDS)
    if options.source:
        words.pop("demo --paper")  # older versions lack the option
    times: dict[str, list[tuple[float, ...]]] = {name: [] for name in words}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file in ("knee.toml", "knee.csv"):
            shutil.copy(source / "bayesfric" / "examples" / file, folder)
        for command in words.values():
            timed(command, source, folder)  # compiles, and fills the disk cache
        for _ in range(options.runs):
            for command, line in words.items():
                cache = folder / "numba"
                shutil.rmtree(cache, ignore_errors=True)
                environment = {"NUMBA_CACHE_DIR": str(cache)} if command == FIRST else {}
                times[command].append(timed(line, source, folder, **environment))
    base = median(run[2] for run in times["the libraries' imports"])
    result: dict[str, Any] = {
        "machine": f"{os.cpu_count()} cores, {platform.machine()}",
        "runs": options.runs,
        "commands": {
            name: {
                "first_line": median(run[0] for run in runs),
                "seconds": median(run[1] for run in runs),
                "first_line_cpu": median(run[3] for run in runs),
                "cpu_seconds": median(run[2] for run in runs),
                "first_line_over_imports": median(run[3] for run in runs) / base,
                "over_imports": median(run[2] for run in runs) / base,
            }
            for name, runs in times.items()
        },
    }
    for name, row in result["commands"].items():
        print(f"{name:24}" + "".join(f"{value:9.2f}" for value in row.values()))
    path = FOLDER / ("commands-before.json" if options.source else "commands.json")
    versions = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    versions["Python " + ".".join(platform.python_version_tuple()[:2])] = result
    path.write_text(json.dumps(versions, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
