"""Measure the coverage of roll-out bands for SIMULATED joints under position control.

``python studies/rollouts/rollouts.py`` simulates joints, fits one recording of each, and simulates
another from the posterior: by its targets (closed loop) and by its measured torque (open loop).
Models are right or lack a term of the joint. Writes ``rollouts.json``.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import bayesfric as bf
from bayesfric.mechanism.closed_loop import follow
from bayesfric.recordings.measurement import Law

RATE, SECONDS, KP, KD = 250.0, 12.0, 4.0, 0.05
N = int(RATE * SECONDS)
STEP, NOISE = 2.0 * np.pi / 20_000, 0.02  # of the encoder, rad; of the torque sensor, N m
MOTOR = {"inertia": True, "coulomb": "symmetric", "viscous": True}
TRUTH = {
    "motor.inertia": 0.01,
    "motor.viscous": 0.06,
    "motor.coulomb": 0.1,
    "load.first_moment": 0.05,
}
# Options and values of terms that the model lacks.
LACKING: dict[str, tuple[dict[str, Any], dict[str, float]]] = {
    "nothing": ({}, {}),
    "cogging 6 times a turn": (
        {"cogging": (6,)},
        {"motor.cogging_sin_6": 0.05, "motor.cogging_cos_6": 0.0},
    ),
    "Stribeck rise": (
        {"stribeck": True},
        {"motor.stribeck_ratio": 1.0, "motor.stribeck_velocity": 0.15},
    ),
    "quadratic loss": ({"quadratic": True}, {"motor.quadratic": 0.01}),
}


def joint(options: dict[str, Any]) -> bf.Joint:
    """Make a joint with gravity."""
    return bf.Joint([bf.Element("motor", **(MOTOR | options))], bf.Load(first_moment=True))


def recorded(chain: bf.Joint, values: dict[str, float], name: str, seed: int) -> bf.Recording:
    """Record the true joint following a target, by encoder and torque sensor."""
    rng = np.random.default_rng(seed)
    time = np.arange(N) / RATE
    waves = zip((1.3, 3.1, 7.9), (0.8, 0.4, 0.1), rng.uniform(0.0, 2.0 * np.pi, 3), strict=True)
    goal = sum(a * np.sin(w * rng.uniform(0.8, 1.2) * time + p) for w, a, p in waves)
    law = Law(KP * goal, np.ones(N), kp=KP, kd=KD)
    start = [(0, N)], goal[:1], np.zeros(1)
    q, qd = follow(chain, chain.vector(values)[None], law, 1.0 / RATE, *start)
    torque = law.drives(q[0], qd[0]) + NOISE * rng.standard_normal(N)
    return bf.Recording.from_arrays(time, STEP * np.round(q[0] / STEP), torque, name=name)


def targeted(chain: bf.Joint, values: dict[str, float], name: str, seed: int) -> bf.Recording:
    """Return the same recording with its target in place of its torque."""
    rng = np.random.default_rng(seed)
    time = np.arange(N) / RATE
    waves = zip((1.3, 3.1, 7.9), (0.8, 0.4, 0.1), rng.uniform(0.0, 2.0 * np.pi, 3), strict=True)
    goal = sum(a * np.sin(w * rng.uniform(0.8, 1.2) * time + p) for w, a, p in waves)
    plain = recorded(chain, values, name, seed)
    assert plain.table is not None
    position = plain.table.column("position")
    gains = {"kp": f"{KP} N m/rad", "kd": f"{KD} N m s/rad"}
    return bf.Recording.from_arrays(time, position, None, target=goal, name=name, **gains)


def joint_of(lacking: str, seed: int) -> dict[str, Any]:
    """Fit one recording of a joint, simulate another in closed and open loop."""
    options, added = LACKING[lacking]
    rng = np.random.default_rng([seed, 77])
    truth = {**TRUTH, **added}
    values = {name: x * np.exp(0.2 * rng.standard_normal()) for name, x in truth.items()}
    true = joint(options)
    fitted, other = 2 * seed, 2 * seed + 1
    model = bf.Model(
        joint({}),
        recorded(true, values, "fitted", fitted),
        sampling={"seed": seed, "min_ess": 1000},
        self_check={"recordings": 0},
    )
    posterior = model.sample()
    out = {}
    for kind, make in (("closed", targeted), ("open", recorded)):
        rolled = bf.rollout(posterior, make(true, values, kind, other), seed=seed)
        (played,) = rolled.rolled
        out[kind] = {
            "mae": played.errors["position"].mae,
            "inside": played.errors["position"].inside,
            "alone": played.errors["position"].inside_alone,
            "alone_width": float(np.nanmedian(played.alone[1] - played.alone[0])),
            "moves": rolled.unexplained["fitted"],
        }
    return out


def main() -> None:
    """Print a row for each model and loop."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--joints", type=int, default=30)
    joints = parser.parse_args().joints
    outcomes = {name: [joint_of(name, seed) for seed in range(joints)] for name in LACKING}
    print("| the model lacks | loop | MAE (mrad) | inside 90 % bands | parameters alone | moves |")
    print("|---|---|---|---|---|---|")
    for name, rows in outcomes.items():
        for kind in ("closed", "open"):
            columns = {k: np.array([row[kind][k] for row in rows]) for k in rows[0][kind]}
            error = columns["inside"].std(ddof=1) / np.sqrt(len(rows))
            print(
                f"| {name} | {kind} | {1e3 * np.median(columns['mae']):.2f} | "
                f"{100 * columns['inside'].mean():.0f} ± {100 * error:.0f} % | "
                f"{100 * columns['alone'].mean():.0f} % | {np.median(columns['moves']):.2f} |"
            )
    path = Path(__file__).with_name("rollouts.json")
    path.write_text(json.dumps(outcomes, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
