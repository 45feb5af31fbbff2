"""Fit a SIMULATED fleet with a population, ten worn units and five broken files.

``python studies/fleet/fleet.py FOLDER`` simulates it there, times a shell loop over ``bayesfric
fit``, the fleet with 1, 2 and 4 workers, one that is killed and resumed, and then the complete
fleet, records the workers' memory, and compares worn units, broken files and population with the
truth. Writes ``axis.json`` or ``knee.json``.

``--kind knee`` simulates Rabbit knees (six seconds of a core each), ``axis`` plain motor axes (one
second). Times include other load of the machine.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from bayesfric.commands.simulate import simulate
from bayesfric.fleet.fleet import Fleet
from bayesfric.fleet.results import fleet_population
from bayesfric.problem.config import parse_config
from bayesfric.report.summary.record import Summary, read_summary_file

FOLDER = Path(__file__).resolve().parent
SEED = 21
WORN = 10
# Mean and spread of varying parameters; the first one of a worn unit is WEAR times as large.
POPULATION = {
    "axis": {"motor.viscous": (0.05, 0.004), "motor.coulomb": (0.2, 0.012)},
    "knee": {"motor.viscous": (1.6e-4, 1.0e-5), "motor.inertia": (3.32e-4, 7e-6)},
}
WEAR = (1.5, 2.2)
RECORDING = """
[[recordings]]
file = "{file}"
time = { column = "time", unit = "s" }
position = { column = "position", unit = "rad", side = "motor" }
torque = { column = "torque", unit = "N m" }
"""
MECHANISM = {
    "axis": '[mechanism]\npreset = "motor-axis"\n',
    "knee": '[mechanism]\npreset = "rabbit-knee"\n',
}
SIMULATION = {
    "axis": 'duration = 10.0\nrate = 200\nexcitation = "multisine"\nencoder_counts = 1048576\n',
    "knee": 'duration = 10.0\nrate = 1000\nexcitation = "square"\namplitude = 0.8\n',
}
BROKEN = {
    "one-row": "time,position,torque\n0.0,0.0,0.0\n",
    "no-torque": "time,position\n" + "".join(f"{0.01 * k:g},0.1\n" for k in range(200)),
    "empty": "",
    "words": "time,position,torque\n" + "".join(f"{0.01 * k:g},stuck,0\n" for k in range(200)),
    "missing": None,
}


def make(folder: Path, kind: str, count: int) -> dict[str, Any]:
    """Write recordings, template, units and plan; return the true values."""
    rng = np.random.default_rng(SEED)
    (folder / "logs").mkdir(parents=True)
    population = POPULATION[kind]
    names = [f"{kind}-{k:04d}" for k in range(count - len(BROKEN))]
    worn = set(rng.choice(names, min(WORN, len(names) // 4), replace=False).tolist())
    first = next(iter(population))
    rows, truth = ["unit,file,hours"], {}
    for k, name in enumerate(names):
        values = {n: float(m + s * rng.standard_normal()) for n, (m, s) in population.items()}
        wear = float(rng.uniform(*WEAR))
        if name in worn:
            values[first] *= wear
        truth[name] = values
        parameters = "".join(f'"{n}" = {x!r}\n' for n, x in values.items())
        text = (
            f"{MECHANISM[kind]}[simulation]\n{SIMULATION[kind]}seed = {SEED + k}\n"
            f"[simulation.parameters]\n{parameters}"
        )
        simulate(parse_config(text, folder / "made.toml"), folder / "logs" / f"{name}.csv")
        rows.append(f"{name},logs/{name}.csv,{rng.integers(0, 5000)}")
    for name, content in BROKEN.items():
        if content is not None:
            (folder / "logs" / f"{name}.csv").write_text(content, encoding="utf-8")
        rows.append(f"{name},logs/{name}.csv,0")
    (folder / "units.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    (folder / "unit.toml").write_text(f"{MECHANISM[kind]}{RECORDING}", encoding="utf-8")
    plan = 'template = "unit.toml"\n\n[units]\ntable = "units.csv"\n'
    (folder / "fleet.toml").write_text(plan, encoding="utf-8")
    return {"values": truth, "worn": sorted(worn)}


def part(folder: Path, count: int) -> Path:
    """Write a plan of the first units."""
    lines = (folder / "units.csv").read_text(encoding="utf-8").splitlines()[: count + 1]
    (folder / f"first-{count}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    text = (folder / "fleet.toml").read_text(encoding="utf-8")
    path = folder / f"first-{count}.toml"
    path.write_text(text.replace("units.csv", f"first-{count}.csv"), encoding="utf-8")
    return path


@contextmanager
def watched() -> Iterator[list[tuple[float, float, float]]]:
    """Record time (s) and memory (MB) of client and largest worker, twice a second."""
    samples: list[tuple[float, float, float]] = []
    stop, began = threading.Event(), time.monotonic()

    def look() -> None:
        while not stop.wait(0.5):
            try:
                (client,) = psutil.Process().children()
                rss = [worker.memory_info().rss / 1e6 for worker in client.children()]
                client_mb = client.memory_info().rss / 1e6
            except (psutil.Error, ValueError):
                continue
            samples.append((time.monotonic() - began, client_mb, max(rss, default=0.0)))

    thread = threading.Thread(target=look)
    thread.start()
    try:
        yield samples
    finally:
        stop.set()
        thread.join()


def command(folder: Path, *words: str) -> dict[str, Any]:
    """Run ``bayesfric``; return wall and CPU seconds, and its output."""
    before, began = os.times(), time.monotonic()
    completed = subprocess.run(
        [sys.executable, "-m", "bayesfric", *words],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    wall, after = time.monotonic() - began, os.times()
    cpu = after.children_user + after.children_system
    cpu -= before.children_user + before.children_system
    if completed.returncode not in (0, 3):
        raise SystemExit(completed.stderr)
    return {"seconds": wall, "cpu_seconds": cpu, "found": json.loads(completed.stdout)}


def loop(folder: Path, count: int) -> dict[str, float]:
    """Fit the first units one after the other, each by a command; return mean times."""
    times = []
    for line in (folder / "units.csv").read_text(encoding="utf-8").splitlines()[1 : count + 1]:
        name, file, _ = line.split(",")
        text = (folder / "unit.toml").read_text(encoding="utf-8").replace("{file}", file)
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
        completed = command(folder, "fit", f"{name}.toml", "-o", f"loop-{name}", "--json")
        times.append((completed["seconds"], completed["cpu_seconds"]))
    wall, cpu = np.array(times[1:]).mean(axis=0)  # the first run may compile
    return {"units": count - 1, "seconds": float(wall), "cpu_seconds": float(cpu)}


def killed(folder: Path, plan: Path) -> dict[str, int]:
    """Kill a fleet and its workers when half of its units are fitted, and resume it.

    Counts the units that were fitted then, that resuming fitted again, and that it lost or changed.
    """
    units = folder / "killed" / "units"
    words = ["fleet", plan.name, "-o", "killed", "--workers", "2", "--json"]
    process = subprocess.Popen(
        [sys.executable, "-m", "bayesfric", *words],
        cwd=folder, stdout=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    count = len(Fleet.from_config(plan).plan.units)
    while len(list(units.glob("*/unit.toml"))) < count // 2:
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    finished = {mark.parent: mark.stat().st_mtime_ns for mark in units.glob("*/unit.toml")}
    resumed = command(folder, *words, "--resume")["found"]
    same = [run for run, at in finished.items() if (run / "unit.toml").stat().st_mtime_ns == at]
    return {
        "units": count,
        "finished": len(finished),
        "again": len(finished) - len(same),
        "fitted": len(list(units.glob("*/posterior.nc"))),
        "failed": len(resumed["failed"]),
    }


def covered(folder: Path, kind: str, parts: int = 20) -> dict[str, Any]:
    """Split the fleet into parts, and count the 90 % intervals that hold mean and spread."""
    plan = Fleet.from_config(folder / "fleet.toml").plan
    counts: dict[str, Any] = {}
    for k in range(parts):
        runs = folder / "all" / "units"
        names = [unit.name for unit in plan.units[k::parts] if unit.name not in BROKEN]
        summaries = {name: Summary.read(read_summary_file(runs / name)) for name in names}
        for quantity in fleet_population(summaries):
            if quantity.name not in POPULATION[kind]:
                continue
            held = counts.setdefault(quantity.name, {"fleets": 0, "mean": 0, "spread": 0})
            held["fleets"] += 1
            for key, true in zip(("mean", "spread"), POPULATION[kind][quantity.name], strict=True):
                interval = getattr(quantity.pool, key)
                held[key] += interval.low <= true <= interval.high
    return counts


def main() -> None:
    """Simulate and fit the fleet, and write the result."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--kind", choices=list(POPULATION), default="knee")
    parser.add_argument("--units", type=int, default=1000)
    parser.add_argument("--timed", type=int, default=24, help="units of the timed runs")
    parser.add_argument("--loop", type=int, default=6, help="units of the shell loop")
    parser.add_argument("--workers", type=int, nargs="*", default=[1, 2, 4])
    options = parser.parse_args()
    folder = options.folder.absolute()
    truth = make(folder, options.kind, options.units)
    result: dict[str, Any] = {
        "kind": options.kind,
        "units": options.units,
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, load {os.getloadavg()[0]:.1f}",
        "loop": loop(folder, options.loop),
        "timed": {},
    }
    print(json.dumps(result["loop"]), flush=True)
    plan = part(folder, options.timed)
    for workers in options.workers:
        words = ["--workers", str(workers), "-o", f"timed-{workers}", "--json"]
        completed = command(folder, "fleet", plan.name, *words)
        result["timed"][workers] = {k: completed[k] for k in ("seconds", "cpu_seconds")}
        print(workers, result["timed"][workers], flush=True)
    result["killed"] = killed(folder, plan)
    print(result["killed"], flush=True)
    with watched() as memory:
        completed = command(folder, "fleet", "fleet.toml", "-o", "all", "--workers", "2", "--json")
    fleet_summary = completed["found"]
    sizes = [
        sum(item.stat().st_size for item in run.iterdir())
        for run in (folder / "all/units").iterdir()
    ]
    names = [item["name"] for item in fleet_summary["quantities"]]
    ranked = [item["unit"] for item in fleet_summary["outliers"]]
    quarter = max(len(memory) // 4, 1)
    result |= {
        "seconds": completed["seconds"],
        "cpu_seconds": completed["cpu_seconds"],
        "outcomes": fleet_summary["outcomes"],
        "failed": fleet_summary["failed"],
        "outliers": fleet_summary["outliers"],
        "worn": truth["worn"],
        "worn_in_first_20": sum(name in truth["worn"] for name in ranked[:20]),
        "median_bytes": float(np.median(sizes)),
        "worker_mb": [
            max(m[2] for m in memory[k * quarter :][:quarter] or memory) for k in range(4)
        ],
        "client_mb": [
            max(m[1] for m in memory[k * quarter :][:quarter] or memory) for k in range(4)
        ],
        "population": {
            item["name"]: {
                "true": POPULATION[options.kind].get(item["name"]),
                **{key: item[key] for key in ("mean", "spread", "units")},
            }
            for item in fleet_summary["quantities"]
        },
        "covered": covered(folder, options.kind),
    }
    print(len(names), "quantities", {k: result[k] for k in ("seconds", "worn_in_first_20")})
    (FOLDER / f"{options.kind}.json").write_text(
        json.dumps(result, indent=1) + "\n", encoding="utf-8"
    )


if __name__ == "__main__":
    main()
