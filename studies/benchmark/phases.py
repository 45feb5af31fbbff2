"""What the demo does from the command to the page, and how long each part takes.

``python studies/benchmark/phases.py [--runs 7]`` runs it so often, each in a process of its own
and prints medians: seconds by the clock, and CPU seconds of the main process. Writes
``phases.json``. On the packaged (SIMULATED) knee.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

HERE = Path(__file__).resolve().parent
# In their order.
PARTS = (
    "imports",
    "reading",
    "estimates",
    "search and warm-up",
    "sampling",
    "what follows from the draws",
    "self-check",
    "what the data leave open",
    "page, figures and draws",
)


def demo(folder: Path) -> None:
    """Run it here, as the command line does, and print when each part ended."""
    ends: dict[str, tuple[float, float]] = {}

    def end(part: str) -> None:
        ends[part] = time.time(), time.process_time()

    from bayesfric.base.progress import Progress
    from bayesfric.commands.fit import demo_config, fit

    end("imports")

    def seen(progress: Progress) -> None:
        word = progress.phase.partition(" ")[0]
        if word == "least-squares":
            end("reading")
        elif word == "searching":
            end("estimates")
        elif word == "warm-up":  # told when it is done
            end("search and warm-up")
        elif word == "sampling":
            end("sampling")
        elif word == "self-check":
            end("what follows from the draws")
        elif word == "identifiability":
            end("self-check")

    fit(
        demo_config(),
        folder,
        progress=seen,
        found=lambda _: end("what the data leave open"),
    )
    end(PARTS[-1])
    print(json.dumps(ends))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--once", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.once:
        demo(given.once)
        return
    took: dict[str, list[tuple[float, float]]] = {part: [] for part in PARTS}
    # as the command line has it
    one = {"OPENBLAS_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as name:
        for k in range(given.runs + 1):
            began = time.time(), 0.0
            command = [sys.executable, __file__, "--once", str(Path(name) / str(k))]
            done = subprocess.run(
                command, env={**os.environ, **one}, stdout=subprocess.PIPE, check=True
            )
            ends = json.loads(done.stdout)
            for part in PARTS:
                now = ends[part]
                if k:  # the first one compiles
                    took[part].append((now[0] - began[0], now[1] - began[1]))
                began = now
    told = {
        part: {"seconds": median(x for x, _ in runs), "cpu_seconds": median(y for _, y in runs)}
        for part, runs in took.items()
    }
    whole = sum(row["seconds"] for row in told.values())
    for part, row in told.items():
        share = 100.0 * row["seconds"] / whole
        print(f"{part:44}{row['seconds']:7.2f}{row['cpu_seconds']:7.2f}{share:6.0f} %")
    (HERE / "phases.json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
