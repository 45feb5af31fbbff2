"""Do intervals hold for the next recording? MEASURED: recordings of one joint in different motions.

``python studies/replication/replication.py`` fits each recording of ``../shared/data`` by itself
(those of the XL330 by fours: of one position gain, or of one trajectory), and compares every two of
one joint: the difference of each number that the data of both determine, over the root of the
summed squares of its two standard deviations, which should scatter by one. Writes
``replication.json``; ``--cases A B`` fits some of them again and keeps the others.
"""

from __future__ import annotations

import argparse
import json
import os
import re
from concurrent.futures import ProcessPoolExecutor

if __name__ == "__main__":
    for variable in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

HERE = Path(__file__).resolve().parent
STUDIES = HERE.parent
DATA = STUDIES.parents[1] / "shared" / "data"

# Half of the 90 % interval of a standard normal.
_NINETY = 1.645
PENDULUM = """\
[mechanism]
preset = "servo-pendulum"

[[recordings]]
file = "../../../shared/data/dfki-pendulum/{name}.csv"
time = {{ column = "time", unit = "s" }}
position = {{ column = "position", unit = "rad" }}
torque = {{ column = "torque", unit = "N m" }}
{part}
[sampling]
seed = 500
"""
# What looks free of somebody's hand; ilqr's is too short for a fit.
PENDULUM_PARTS = {
    "ddp": "",
    "dircol": "",
    "es500": 'stop = "7.4 s"',
    "sac": 'stop = "10 s"',
}
# The wide motion of the UR10e and its middle, of other periods; and both halves of its reach.
MIDDLE, SPLIT = (-2.8, -1.7), -2.27


def cases() -> dict[str, dict[str, tuple[Path, str]]]:
    """Name every joint's recordings, each with the file it stands for and its configuration."""
    cases: dict[str, dict[str, tuple[Path, str]]] = {}
    for name, file in (("EMPS", "white"), ("EMPS, viscous by direction", "asymmetric")):
        text = _bare(STUDIES / "emps" / f"emps-{file}.toml").replace('stribeck = "either"\n', "")
        cases[name] = {
            run: (STUDIES / "emps", text.replace("DATA_EMPS.mat", f"{run}.mat"))
            for run in ("DATA_EMPS", "DATA_EMPS_PULSES")
        }
    arm = _bare(STUDIES / "ur10e" / "ur10e-joint2.toml")
    for name, spans in _arm_parts().items():
        cases[name] = {
            run: (STUDIES / "ur10e", arm.replace('stop = "60 s"\n', f'stop = "60 s"\n{words}\n'))
            for run, words in spans.items()
        }
    cases["pendulum, controllers"] = {
        run: (STUDIES / "dfki-pendulum", PENDULUM.format(name=run, part=part))
        for run, part in PENDULUM_PARTS.items()
    }
    servo = _bare(STUDIES / "xl330" / "xl330.toml")
    files = sorted((DATA / "xl330-pendulum").glob("*.json"))
    head, middle, tail = re.match(
        r"(.*?)(\[\[recordings\]\].*?)(\[processing\].*)", servo, re.DOTALL
    ).groups()

    def fitted_together(some: list[Path]) -> tuple[Path, str]:
        runs = "".join(middle.replace("*.json", file.name) for file in some)
        return STUDIES / "xl330", head + runs + tail

    # they were recorded gain by gain, the four trajectories in turn
    cases["XL330, gains"] = {
        str(k): fitted_together(files[4 * k : 4 * k + 4]) for k in range(len(files) // 4)
    }
    cases["XL330, trajectories"] = {str(k): fitted_together(files[k::4]) for k in range(4)}
    return cases


def _bare(path: Path) -> str:
    """Read a configuration without the noise it chose and what it compares with."""
    text = path.read_text(encoding="utf-8")
    return re.sub(r"\[(noise|references)\].*?(?=\n\[|\Z)", "", text, flags=re.DOTALL)


def _arm_parts() -> dict[str, dict[str, str]]:
    table = np.genfromtxt(DATA / "ur10e-joint2" / "joint_2.csv", delimiter=",")
    time, position = table[:, 0] - table[0, 0], table[:, 2]

    def without(flags: np.ndarray) -> str:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
        spans = [[float(time[a]), float(time[b - 1])] for a, b in edges.reshape(-1, 2)]
        return f"exclude = {json.dumps(spans)}"

    off = (position < MIDDLE[0]) | (position > MIDDLE[1])
    return {
        "UR10e, halves of its reach": {
            "low": without(position > SPLIT),
            "high": without(position <= SPLIT),
        },
        "UR10e, wide and narrow": {
            "wide": without(time > 34.0),
            "narrow": without((time <= 34.0) | off),
        },
    }


def fit_one(task: tuple[str, str, Path, str]) -> dict[str, Any]:
    """Fit one recording; gives each number by the posterior, with robust sds, and as reported."""
    from bayesfric import Model
    from bayesfric.problem.config import parse_config

    case, run, folder, text = task
    result = Model.from_config(parse_config(text, folder / "replication.toml")).fit()
    summary = result.summary
    constants = {p.name for p in result.fit.chain.parameters if p.row.measurand == "constant"}
    estimates = summary.estimates["input-error"].parameters
    rows = {}
    for name, row in summary.joint.items():
        robust = estimates[name].sd_robust if name in estimates else None
        rows[name] = {
            "class": "constants" if name in constants else "friction",
            "value": {
                "posterior": row.middle,
                "HAC": row.middle,
                "reported": row.value,
            },
            "posterior": row.sd,
            "HAC": max(row.sd, robust) if robust is not None else row.sd,
            "reported": row.reported.sd,
            "interval": [row.reported.low, row.reported.high],
            # whether its data determine it, by each of its sds, doubted or not
            "determined": row.verdict == "data" or bool(row.doubted),
            "status": row.reported.status,
            "prior": row.prior_sd,
        }
    error = summary.model_error
    return {
        "case": case,
        "run": run,
        "noise": summary.noise.model,
        "chance": error["chance"] if error else None,
        "findings": [finding.kind for finding in summary.findings],
        "rows": rows,
    }


def differences(
    runs: list[dict[str, Any]], kind: str, group: str = "", *, doubted: bool = True
) -> list[float]:
    """Standardise the difference of every number of every two runs, of one group or all."""
    z = []
    for a, b in combinations(runs, 2):
        for name in a["rows"].keys() & b["rows"].keys():
            rows = a["rows"][name], b["rows"][name]
            if group and rows[0]["class"] != group:
                continue
            certain = all(row["status"] == "identified" for row in rows)
            if all(_determined(row, kind) for row in rows) and (doubted or certain):
                apart = rows[0]["value"][kind] - rows[1]["value"][kind]
                z.append(float(apart / np.hypot(rows[0][kind], rows[1][kind])))
    return z


def _determined(row: dict[str, Any], kind: str) -> bool:
    wide = row["prior"] is not None and row[kind] > 0.5 * row["prior"]
    return row["determined"] and not wide


def judged(z: list[float]) -> dict[str, float]:
    """Scatter of standardised differences, and how many of them a 90 % interval holds.

    ``most`` is the 95 % point of the scatter of as many independent ones.
    """
    x = np.array(z)
    return {
        "n": x.size,
        "rms": float(np.sqrt(np.mean(x**2))) if x.size else float("nan"),
        "held": float(np.mean(np.abs(x) < _NINETY)) if x.size else float("nan"),
        "most": float(np.sqrt(chi2.ppf(0.95, x.size) / x.size)) if x.size else float("nan"),
    }


def widths(fits: list[dict[str, Any]], group: str) -> list[float]:
    """Give median and 90 % quantile of widths over the posterior's, of what data determine."""
    ratios = [
        row["reported"] / row["posterior"]
        for fit in fits
        for row in fit["rows"].values()
        if row["class"] == group and _determined(row, "posterior")
    ]
    return [float(x) for x in np.quantile(ratios, [0.5, 0.9])]


COLUMNS = {
    f"{kind}, {group}": (kind, group, doubted)
    for kind, group, doubted in (
        ("posterior", "friction", True),
        ("reported", "friction", True),
        ("posterior", "constants", True),
        ("reported", "constants", True),
    )
} | {"HAC": ("HAC", "", True), "identified": ("reported", "", False)}


def summed(fits: list[dict[str, Any]]) -> dict[str, Any]:
    """Judge every case, and all together."""
    cases: dict[str, Any] = {}
    every: dict[str, list[float]] = {}
    for case in dict.fromkeys(fit["case"] for fit in fits):
        runs = [fit for fit in fits if fit["case"] == case]
        cases[case] = {}
        for column, (kind, group, doubted) in COLUMNS.items():
            z = differences(runs, kind, group, doubted=doubted)
            every.setdefault(column, []).extend(z)
            cases[case][column] = judged(z)
    cases["all"] = {column: judged(z) for column, z in every.items()}
    return {"cases": cases, "widths": {g: widths(fits, g) for g in ("friction", "constants")}}


def main() -> None:
    """Fit the requested cases and keep the others, or print what is there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", nargs="*", help="to fit again; all if left out")
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    path, known = HERE / "replication.json", cases()
    requested = [] if options.table else options.cases or list(known)
    if unknown := set(requested) - set(known):
        parser.error(f"there is no case {', '.join(sorted(unknown))}")
    fits = json.loads(path.read_text(encoding="utf-8"))["fits"] if path.exists() else []
    fits = [fit for fit in fits if fit["case"] not in requested]
    tasks = [(case, run, *known[case][run]) for case in requested for run in known[case]]
    if tasks:
        with ProcessPoolExecutor(2) as pool:
            fits += list(pool.map(fit_one, tasks))
        fits.sort(key=lambda fit: list(known).index(fit["case"]))
        text = json.dumps({"fits": fits} | summed(fits), indent=1).replace("NaN", "null")
        path.write_text(text + "\n", encoding="utf-8")
    result = json.loads(path.read_text(encoding="utf-8"))
    print("| joint | " + " | ".join(COLUMNS) + " |")
    for case, row in result["cases"].items():
        cells = [
            f"{row[k]['rms']:.2f} ({row[k]['most']:.2f}), {100 * row[k]['held']:.0f} % of "
            f"{row[k]['n']}"
            if row[k]["n"]
            else "–"
            for k in COLUMNS
        ]
        print(f"| {case} | " + " | ".join(cells) + " |")
    for group, (median, high) in result["widths"].items():
        print(f"{group}: width over the posterior's {median:.2f}, 90 % quantile {high:.2f}")


if __name__ == "__main__":
    main()
