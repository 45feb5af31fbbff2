"""Time fits by stage in CPU seconds, relative to importing the libraries.

``python studies/benchmark/fits.py [--runs 3] [--fits demo emps]`` fits each configuration in
separate processes, alternating with the imports, and prints medians: until the numbers are known,
until everything is written, of each stage of the progress bar, and the sampler's diagnostics, with
the CPU seconds from its start to 2,000 independent draws of every parameter. The demo is
SIMULATED, the others are MEASURED (../shared/data). Writes ``fits.json``.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from commands import IMPORTS

FOLDER = Path(__file__).resolve().parent
FITS = {
    "demo": None,
    "emps": FOLDER.parent / "emps" / "emps-autoregressive.toml",
    "ur10e": FOLDER.parent / "ur10e" / "ur10e-joint2.toml",
    "xl330": FOLDER.parent / "xl330" / "xl330.toml",
    "pendulum": FOLDER.parent / "dfki-pendulum" / "clean.toml",
}
READING, WRITTEN = "importing, reading", "written"
SAMPLER = ("acceptance", "tau", "min_ess", "warmup", "steps")


def once(name: str, folder: Path) -> None:
    """Fit in this process, as the command does, and print the CPU seconds of each stage."""
    marks = [(READING, 0.0)]

    def now(stage: str) -> None:
        if stage != marks[-1][0]:
            marks.append((stage, time.process_time()))

    from bayesfric.base.progress import Progress
    from bayesfric.commands.fit import demo_config, fit
    from bayesfric.problem.config import read_config

    def callback(progress: Progress) -> None:
        now(progress.phase.partition(":")[0])

    path = FITS[name]
    config = read_config(path) if path else demo_config()
    summary = fit(config, folder / "run", progress=callback, on_summary=lambda _: now("numbers"))
    now(WRITTEN)
    sampler = {key: summary["sampler"][key] for key in SAMPLER}
    stages: dict[str, float] = {}
    for (stage, began), (_, ended) in itertools.pairwise(marks):
        stages[stage] = stages.get(stage, 0.0) + ended - began
    ends = {"numbers": dict(marks)["numbers"], WRITTEN: marks[-1][1]}
    print(json.dumps({"stages": stages, **ends, "sampler": sampler}))


def main() -> None:
    """Run the requested fits, alternating with the imports."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--fits", nargs="*", default=list(FITS))
    parser.add_argument("--once", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.once:
        with tempfile.TemporaryDirectory() as folder:
            once(options.once, Path(folder))
        return
    imports, times = [], {name: [] for name in options.fits}
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    for run in range(options.runs + 1):
        words = f"import time; {IMPORTS}; print(time.process_time())"
        commands = [[sys.executable, "-c", words]]
        commands += [[sys.executable, __file__, "--once", name] for name in options.fits]
        lines = [
            subprocess.run(x, env=environment, stdout=subprocess.PIPE, check=True).stdout
            for x in commands
        ]
        if run:  # the first run compiles
            imports.append(float(lines[0]))
            for name, line in zip(options.fits, lines[1:], strict=True):
                times[name].append(json.loads(line))
    base = median(imports)
    print(f"imports {base:.2f} CPU s")
    result = {}
    for name, runs in times.items():
        stages = {s: median(fit["stages"].get(s, 0.0) for fit in runs) for s in runs[0]["stages"]}
        ends = {end: median(fit[end] for fit in runs) for end in ("numbers", WRITTEN)}
        sampler = runs[-1]["sampler"]  # the same in all
        sampler["to_2000"] = stages["warm-up"] + stages["sampling"] * 2000.0 / sampler["min_ess"]
        sampler["to_2000_over_imports"] = sampler["to_2000"] / base
        sampler["warmup_share"] = stages["warm-up"] / sampler["to_2000"]
        result[name] = {"imports": base, **ends, "sampler": sampler, "stages": stages}
        print(f"{name}: " + ", ".join(f"{k} {v:.1f} = {v / base:.1f} ×" for k, v in ends.items()))
        print("    " + ", ".join(f"{key} {x:.4g}" for key, x in sampler.items()))
        print("".join(f"    {stage:34}{x:6.2f}\n" for stage, x in stages.items()), end="")
    (FOLDER / "fits.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
