"""Count findings on SIMULATED joints with right and with incomplete models.

``python studies/diagnostics/findings.py`` tests recordings of :mod:`joints` and counts false
alarms, detections, and the name of each. Writes ``findings.json``; ``--recordings N`` and
``--cases A B`` for less, ``--table`` prints.
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

FOLDER = Path(__file__).resolve().parent
SEED = 38


def run_case(task: tuple[str, int]) -> dict[str, Any]:
    """Test one recording."""
    name, number = task
    kinds, bench = BENCHES[name]
    rng = np.random.default_rng([SEED, list(BENCHES).index(name), number])
    outcome: dict[str, Any] = {"right": list(kinds), "steps": [], "reason": None}
    start = time.process_time()
    with TemporaryDirectory() as folder:
        _, recordings, _ = recorded(bench, rng, Path(folder))
        try:
            missing = Model(bench.joint, recordings, **bench.tables).explain(seed=number)
        except BadInput as error:  # too few outputs
            return outcome | {"reason": str(error)}
    steps = [
        {
            "kind": finding.kind,
            "shape": finding.shape,
            "severity": finding.severity,
            "rivals": list(finding.rivals),
        }
        | {
            "z": finding.statistic,
            "share": finding.share,
            "moves": dict(finding.moves),
            "physical": finding.physical,
        }
        for finding in missing.findings
    ]
    seconds = {"seconds": time.process_time() - start, "own": missing.cpu_seconds}
    statistics = {
        "largest": missing.largest,
        "limit": missing.limit,
        "twins": len(missing.replicates),
    }
    return outcome | {"steps": steps, "reason": missing.reason} | statistics | seconds


def table(outcomes: dict[str, list[dict[str, Any]]]) -> Iterator[str]:
    """Yield one line per bench."""
    yield (
        "| bench | tested | detected | right name first | right name in group | wrong name "
        "| further findings | median CPU s |"
    )
    yield "|---|---|---|---|---|---|---|---|"
    for name, rows in outcomes.items():
        tested = [row for row in rows if row["reason"] is None]
        right = set(rows[0]["right"])
        detected = [row["steps"] for row in tested if row["steps"]]
        first = sum(s[0]["kind"] in right for s in detected)
        group = sum(bool(right & {s[0]["kind"], *s[0]["rivals"]}) for s in detected)
        wrong = Counter(
            s[0]["kind"] for s in detected if not right & {s[0]["kind"], *s[0]["rivals"]}
        )
        further = Counter(s["kind"] for steps in detected for s in steps[1:])
        seconds = np.median([row["own"] for row in tested]) if tested else 0.0
        yield (
            f"| {name} | {len(tested)} | {len(detected)} | {first if right else '–'} "
            f"| {group if right else '–'} | {_counted(wrong)} | {_counted(further)} "
            f"| {seconds:.1f} |"
        )


def _counted(names: Counter[str]) -> str:
    return ", ".join(f"{name} {k}" for name, k in names.most_common()) or "–"


def main() -> None:
    """Run the requested cases and save each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--cases", nargs="*", default=list(BENCHES))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--to", type=Path, default=FOLDER / "findings.json")
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    result = json.loads(options.to.read_text()) if options.to.exists() else {}
    if not options.table:
        with ProcessPoolExecutor(options.workers) as pool:
            for case in options.cases:
                tasks = [(case, options.first + k) for k in range(options.recordings)]
                result[case] = list(pool.map(run_case, tasks))
                options.to.write_text(json.dumps(result, indent=1) + "\n")
                print("\n".join(list(table({case: result[case]}))[2:]), flush=True)
        return
    print("\n".join(table({case: result[case] for case in options.cases if case in result})))


if __name__ == "__main__":
    main()
