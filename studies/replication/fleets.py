"""Do intervals of a population of runs hold what they say? SIMULATED fleets of 5 and of 20.

``python studies/replication/fleets.py`` draws 200 fleets of each size: every run swings the same
axis on its own way, with its own viscous loss; its posterior is that of the linear regression,
which is exact. Pooled by their means and sds, counted is how often the 90 % intervals hold
the population's mean, its spread, the next run's true value and the runs' own: of runs that know
theirs better than the spread, and of runs that hardly do. With ``--jointly`` 20 fleets of 5 of the
second kind go the whole way of ``bayesfric pool`` (ten minutes). Writes ``fleets.json``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bayesfric as bf
from bayesfric.population.population import Interval, population

HERE = Path(__file__).resolve().parent
SEED = 2032
# Viscous loss: mean and spread.
MEAN, SPREAD = 0.1, 0.004
# Noise of the torque, N m, from run to run: a run's sd is some 0.1 to 0.5, or 0.3 to 2 spreads.
FINE, ROUGH = (0.03, 0.15), (0.1, 0.6)
OTHERS = {"inertia": 0.05, "coulomb": 0.3, "moment": 0.3, "offset": 0.05}
TIME = np.arange(0.0, 8.0, 0.01)
Array = NDArray[np.float64]


def columns(rng: np.random.Generator) -> tuple[Array, Array]:
    """Swing on a way of its own: position, and the torque's columns, viscous last."""
    q, qd, qdd = np.zeros((3, TIME.size))
    for hertz, amplitude in ((0.31, 0.9), (0.9, 0.4), (1.9, 0.12)):
        w = 2.0 * np.pi * hertz * rng.uniform(0.8, 1.25)
        phase, a = rng.uniform(0.0, 2.0 * np.pi), amplitude * rng.uniform(0.6, 1.2)
        q += a * np.sin(w * TIME + phase)
        qd += a * w * np.cos(w * TIME + phase)
        qdd -= a * w**2 * np.sin(w * TIME + phase)
    stack = [qdd, np.sign(qd), 9.80665 * np.sin(q), np.ones_like(q), qd]
    return q, np.stack(stack, axis=1)


def torque(rows: Array, viscous: float, noise: float, rng: np.random.Generator) -> Array:
    """Measure with white noise."""
    values = np.array([*OTHERS.values(), viscous])
    return np.asarray(rows @ values + noise * rng.standard_normal(TIME.size))


def regression(
    viscous: float, rng: np.random.Generator, noises: tuple[float, float] = ROUGH
) -> Array:
    """Draw from a run's exact posterior of its viscous loss, flat priors, known noise."""
    _, rows = columns(rng)
    noise = float(rng.uniform(*noises))
    measured = torque(rows, viscous, noise, rng)
    covariance = noise**2 * np.linalg.inv(rows.T @ rows)
    best = np.linalg.solve(rows.T @ rows, rows.T @ measured)
    return np.asarray(best[-1] + np.sqrt(covariance[-1, -1]) * rng.standard_normal(2000))


def separately(number: int, size: int, noises: tuple[float, float]) -> list[bool]:
    """Pool one fleet; whether intervals hold mean, spread, next run and, of the runs, the first."""
    rng = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(size, number)))
    true = MEAN + SPREAD * rng.standard_normal(size)
    draws = [regression(v, rng, noises) for v in true]
    pooled = population([x.mean() for x in draws], [x.std() for x in draws], seed=number)
    following = MEAN + SPREAD * rng.standard_normal()
    return [
        _holds(pooled.mean, MEAN),
        _holds(pooled.spread, SPREAD),
        _holds(pooled.following, following),
        _holds(pooled.runs[0], float(true[0])),
    ]


def whole_way(number: int) -> list[bool]:
    """Do the same with one posterior of five recordings."""
    rng = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(1, number)))
    true = MEAN + SPREAD * rng.standard_normal(5)
    recordings = []
    for k, viscous in enumerate(true):
        q, rows = columns(rng)
        measured = torque(rows, float(viscous), float(rng.uniform(*ROUGH)), rng)
        recordings.append(bf.Recording.from_arrays(TIME, q, measured, name=f"run {k}"))
    motor = bf.Element("motor", inertia=True, coulomb="symmetric", viscous=True)
    joint = bf.Joint([motor], load=bf.Load(first_moment=True), offset=True)
    model = bf.Model(
        joint,
        recordings,
        noise="white",
        vary={"motor.viscous": "recording"},
        sampling={"min_ess": 1000},
    )
    pooled = bf.pool(model, seed=number)
    jointly = pooled.varying[0].jointly
    following = MEAN + SPREAD * rng.standard_normal()
    return [
        _holds(jointly.mean, MEAN),
        _holds(jointly.spread, SPREAD),
        _holds(jointly.following, following),
        _holds(jointly.runs[0], float(true[0])),
    ]


def _holds(interval: Interval, value: float) -> bool:
    return interval.low <= value <= interval.high


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--jointly", action="store_true")
    jointly = parser.parse_args().jointly
    file = HERE / "fleets.json"
    result: dict[str, Any] = json.loads(file.read_text("utf-8")) if file.exists() else {}
    parts: dict[str, Callable[[], list[list[bool]]]] = {
        f"{size} {words} runs, pooled": lambda size=size, noises=noises: [
            separately(n, size, noises) for n in range(200)
        ]
        for words, noises in (("fine", FINE), ("rough", ROUGH))
        for size in (5, 20)
    }
    if jointly:
        parts["5 rough runs, one posterior"] = lambda: [whole_way(n) for n in range(20)]
    for name, run_all in parts.items():
        held = run_all()
        share = np.mean(held, axis=0)
        result[name] = {
            "fleets": len(held),
            **dict(zip(("mean", "spread", "next", "run"), share.tolist(), strict=True)),
        }
        cells = " | ".join(f"{100 * x:.1f} %" for x in share)
        print(f"| {name} | {len(held)} | {cells} |", flush=True)
        file.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
