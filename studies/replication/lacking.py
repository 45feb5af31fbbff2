"""Do intervals hold where the model lacks a term? SIMULATED joints of the diagnostics' benches.

``python studies/replication/lacking.py`` fits recordings of :mod:`joints`, each with one thing that
the model does not have and is not given, in three sizes and two motions (a torque that is
commanded, and a path that a position loop follows), and counts how often intervals hold the true
values of what model and joint share. Each joint is recorded once more in a motion like the first
(the same amplitude and lines, other phases), for the law that friction is a number of. Writes
``lacking.json``; ``--recordings N`` of each, ``--effects A B`` for less; ``--table`` prints what
is there.
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

from joints import BENCHES, RIGHT, SIZES, UNLISTED, recorded

from bayesfric import Model

SEED = 41
NINETY = 1.645  # half of the 90 % interval of a standard normal
MOTIONS = ("", "closed loop, ")
CORRECT = (*RIGHT[:6], "arm", "closed loop")
NOT_LISTED = tuple(motion + name for name in UNLISTED for motion in MOTIONS)
EFFECTS: dict[str, tuple[str, ...]] = {
    **{name: (name,) for name in CORRECT},
    **{
        f"{motion}{name}": tuple(motion + case for case in cases)
        for name, cases in SIZES.items()
        for motion in MOTIONS
    },
}


def true_values(truth: dict[str, float], names: list[str]) -> dict[str, float]:
    """Give what the model's own parameters are of the joint that moved."""
    values = {name: truth[name] for name in names if name in truth}
    if "load.inertia" not in names and "motor.inertia" in values:
        values["motor.inertia"] += truth.get("load.inertia", 0.0)
    if "motor.viscous_positive" in truth:
        both = [truth[f"motor.viscous_{way}"] for way in ("positive", "negative")]
        values["motor.viscous"] = float(np.mean(both))
    return values


class SameTruth(np.random.Generator):
    """Draws a joint's parameters, the first draw, as in the other motion, and the rest its own."""

    def __init__(self, name: str, number: int, *again: int) -> None:
        stream = [SEED, *name.encode(), number, *again]
        super().__init__(np.random.PCG64(np.random.SeedSequence(stream)))
        joint = name.removeprefix(MOTIONS[1]).encode()
        self._parameters = [np.random.default_rng([SEED, *joint, number])]

    def uniform(self, *args: Any, **kwargs: Any) -> Any:
        """Draw from the joint's stream once."""
        if self._parameters:
            return self._parameters.pop().uniform(*args, **kwargs)
        return super().uniform(*args, **kwargs)


def fit_one(task: tuple[str, int]) -> dict[str, Any]:
    """Fit one recording as its model is written."""
    name, number = task
    _, bench = BENCHES[name]
    with TemporaryDirectory() as folder:
        truth, recordings, _ = recorded(bench, SameTruth(name, number), Path(folder))
        summary = Model(bench.joint, recordings, **bench.tables).fit(seed=number).summary
        _, alike, _ = recorded(bench, SameTruth(name, number, 1), Path(folder))
        estimates = Model(bench.joint, alike, **bench.tables).estimate("input-error")
    constants = {p.name for p in bench.joint.parameters if p.row.measurand == "constant"}
    rows = []
    for key, true in true_values(truth, list(summary.joint)).items():
        row = summary.joint[key]
        reported = row.reported
        if reported is None or reported.status == "unidentified":
            continue
        low, high = reported.interval
        rows.append(
            {
                "name": key,
                "class": "constants" if key in constants else "friction",
                "status": reported.status,
                "true": true,
                "posterior": [row.middle, row.sd, *row.interval],
                "reported": [reported.value, reported.sd, low, high],
                # of the motion like the first: the estimate, and its sd with correlated residuals
                "alike": [float(x) for x in estimates.loc[key, ["value", "sd_robust"]]],
            }
        )
    findings = [finding.kind for finding in summary.findings]
    return {"outcome": summary.verdict.outcome, "findings": findings, "rows": rows}


def holds(row: dict[str, Any], which: str) -> bool:
    """Whether an interval holds the true value."""
    _, _, low, high = row[which]
    return bool(low <= row["true"] <= high)


def within(row: dict[str, Any], value: float, sd: float) -> bool:
    """Whether an interval holds another motion's estimate: their distances add as variances."""
    middle, _, low, high = row["reported"]
    end = high - middle if value > middle else middle - low
    return bool(abs(value - middle) <= np.hypot(end, NINETY * sd))


def replicated(fits: list[dict[str, Any]], others: list[dict[str, Any]]) -> tuple[list[bool], ...]:
    """Say of friction whether its interval holds what other motions of the joint give.

    The estimate of a motion like the first; the posterior of the bench's other motion, whose
    speeds differ, and that by both printed intervals.
    """
    held: tuple[list[bool], ...] = [], [], []
    for fit, other in zip(fits, others, strict=True):
        estimates = {row["name"]: row for row in other["rows"]}
        for row in (row for row in fit["rows"] if row["class"] == "friction"):
            if np.isfinite(row["alike"]).all():
                held[0].append(within(row, *row["alike"]))
            if there := estimates.get(row["name"]):
                value, sd = there["posterior"][:2]
                held[1].append(within(row, value, sd))
                apart = abs(value - row["reported"][0])
                both = np.hypot(row["reported"][1], there["reported"][1])
                held[2].append(apart <= NINETY * both)
    return held


def line(name: str, fits: list[dict[str, Any]], others: list[dict[str, Any]]) -> str:
    """Sum one effect up: constants, friction, and the law of the other motion."""
    cells = []
    for group in ("constants", "friction"):
        rows = [row for fit in fits for row in fit["rows"] if row["class"] == group]
        widths = [row["reported"][1] / row["posterior"][1] for row in rows]
        errors = [(row["reported"][0] - row["true"]) / row["posterior"][1] for row in rows]
        cells += [f"{np.mean([holds(row, 'posterior') for row in rows]):.0%} of {len(rows)}"]
        cells += [f"{np.mean([holds(row, 'reported') for row in rows]):.0%}"]
        cells += [f"{np.median(widths):.2f}, {np.quantile(widths, 0.9):.1f}"]
        cells += [f"{np.sqrt(np.mean(np.square(errors))):.1f}"]
    alike, held, both = replicated(fits, others)
    cells.append(f"{np.mean(alike):.0%} of {len(alike)}" if alike else "–")
    cells.append(f"{np.mean(held):.0%}, {np.mean(both):.0%} of {len(held)}" if held else "–")
    rows = [row for fit in fits for row in fit["rows"] if row["status"] == "identified"]
    cells.append(f"{len(rows)}, {sum(not holds(row, 'reported') for row in rows)}")
    good = sum(fit["outcome"] != "doubtful" for fit in fits)
    return f"| {name} | {' | '.join(cells)} | {good} of {len(fits)} |"


def named(cases: dict[str, list[dict[str, Any]]]) -> tuple[int, int, int]:
    """Count recordings whose model lacks what is listed, those with a finding, and right names."""
    total = with_finding = first = 0
    for case, fits in cases.items():
        kinds, _ = BENCHES[case]
        if kinds:
            findings = [fit["findings"] for fit in fits]
            total += len(fits)
            with_finding += sum(map(bool, findings))
            first += sum(bool(names) and names[0] in kinds for names in findings)
    return total, with_finding, first


HEAD = (
    "| lacks | constants, posterior | reported | width, median, 90 % | error, posterior sds "
    "| friction, posterior | reported | width | error | law of a motion alike held "
    "| of another motion: "
    "by its posterior, by both intervals | identified, missed | not doubtful |"
)


def main() -> None:
    """Fit what is asked for, and keep it case by case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=10)
    parser.add_argument("--effects", nargs="*", default=list(EFFECTS))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--to", type=Path, default=HERE / "lacking.json")
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    result = json.loads(options.to.read_text()) if options.to.exists() else {}
    if not options.table:
        with ProcessPoolExecutor(options.workers) as pool:
            for case in [case for effect in options.effects for case in EFFECTS[effect]]:
                tasks = [(case, number) for number in range(options.recordings)]
                result[case] = list(pool.map(fit_one, tasks))
                options.to.write_text(json.dumps(result) + "\n")
                print(case, flush=True)
    print(HEAD)
    groups = {**{effect: EFFECTS[effect] for effect in options.effects}}
    listed = [e for e in options.effects if e not in (*CORRECT, *NOT_LISTED)]
    for name, effects in (
        ("**nothing**", [e for e in options.effects if e in CORRECT]),
        ("**all that is listed**", listed),
        ("**all that is not**", [e for e in options.effects if e in NOT_LISTED]),
    ):
        groups[name] = tuple(case for effect in effects for case in EFFECTS[effect])
    for name, cases in groups.items():
        there = [case for case in cases if case in result]
        fits, others = [], []
        for case in there:
            twin = (
                case.removeprefix(MOTIONS[1]) if case.startswith(MOTIONS[1]) else MOTIONS[1] + case
            )
            twins = result.get(twin, [])
            empty = {"rows": []}
            fits += result[case]
            others += (twins + [empty] * len(result[case]))[: len(result[case])]
        if fits:
            print(line(name, fits, others), flush=True)
    total, with_finding, first = named(result)
    print(
        f"Of {total} that lack what is listed {with_finding} have a finding, "
        f"{first} the right one first."
    )


if __name__ == "__main__":
    main()
