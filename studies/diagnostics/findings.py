"""What does the regression find? SIMULATED joints, from file to finding.

``python studies/diagnostics/findings.py`` asks recordings of :mod:`joints`, right ones and ones of
which the model lacks something, and counts false alarms, what was found, and under which name.
Writes ``findings.json``; ``--recordings N`` and ``--cases A B`` for less, ``--table`` prints.
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor

if __name__ == "__main__":
    for variable in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")

import json
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from joints import BENCHES, recorded

from bayesfric import Model
from bayesfric.base.errors import BadInput

HERE = Path(__file__).resolve().parent
SEED = 38


def one(task: tuple[str, int]) -> dict[str, Any]:
    """Ask one recording."""
    name, number = task
    kinds, bench = BENCHES[name]
    rng = np.random.default_rng([SEED, list(BENCHES).index(name), number])
    found: dict[str, Any] = {"right": list(kinds), "steps": [], "reason": None}
    begun = time.process_time()
    with TemporaryDirectory() as folder:
        _, recordings, _ = recorded(bench, rng, Path(folder))
        try:
            missing = Model(bench.joint, recordings, **bench.tables).explain(seed=number)
        except BadInput as error:  # next to no outputs
            return found | {"reason": str(error)}
    steps = [
        {"kind": f.kind, "shape": f.shape, "severity": f.severity, "rivals": list(f.rivals)}
        | {"z": f.statistic, "share": f.share, "moves": dict(f.moves), "physical": f.physical}
        for f in missing.findings
    ]
    seconds = {"seconds": time.process_time() - begun, "own": missing.cpu_seconds}
    judged = {"largest": missing.largest, "limit": missing.limit, "twins": len(missing.replicates)}
    return found | {"steps": steps, "reason": missing.reason} | judged | seconds


def table(found: dict[str, list[dict[str, Any]]]) -> Iterator[str]:
    """Print one line a bench."""
    yield (
        "| bench | asked | found | right name first | right name in group | wrong name "
        "| and after it | median CPU s |"
    )
    yield "|---|---|---|---|---|---|---|---|"
    for name, rows in found.items():
        asked = [row for row in rows if row["reason"] is None]
        right = set(rows[0]["right"])
        hits = [row["steps"] for row in asked if row["steps"]]
        first = sum(s[0]["kind"] in right for s in hits)
        group = sum(bool(right & {s[0]["kind"], *s[0]["rivals"]}) for s in hits)
        wrong = Counter(s[0]["kind"] for s in hits if not right & {s[0]["kind"], *s[0]["rivals"]})
        also = Counter(s["kind"] for steps in hits for s in steps[1:])
        seconds = np.median([row["own"] for row in asked]) if asked else 0.0
        yield (
            f"| {name} | {len(asked)} | {len(hits)} | {first if right else '–'} "
            f"| {group if right else '–'} | {_counted(wrong)} | {_counted(also)} | {seconds:.1f} |"
        )


def _counted(names: Counter[str]) -> str:
    return ", ".join(f"{name} {k}" for name, k in names.most_common()) or "–"


def main() -> None:
    """Run what is asked for, and keep it case by case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--cases", nargs="*", default=list(BENCHES))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--to", type=Path, default=HERE / "findings.json")
    parser.add_argument("--table", action="store_true")
    told = parser.parse_args()
    result = json.loads(told.to.read_text()) if told.to.exists() else {}
    if not told.table:
        with ProcessPoolExecutor(told.workers) as pool:
            for case in told.cases:
                tasks = [(case, told.first + k) for k in range(told.recordings)]
                result[case] = list(pool.map(one, tasks))
                told.to.write_text(json.dumps(result, indent=1) + "\n")
                print("\n".join(list(table({case: result[case]}))[2:]), flush=True)
        return
    print("\n".join(table({case: result[case] for case in told.cases if case in result})))


if __name__ == "__main__":
    main()
