"""Check numbers with status ``identified`` from faulty input, SIMULATED recordings.

``python studies/identified/identified.py`` fits recordings of :mod:`faulty`, 40 of each kind, from
the file with default settings, and counts identified numbers that are more than three of their
printed standard deviations from the truth, and reports whose first sentence names the cause.
Writes ``identified.json``; ``--kinds A B``, ``--recordings N`` for less; ``--table`` prints the
saved result. ``--right`` fits the ten right models of ``whole_path.py`` instead and writes
``right.json``; ``--before FILE`` counts how many identified numbers of that file still are.
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
import re
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy import stats

FOLDER = Path(__file__).resolve().parent
for folder in ("calibration", "diagnostics"):
    sys.path.insert(0, str(FOLDER.parent / folder))

import bench
from faulty import KINDS, recording
from joints import RIGHT

from bayesfric import Model
from bayesfric.base.errors import BadInput
from bayesfric.mechanism.derived import derive
from bayesfric.report.summary.record import Summary
from bayesfric.report.terminal import fit_text
from bayesfric.report.words import words_of

SEED = 61
# Error in printed standard deviations beyond which a number is wrong.
OFF = 3.0


def fit_faulty(task: tuple[str, int]) -> dict[str, Any]:
    """Fit one recording of a kind of fault."""
    kind, number = task
    faulty = recording(kind, SEED, number)
    with TemporaryDirectory() as folder:
        row = fitted(lambda: faulty.model(Path(folder)), faulty.truth, number)
    row |= {"fault": faulty.fault, "size": faulty.size}
    if "answer" in row:
        causes = KINDS[kind].causes
        row["first_names_cause"] = names(row["answer"][0], causes)
        row["names_cause"] = names(" ".join(row["answer"]), causes)
    return row


def fit_right(task: tuple[str, int]) -> dict[str, Any]:
    """Fit one recording of a bench whose model is right."""
    case, number = task
    joint = bench.CASES[case].joint
    rng = np.random.default_rng([SEED, *case.encode(), number])
    with TemporaryDirectory() as folder:
        truth, recordings, _ = bench.recorded(bench.CASES[case], rng, Path(folder))
        vector = np.array([[truth[name] for name in joint.names]])
        derived = {q.name: float(q.values[0]) for q in derive(joint, vector, 1.0)}
        # efficiencies are excluded: they refer to a load that differs between fits
        truth |= {name: x for name, x in derived.items() if "efficiency" not in name}
        tables = bench.CASES[case].tables
        return fitted(lambda: Model(joint, recordings, **tables), truth, number)


def fitted(model: Any, truth: dict[str, float], number: int) -> dict[str, Any]:
    """Fit the model that ``model()`` reads, and compare each number with its true value."""
    start = time.process_time()
    try:
        summary = model().fit(seed=number).summary
    except BadInput as error:
        return {"number": number, "refused": str(error)}
    rows = {}
    for name, true in truth.items():
        row = summary.rows.get(name)
        if row is None:
            continue
        reported = row.reported
        rows[name] = {
            "truth": true,
            "status": reported.status,
            "value": reported.value,
            "sd": reported.sd,
            "interval": reported.interval,
            "bound": reported.bound,
            "z": (reported.value - true) / reported.sd if reported.sd else None,
            "posterior": [row.middle, *row.interval, row.sd],
            "ess": row.ess,
        }
    return {
        "number": number,
        "status": summary.sampler.status,
        "outcome": summary.verdict.outcome,
        "answer": answer(summary),
        "doubts": [getattr(doubt, "what", doubt.kind) for doubt in summary.doubts],
        "findings": [finding.kind for finding in summary.findings],
        "taken": [finding.kind for finding in summary.taken],
        "cpu_seconds": round(time.process_time() - start, 2),
        "numbers": rows,
    }


def answer(summary: Summary) -> list[str]:
    """Return the sentences that the terminal prints, without its table."""
    head, *others = "\n".join(fit_text(summary)).split("\n\n")
    # the first line describes the recording
    first = head.partition("\n")[2]
    messages = [
        text
        for block in others
        for text in re.split(r"\n(?!  )", re.sub(r"\n  and \d+ more findings.*", "", block))
        if re.match(r"(!|Added|Next|Unidentified|Not converged)", text)
    ]
    # join wrapped lines
    return [" ".join(text.split()) for text in (first, *messages)]


def names(text: str, causes: frozenset[str]) -> bool:
    """Whether a text contains the message of one of these kinds."""
    for kind in causes:
        # kinds without a message have only their name
        parts = [part.strip() for part in re.split(r"\{[^}]*\}", words_of(kind)["what"])]
        longest = max(parts, key=len)
        if longest and longest.lower() in text.lower():
            return True
    return False


def judged(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Summarise the rows of one kind or case."""
    fits = [row for row in rows if "numbers" in row]
    numbers = [number for fit in fits for number in fit["numbers"].values()]
    identified = [number for number in numbers if number["status"] == "identified"]
    off = sum(_off(number) for number in identified)
    seconds = [fit["cpu_seconds"] for fit in fits]
    return {
        "recordings": len(rows),
        "refused": len(rows) - len(fits),
        "numbers": len(numbers),
        "identified": len(identified),
        "identified_off": off,
        # the upper end of a 95 % interval (Clopper and Pearson), numbers taken as independent
        "identified_off_at_most": float(stats.beta.ppf(0.95, off + 1, len(identified) - off))
        if off < len(identified)
        else 1.0,
        "fits_with_identified_off": sum(
            any(n["status"] == "identified" and _off(n) for n in fit["numbers"].values())
            for fit in fits
        ),
        "first_names_cause": sum(fit.get("first_names_cause", False) for fit in fits),
        "names_cause": sum(fit.get("names_cause", False) for fit in fits),
        "doubtful": sum(fit["outcome"] == "doubtful" for fit in fits),
        "cpu_seconds": [float(np.median(seconds)), max(seconds)] if seconds else [],
    }


def _off(number: dict[str, Any]) -> bool:
    return number["z"] is not None and abs(number["z"]) > OFF


def still_identified(before: list[dict[str, Any]], after: list[dict[str, Any]]) -> tuple[int, int]:
    """Count numbers identified in rows ``before``, and those of them still so ``after``."""
    now = {row["number"]: row.get("numbers", {}) for row in after}
    identified = [
        (row["number"], name)
        for row in before
        if row["number"] in now
        for name, number in row.get("numbers", {}).items()
        if number["status"] == "identified"
    ]
    still = sum(
        now[number].get(name, {}).get("status") == "identified" for number, name in identified
    )
    return still, len(identified)


HEAD = (
    "|  | recordings | refused | numbers | identified | of these, off | cause in first sentence "
    "| cause named at all | doubtful | median CPU s |\n|---|---|---|---|---|---|---|---|---|---|"
)


def line(name: str, rows: list[dict[str, Any]]) -> str:
    """Return a row of the README's table."""
    sums = judged(rows)
    seconds = f"{sums['cpu_seconds'][0]:.1f}" if sums["cpu_seconds"] else "–"
    share = _share(sums["identified_off"], sums["identified"])
    return (
        f"| {name} | {sums['recordings']} | {sums['refused']} | {sums['numbers']} "
        f"| {_share(sums['identified'], sums['numbers'])} | {share} "
        f"| {sums['first_names_cause']} | {sums['names_cause']} | {sums['doubtful']} | {seconds} |"
    )


def _share(part: int, total: int) -> str:
    return f"{part} of {total} ({part / total:.0%})" if total else "–"


def main() -> None:
    """Fit the requested kinds, and save each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=40)
    parser.add_argument("--kinds", nargs="*", help="of faults, or with --right of benches")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--right", action="store_true", help="right models instead of faults")
    parser.add_argument("--before", type=Path, help="result to compare with")
    parser.add_argument("--to", type=Path)
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    path = options.to or FOLDER / ("right.json" if options.right else "identified.json")
    fit = fit_right if options.right else fit_faulty
    kinds = options.kinds or list(RIGHT if options.right else KINDS)
    if unknown := set(kinds) - set(RIGHT if options.right else KINDS):
        parser.error(f"there is no kind {', '.join(sorted(unknown))}")
    result = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    print(HEAD, flush=True)
    with ProcessPoolExecutor(options.workers) as pool:
        for kind in kinds:
            if not options.table:
                tasks = [(kind, number) for number in range(options.recordings)]
                result[kind] = list(pool.map(fit, tasks))
                path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
            print(line(kind, result[kind]), flush=True)
    print(line("all", [row for kind in kinds for row in result[kind]]))
    if options.before:
        before = json.loads(options.before.read_text(encoding="utf-8"))
        counts = [still_identified(before[kind], result[kind]) for kind in kinds if kind in before]
        still, identified = (sum(x) for x in zip(*counts, strict=True))
        print(f"identified before and now: {_share(still, identified)}")


if __name__ == "__main__":
    main()
