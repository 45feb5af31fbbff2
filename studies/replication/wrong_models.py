"""Do intervals hold when the model is wrong? SIMULATED joints with a term that the model lacks.

``python studies/replication/wrong_models.py`` records each of thirteen joints (one lacks nothing)
in forty different motions, fits every recording by itself with a model that does not have the term,
and counts how often intervals hold the values that fit all forty motions together best. Writes
``wrong_models.json``; ``--recordings N`` and ``--kinds A B`` for less.
"""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor

if __name__ == "__main__":
    for variable in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
for folder in ("calibration", "diagnostics"):
    sys.path.insert(0, str(HERE.parent / folder))

from bench import Bench, Drive, recorded, told
from random_joints import BASE, LOSSY, TERMS, Missing, joint

from bayesfric import Model, Recording

SEED = 2031
# What the model lacks: a term, and whether both joint and model lose by load besides.
KINDS: dict[str, tuple[Missing | None, bool]] = {
    "nothing": (None, False),
    **{term.name: (term, False) for term in TERMS},
    **{t.name: (t, True) for t in LOSSY if t.name == "load loss growing with load"},
}


def recordings(kind: str, number: int, folder: Path) -> list[Recording]:
    """Make the file of one motion of a kind's joint, always the same joint."""
    term, lossy = KINDS[kind]
    true = joint((term,) if term else (), lossy=lossy)
    ranges = BASE | {"motor.load": (0.05, 0.15)} | (term.values if term else {})
    values = {name: float(np.mean(ranges[name])) for name in true.names}
    key = (list(KINDS).index(kind), number)
    rng = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=key))
    drive = Drive(
        amplitude=float(rng.uniform(1.2, 3.5)),
        square=float(rng.uniform(0.0, 0.6)),
        hertz=float(rng.uniform(0.2, 1.0)),
    )
    bench = Bench(true, values, (drive,), duration=12.0, spread=0.0)
    recorded(bench, rng, folder)
    # by names that differ, so that all can be fitted together
    path = Path(folder, "recording-0.csv").rename(folder / f"motion-{number}.csv")
    return [told(bench, drive, path)]


def one(task: tuple[str, int]) -> dict[str, Any]:
    """Fit one recording with a model that lacks the term."""
    kind, number = task
    with TemporaryDirectory() as folder:
        made = recordings(kind, number, Path(folder))
        model = Model(joint((), lossy=KINDS[kind][1]), made, self_check={"recordings": 0})
        summary = model.fit(seed=1).summary
    rows = {
        name: {
            "plain": row.interval,
            "told": row.told_interval,
            "sds": [row.sd, row.told_sd],
        }
        for name, row in summary.joint.items()
        if row.verdict != "prior"
    }
    error = summary.model_error
    return {
        "number": number,
        "shown": error is not None and error.shown,
        "doubts": [doubt.kind for doubt in summary.doubts],
        "rows": rows,
    }


def best(task: tuple[str, int]) -> dict[str, float]:
    """Fit all motions of a kind together: what the model does best over its whole range."""
    kind, count = task
    with TemporaryDirectory() as folder:
        made: list[Recording] = []
        for number in range(count):
            made += recordings(kind, number, Path(folder))
        frame = Model(joint((), lossy=KINDS[kind][1]), made).estimate("input-error")
    return {str(name): float(value) for name, value in frame["value"].items()}


def judged(found: list[dict[str, Any]], values: dict[str, float]) -> dict[str, Any]:
    """Count how often intervals hold the best values, and how much wider they are."""
    told = [(one, name, row) for one in found for name, row in one["rows"].items()]

    def share(which: str) -> tuple[float, float]:
        each = [
            np.mean([row[which][0] <= values[n] <= row[which][1] for n, row in one["rows"].items()])
            for one in found
            if one["rows"]
        ]
        return float(np.mean(each)), float(np.std(each) / np.sqrt(len(each)))

    return {
        "recordings": len(found),
        "shown": float(np.mean([one["shown"] for one in found])),
        "intervals": len(told),
        "plain": share("plain"),
        "told": share("told"),
        "wider": float(np.mean([row["sds"][1] / row["sds"][0] for _, _, row in told])),
        "best": values,
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--recordings", type=int, default=40)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--to", type=Path, default=HERE / "wrong_models.json")
    options = parser.parse_args()
    result = json.loads(options.to.read_text("utf-8")) if options.to.exists() else {}
    with ProcessPoolExecutor(options.workers) as pool:
        for kind in options.kinds:
            values = pool.submit(best, (kind, options.recordings))
            found = list(pool.map(one, [(kind, k) for k in range(options.recordings)]))
            result[kind] = row = judged(found, values.result())
            options.to.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
            print(
                f"| {kind} | {row['shown']:.0%} | {row['plain'][0]:.0%} ± {row['plain'][1]:.0%} | "
                f"{row['told'][0]:.0%} ± {row['told'][1]:.0%} | {row['wider']:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
