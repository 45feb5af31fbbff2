"""Does `fit` with its defaults call `data` what is far from the truth? A joint in closed loop.

A joint follows a slow smooth path under a position and speed controller that acts on a noisy
encoder. The recorded torque is the commanded one behind a low-pass of the drive's maker, rounded.
So the torque is smooth and the acceleration is noise beyond a few Hz: the case in which an
autoregressive noise near a unit root believes the noise.

``python studies/closed_loop/closed_loop.py`` writes recordings as CSV, fits each with the
``motor-axis`` preset and nothing else, and puts the result beside what ``result.json`` holds of
other versions. It uses nothing of the package but ``fit``: with ``PYTHONPATH`` set to a checkout of
0.1.0 and ``--label 0.1.0`` it measures that.
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

HERE = Path(__file__).resolve().parent
CONFIG = """\
[mechanism]
preset = "motor-axis"

[[recordings]]
file = "recording.csv"
time = { column = "t", unit = "s" }
position = { column = "q", unit = "rad" }
torque = { column = "tau", unit = "N m" }
"""
# Inertia, viscous, Coulomb, offset: about those of an arm's wrist; each of the first three +-30 %.
TYPICAL = {"motor.inertia": 7.7, "motor.viscous": 9.6, "motor.coulomb": 6.0, "offset": 0.3}
RATE, SECONDS, NOISE, STEP = 500.0, 14.0, 2e-4, 0.01
FINE = 20  # integration steps a sample
CASES = {"low-pass at 10 Hz": 10.0, "low-pass at 5 Hz": 5.0, "no low-pass": 0.0}
FAR = 4.0  # sds from the truth that no interval should allow


@dataclass(frozen=True)
class Recording:
    """What is recorded, SI units, ``(n,)`` each, and the joint's true parameters."""

    time: np.ndarray
    position: np.ndarray
    torque: np.ndarray
    truth: dict[str, float]


def recorded(
    seed: int, lowpass: float = 10.0, noise: float = NOISE, seconds: float = SECONDS
) -> Recording:
    """Simulate one recording.

    Parameters
    ----------
    seed
        Of path, parameters and noise.
    lowpass
        Cut-off of the maker's filter of the torque, Hz, zero phase; 0 for none.
    noise
        Of a position sample, rad.
    seconds
        Duration.
    """
    rng = np.random.default_rng(seed)
    truth = {
        name: value * (1.0 if name == "offset" else rng.uniform(0.7, 1.3))
        for name, value in TYPICAL.items()
    }
    inertia, viscous, coulomb, offset = truth.values()
    n = round(seconds * RATE)
    t = np.arange(n * FINE) / (RATE * FINE)
    frequency, phase = rng.uniform(0.05, 0.45, 3), rng.uniform(0, 2 * np.pi, 3)
    w, size = 2 * np.pi * frequency[:, None], rng.uniform(0.3, 0.8, 3)[:, None]
    path = (size * (np.sin(w * t + phase[:, None]) - np.sin(phase[:, None]))).sum(axis=0)
    speed = (size * w * np.cos(w * t + phase[:, None])).sum(axis=0)
    own = 2 * np.pi * 3.0  # the loop's natural frequency, damping 0.8
    gains = inertia * own**2, 1.6 * own * inertia
    position, torque = _loop(
        path, speed, n, inertia, viscous, coulomb, offset, *gains, noise * rng.standard_normal(n)
    )
    # held over a sample: at its instant the mean of the two it lies between
    torque = np.concatenate([torque[:1], 0.5 * (torque[1:] + torque[:-1])])
    if lowpass:
        torque = signal.sosfiltfilt(signal.butter(2, lowpass, fs=RATE, output="sos"), torque)
    return Recording(np.arange(n) / RATE, position, np.round(torque / STEP) * STEP, truth)


@njit(cache=True)
def _loop(path, speed, n, inertia, viscous, coulomb, offset, stiffness, damping, noise):
    """Integrate the joint with exact sticking; the controller sees noisy positions only."""
    dt = 1.0 / (RATE * FINE)
    position, torque = np.empty(n), np.empty(n)
    q, v, before, filtered = 0.0, speed[0], 0.0, speed[0]
    share = 2.0 * np.pi * 20.0 / RATE  # of the controller's own low-pass of the speed
    for k in range(n):
        seen = q + noise[k]
        if k > 0:
            filtered += ((seen - before) * RATE - filtered) * share
        before = seen
        now = k * FINE
        command = stiffness * (path[now] - seen) + damping * (speed[now] - filtered)
        position[k], torque[k] = seen, command
        for _ in range(FINE):
            net = command - offset - viscous * v
            if v == 0.0 and abs(net) <= coulomb:
                continue
            direction = np.sign(v) if v != 0.0 else np.sign(net)
            after = v + (net - coulomb * direction) / inertia * dt
            if v * after < 0.0:
                after = 0.0  # it stops before it turns
            q += 0.5 * (v + after) * dt
            v = after
    return position, torque


def fitted(recording: Recording) -> dict:
    """Fit a recording with the defaults, over a CSV file as users do; gives ``summary.json``."""
    from bayesfric.fit.model import Model

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        table = np.column_stack([recording.time, recording.position, recording.torque])
        np.savetxt(folder / "recording.csv", table, "%.9g", ",", header="t,q,tau", comments="")
        (folder / "joint.toml").write_text(CONFIG, encoding="utf-8")
        return Model.from_config(folder / "joint.toml").fit().summary.as_dict()


def judged(summary: dict, truth: dict[str, float]) -> dict[str, dict]:
    """Put what a run says of each parameter beside the truth."""
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
    """Fit so many recordings of one case."""
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
    rows = [(r["status"], row) for r in runs for row in r["parameters"].values()]
    told = [row for _, row in rows if row["verdict"] == "data"]
    return {
        "recordings": recordings,
        "reliable": sum(r["status"] == "reliable" for r in runs),
        "numbers": len(rows),
        "data": len(told),
        "data_far": sum(abs(row["z"]) > FAR for row in told),
        "recordings_with_data_far": sum(
            any(x["verdict"] == "data" and abs(x["z"]) > FAR for x in r["parameters"].values())
            for r in runs
        ),
        "data_covered": sum(row["covered"] for row in told),
        "data_rms_z": float(np.sqrt(np.mean([row["z"] ** 2 for row in told]))) if told else None,
        "largest_z": max((abs(row["z"]) for row in told), default=None),
    }


def main() -> None:
    """Measure every case with the package that is imported, and add it to ``result.json``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--recordings", type=int, default=100)
    parser.add_argument("--label", default="today")
    options = parser.parse_args()
    path = HERE / "result.json"
    result = json.loads(path.read_text("utf-8")) if path.exists() else {}
    for case, lowpass in CASES.items():
        found = measured(lowpass, options.recordings)
        result.setdefault(case, {})[options.label] = found
        path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        print(case, options.label, found, flush=True)


if __name__ == "__main__":
    main()
