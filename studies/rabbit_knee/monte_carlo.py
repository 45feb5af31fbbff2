"""Compare the mean error of each method with truth over many SIMULATED recordings of the knee.

``python studies/rabbit_knee/monte_carlo.py [COUNT]`` simulates COUNT (200) recordings of the
knee that differ in their noise only, estimates each by the three methods with unknown scale,
and writes ``monte_carlo.json``. Half an hour on two cores.
"""

from __future__ import annotations

import json
import math
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

# Recordings are estimated in parallel processes, with one thread each.
if __name__ == "__main__":
    for variable in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates import METHODS
from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.least_squares import TotalsProjection, least_squares
from bayesfric.estimates.output_error import output_error
from bayesfric.estimates.point_estimate import Estimate, Estimation, Knowledge
from bayesfric.estimates.torque import filtered_torque
from bayesfric.estimates.trajectory import trajectory
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.experiment import Simulation, record
from bayesfric.mechanism.joint import PRESETS
from bayesfric.recordings.measurement import Inputs, Measurement
from bayesfric.recordings.signals import Signals, observe
from bayesfric.recordings.source import Processing

FOLDER = Path(__file__).resolve().parent
PRESET = PRESETS["rabbit-knee"]
# The conditions of knee.toml.
CONDITIONS = Simulation(seed=0)


def recording(conditions: Simulation) -> Measurement:
    """Simulate a recording of the knee, in memory."""
    chain = PRESET.chain()
    columns, _, _ = record(chain, conditions)
    n = columns["time"].size
    return Measurement(
        name="knee",
        path=Path("simulated"),
        sha256="",
        time=columns["time"],
        position=columns["position"] / chain.ratio,
        velocity=None,
        torque=columns["torque"],
        segments=((0, n),),
        period=1.0 / conditions.rate,
        excluded=np.zeros(n, dtype=np.bool_),
        inputs=Inputs(),
        steps=(),
        warnings=(),
    )


def truth(observation: Signals) -> dict[str, float]:
    """Return the true value of each estimate that the scaling does not change.

    The totals of eq. (11) are least-squares estimates of the true torque along
    ``observation``'s motion; with two alphas they have no other definition.
    """
    chain = PRESET.chain()
    values = chain.vector(PRESET.values)
    true_values = {
        q.name: float(q.values[0]) for q in derive(chain, values[None], 1.0) if q.gauge_free
    }
    true_values |= {
        name: value for name, value in PRESET.values.items() if name.startswith("motor.")
    }
    projection = TotalsProjection(chain, [observation])
    totals = projection.solve(filtered_torque(chain, observation, values[None])[0])
    return true_values | dict(zip(projection.labels, totals.tolist(), strict=True))


def estimate(seed: int) -> dict[str, Estimate]:
    """Estimate one recording by all methods, with unknown scale."""
    chain = PRESET.chain()
    measurement = recording(CONDITIONS.model_copy(update={"seed": seed}))
    observation = observe(measurement, Processing())
    options = Estimation(seed=seed)
    direct = input_error(chain, [observation], Knowledge(), options)
    path = trajectory(measurement, observation, math.inf)
    recursive = output_error(chain, [path], [observation], Knowledge(), options, direct)
    estimates = (least_squares(chain, [observation]), direct, recursive)
    return {result.method: result for result in estimates}


def run(count: int, first: int = 1, workers: int = 2) -> dict[str, Any]:
    """Estimate ``count`` recordings and compare mean errors with claimed deviations."""
    seeds = range(first, first + count)
    if workers > 1:
        with ProcessPoolExecutor(workers) as pool:
            estimates = list(pool.map(estimate, seeds, chunksize=5))
    else:
        estimates = [estimate(seed) for seed in seeds]
    # totals are defined by the true motion, not the measured one
    exact = replace(
        observe(recording(CONDITIONS.model_copy(update=_PERFECT)), Processing()), name="exact"
    )
    true_values = truth(exact)
    table: dict[str, Any] = {}
    for name, value in true_values.items():
        rows = {}
        for method in METHODS:
            cells = [methods[method][name] for methods in estimates if name in methods[method]]
            if cells:
                rows[method] = _compared(
                    np.array([c.value for c in cells]),
                    np.array([c.sd for c in cells]),
                    np.array([c.sd_robust for c in cells]),
                    value,
                )
                rows[method]["unit"] = cells[0].unit
        if rows:
            table[name] = {"truth": value, "methods": rows}
    return {
        "simulated": True,
        "recordings": count,
        "conditions": CONDITIONS.model_dump(mode="json"),
        "table": table,
    }


_PERFECT = {"encoder_counts": 0, "torque_noise": 0.0}


def _compared(
    values: NDArray[np.float64],
    sd: NDArray[np.float64],
    robust: NDArray[np.float64],
    true: float,
) -> dict[str, Any]:
    """Return mean error with standard error, spread, claimed deviations and coverage."""
    free = np.isfinite(sd) & np.isfinite(robust)  # not on a bound
    spread = float(values.std(ddof=1))
    error = float(values.mean() - true)
    reach = 1.6448536269514722  # 90 %

    def covered(claimed: NDArray[np.float64]) -> float:
        inside = np.abs(values[free] - true) <= reach * claimed[free]
        return float(inside.mean()) if free.any() else math.nan

    return {
        "mean_error": error,
        "standard_error": spread / math.sqrt(values.size),
        "spread": spread,
        "claimed_sd": float(np.median(sd[free])) if free.any() else None,
        "claimed_sd_robust": float(np.median(robust[free])) if free.any() else None,
        "coverage_90": covered(sd) if free.any() else None,
        "coverage_90_robust": covered(robust) if free.any() else None,
        "on_bound": float(1.0 - free.mean()),
    }


def markdown(result: dict[str, Any]) -> str:
    """Format the comparison as a Markdown table."""
    lines = [
        "| quantity | method | truth | mean error ± standard error | spread | claimed sd | "
        "claimed sd (correlated) | 90 % interval holds truth (plain / correlated) | on a bound |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, row in result["table"].items():
        for method, c in row["methods"].items():
            biased = " **biased**" if abs(c["mean_error"]) > 3 * c["standard_error"] else ""
            coverage = (
                f"{100 * c['coverage_90']:.0f} % / {100 * c['coverage_90_robust']:.0f} %"
                if c["coverage_90"] is not None
                else "–"
            )
            lines.append(
                f"| `{name}` ({c['unit'] or '–'}) | {method} | {row['truth']:.4g} | "
                f"{c['mean_error']:+.2g} ± {c['standard_error']:.1g}{biased} | {c['spread']:.2g} | "
                f"{_short(c['claimed_sd'])} | {_short(c['claimed_sd_robust'])} | {coverage} | "
                f"{100 * c['on_bound']:.0f} % |"
            )
    return "\n".join(lines)


def _short(x: float | None) -> str:
    return "–" if x is None else f"{x:.2g}"


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    result = run(count)
    (FOLDER / "monte_carlo.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(markdown(result))
