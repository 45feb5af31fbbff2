"""Check whether numbers with verdict `data` are right for a SIMULATED joint in closed loop.

A joint follows a slow smooth path under a position and speed controller with a noisy encoder. The
recorded torque is the low-passed and rounded command. So the torque is smooth, and the acceleration
is noise beyond a few Hz; an autoregressive model near a unit root then fits the noise.

``python studies/closed_loop/closed_loop.py`` writes recordings as CSV, fits each with the
``motor-axis`` preset alone, and adds the result to ``result.json``. Of the package it uses only
``fit``: with ``PYTHONPATH`` set to a checkout of 0.1.0 and ``--label 0.1.0`` it tests that version.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit
from scipy import signal

FOLDER = Path(__file__).resolve().parent
CONFIG = """\
[mechanism]
preset = "motor-axis"

[[recordings]]
file = "recording.csv"
time = { column = "t", unit = "s" }
position = { column = "q", unit = "rad" }
torque = { column = "tau", unit = "N m" }
"""
# About those of an arm's wrist; each of the first three +-30 %.
TYPICAL = {"motor.inertia": 7.7, "motor.viscous": 9.6, "motor.coulomb": 6.0, "offset": 0.3}
RATE, SECONDS, NOISE, STEP = 500.0, 14.0, 2e-4, 0.01
FINE = 20  # integration steps a sample
CASES = {"low-pass at 10 Hz": 10.0, "low-pass at 5 Hz": 5.0, "no low-pass": 0.0}
FAR = 4.0  # standard deviations from the truth that no interval should miss


@dataclass(frozen=True)
class Recording:
    """A recording in SI units, ``(n,)`` each, and the joint's true parameters."""

    time: np.ndarray
    position: np.ndarray
    torque: np.ndarray
    truth: dict[str, float]


def recorded(
    seed: int, lowpass: float = 10.0, noise: float = NOISE, seconds: float = SECONDS
) -> Recording:
    """Simulate one recording; ``lowpass`` is the torque filter's cut-off, Hz, 0 for none."""
    rng = np.random.default_rng(seed)
    truth = {
        name: value * (1.0 if name == "offset" else rng.uniform(0.7, 1.3))
        for name, value in TYPICAL.items()
    }
    inertia, viscous, coulomb, offset = truth.values()
    n = round(seconds * RATE)
    t = np.arange(n * FINE) / (RATE * FINE)
    frequency, phase = rng.uniform(0.05, 0.45, 3), rng.uniform(0, 2 * np.pi, 3)
    omega, size = 2 * np.pi * frequency[:, None], rng.uniform(0.3, 0.8, 3)[:, None]
    path = (size * (np.sin(omega * t + phase[:, None]) - np.sin(phase[:, None]))).sum(axis=0)
    speed = (size * omega * np.cos(omega * t + phase[:, None])).sum(axis=0)
    natural = 2 * np.pi * 3.0  # natural frequency of the loop, damping 0.8
    gains = inertia * natural**2, 1.6 * natural * inertia
    position, torque = _loop(
        path, speed, n, inertia, viscous, coulomb, offset, *gains, noise * rng.standard_normal(n)
    )
    # held over a sample: at the stamp the mean of its two neighbours
    torque = np.concatenate([torque[:1], 0.5 * (torque[1:] + torque[:-1])])
    if lowpass:
        torque = signal.sosfiltfilt(signal.butter(2, lowpass, fs=RATE, output="sos"), torque)
    return Recording(np.arange(n) / RATE, position, np.round(torque / STEP) * STEP, truth)


@njit(cache=True)
def _loop(path, speed, n, inertia, viscous, coulomb, offset, stiffness, damping, noise):
    """Integrate the joint with exact sticking; the controller measures noisy positions."""
    dt = 1.0 / (RATE * FINE)
    position, torque = np.empty(n), np.empty(n)
    q, v, previous, filtered = 0.0, speed[0], 0.0, speed[0]
    weight = 2.0 * np.pi * 20.0 / RATE  # of the controller's low-pass of the speed
    for k in range(n):
        measured_q = q + noise[k]
        if k > 0:
            filtered += ((measured_q - previous) * RATE - filtered) * weight
        previous = measured_q
        now = k * FINE
        command = stiffness * (path[now] - measured_q) + damping * (speed[now] - filtered)
        position[k], torque[k] = measured_q, command
        for _ in range(FINE):
            net = command - offset - viscous * v
            if v == 0.0 and abs(net) <= coulomb:
                continue
            direction = np.sign(v) if v != 0.0 else np.sign(net)
            after = v + (net - coulomb * direction) / inertia * dt
            if v * after < 0.0:
                after = 0.0  # it stops before it reverses
            q += 0.5 * (v + after) * dt
            v = after
    return position, torque


def fitted(recording: Recording) -> dict:
    """Fit a recording with defaults, from a CSV file; return ``summary.json``."""
    from bayesfric.fit.model import Model

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        table = np.column_stack([recording.time, recording.position, recording.torque])
        np.savetxt(folder / "recording.csv", table, "%.9g", ",", header="t,q,tau", comments="")
        (folder / "joint.toml").write_text(CONFIG, encoding="utf-8")
        return Model.from_config(folder / "joint.toml").fit().summary.as_dict()


def judged(summary: dict, truth: dict[str, float]) -> dict[str, dict]:
    """Compare each parameter of a run with the truth."""
    return {
        name: {
            "z": (row["median"] - truth[name]) / row["sd"],
            "verdict": row["verdict"],
            "covered": row["interval"][0] <= truth[name] <= row["interval"][1],
        }
        for name, row in summary["parameters"].items()
        if name in truth
    }


def measured(lowpass: float, recordings: int) -> dict:
    """Fit the recordings of one case."""
    runs = []
    for seed in range(recordings):
        recording = recorded(seed, lowpass)
        summary = fitted(recording)
        runs.append(
            {
                "status": summary["sampler"]["status"],
                "noise": summary["noise"]["model"],
                "parameters": judged(summary, recording.truth),
            }
        )
    rows = [(run["status"], row) for run in runs for row in run["parameters"].values()]
    determined = [row for _, row in rows if row["verdict"] == "data"]
    return {
        "recordings": recordings,
        "reliable": sum(run["status"] == "reliable" for run in runs),
        "numbers": len(rows),
        "data": len(determined),
        "data_far": sum(abs(row["z"]) > FAR for row in determined),
        "recordings_with_data_far": sum(
            any(x["verdict"] == "data" and abs(x["z"]) > FAR for x in run["parameters"].values())
            for run in runs
        ),
        "data_covered": sum(row["covered"] for row in determined),
        "data_rms_z": float(np.sqrt(np.mean([row["z"] ** 2 for row in determined])))
        if determined
        else None,
        "largest_z": max((abs(row["z"]) for row in determined), default=None),
    }


def main() -> None:
    """Run every case with the imported package, and add it to ``result.json``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--recordings", type=int, default=100)
    parser.add_argument("--label", default="today")
    options = parser.parse_args()
    path = FOLDER / "result.json"
    result = json.loads(path.read_text("utf-8")) if path.exists() else {}
    for case, lowpass in CASES.items():
        outcome = measured(lowpass, options.recordings)
        result.setdefault(case, {})[options.label] = outcome
        path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        print(case, options.label, outcome, flush=True)


if __name__ == "__main__":
    main()
