"""Test ``terms = "auto"`` on SIMULATED joints whose models lack none to three terms.

``python studies/diagnostics/random_joints.py`` writes recordings as files and adds missing terms.
Writes ``random_joints.json`` and prints its summary; ``--recordings N`` for less,
``--first K`` for others, ``--other`` for other joints and another motion.
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
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(FOLDER.parent / "calibration"))

from bench import Bench, Drive, recorded

from bayesfric import Element, Joint, Load, Model

SEED = 2027
# For joints that no choice depended on.
OTHER_SEED = 4711
# Share of joints with a complete model.
NOTHING = 0.5


@dataclass(frozen=True)
class Missing:
    """A term that a joint may have and its model may lack."""

    name: str  # as in the result
    owner: str
    options: dict[str, Any]
    values: dict[str, tuple[float, float]]  # uniform ranges

    @property
    def key(self) -> str:
        """Return the key of the setting, without numbers of cycles."""
        option, choice = next(iter(self.options.items()))
        return f"{self.owner}.{option}" + ("" if isinstance(choice, tuple) else f".{choice}")


TERMS = (
    Missing("quadratic", "motor", {"quadratic": True}, {"motor.quadratic": (0.004, 0.01)}),
    Missing(
        "power of speed", "motor", {"power": True},
        {"motor.power": (0.15, 0.4), "motor.power_exponent": (0.3, 0.6)},
    ),
    Missing(
        "Stribeck rise", "motor", {"stribeck": True},
        {"motor.stribeck_ratio": (0.4, 1.0), "motor.stribeck_velocity": (0.8, 2.0)},
    ),
    Missing(
        "fall towards standstill", "motor", {"stribeck": "either"},
        {"motor.stribeck_change": (-0.6, -0.3), "motor.stribeck_velocity": (0.8, 2.0)},
    ),
    Missing(
        "viscous by direction", "motor", {"viscous": "by-direction"},
        {"motor.viscous_positive": (0.07, 0.09), "motor.viscous_negative": (0.11, 0.14)},
    ),
    Missing(
        "warming", "motor", {"warming": "viscous"},
        {"motor.viscous_warming": (-0.05, -0.02), "motor.warming_time": (3.0, 10.0)},
    ),
    Missing(
        "cogging", "motor", {"cogging": (7,)},
        {"motor.cogging_sin_7": (0.04, 0.12), "motor.cogging_cos_7": (0.04, 0.12)},
    ),
    Missing(
        "periodic friction", "motor", {"periodic_friction": (5,)},
        {f"motor.periodic_friction_{part}_5": (0.04, 0.1) for part in ("sin", "cos")},
    ),
    Missing("spring", "load", {"spring": True}, {"load.spring": (0.05, 0.2)}),
    Missing(
        "angle of gravity", "load", {"gravity_angle": True}, {"load.gravity_angle": (0.02, 0.06)}
    ),
    Missing("load loss", "motor", {"load_loss": "one"}, {"motor.load": (0.04, 0.12)}),
)  # fmt: skip
# Candidates where the model has load-dependent friction.
LOSSY = (
    *(term for term in TERMS if term.name != "load loss"),
    Missing("load loss by direction", "motor", {"load_direction": True},
            {"motor.load_difference": (0.03, 0.08)}),
    Missing("load loss growing with speed", "motor", {"load_speed": True},
            {"motor.load_speed": (0.01, 0.03)}),
    Missing("load loss growing with load", "motor", {"load_square": True},
            {"motor.load_square": (0.03, 0.08)}),
)  # fmt: skip
BASE = {
    "motor.inertia": (0.03, 0.07),
    "motor.viscous": (0.07, 0.13),
    "motor.coulomb": (0.2, 0.4),
    "load.first_moment": (0.2, 0.4),
    "offset": (-0.05, 0.05),
}


def joint(terms: tuple[Missing, ...], *, lossy: bool) -> Joint:
    """Build a motor that swings a load, with additional terms."""
    loss = "one" if lossy else "none"
    options: dict[str, dict[str, Any]] = {
        "motor": {"inertia": True, "coulomb": "symmetric", "viscous": True, "load_loss": loss},
        "load": {"first_moment": True},
    }
    for term in terms:
        options[term.owner] |= term.options
    return Joint(
        elements=(Element("motor", **options["motor"]),), load=Load(**options["load"]), offset=True
    )


def run_case(number: int, *, other: bool = False) -> dict[str, Any]:
    """Simulate one joint and add what its model lacks; ``other`` selects the second motion."""
    seed = OTHER_SEED if other else SEED
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    count = 0 if rng.random() < NOTHING else int(rng.integers(1, 4))
    lossy = bool(rng.random() < 0.5)
    candidates = LOSSY if lossy else TERMS
    picked: list[Missing] = []
    for k in rng.permutation(len(candidates)).tolist():
        # at most one value of an option
        if len(picked) < count and not any(
            set(candidates[k].options) & set(chosen.options) for chosen in picked
        ):
            picked.append(candidates[k])
    true = joint(tuple(picked), lossy=lossy)
    ranges = (
        BASE
        | {"motor.load": (0.05, 0.15)}
        | {name: pair for term in picked for name, pair in term.values.items()}
    )
    values = {name: float(rng.uniform(*ranges[name])) for name in true.names}
    drive, duration = Drive(3.0, square=float(rng.uniform(0.0, 0.4)), hertz=0.3), 20.0
    if other:
        drive, duration = Drive(2.2, square=0.6, hertz=0.9, lag=0.006), 12.0
    bench = Bench(true, values, (drive,), duration=duration, spread=0.0, colour=0.02)
    with TemporaryDirectory() as folder:
        _, recordings, stuck = recorded(bench, rng, Path(folder))
        start = time.process_time()
        _, added, explanation = Model(joint((), lossy=lossy), recordings).completed()
    return {
        "number": number,
        "lossy": lossy,
        "missing": [term.name for term in picked],
        "keys": [term.key for term in picked],
        "taken": [_key(finding.hint) for finding in added],
        # kinds that this motion does not distinguish from it
        "rivals": [list(finding.rivals) for finding in added],
        "left": [finding.kind for finding in explanation.findings],
        "stuck": stuck,
        "seconds": round(time.process_time() - start, 2),
    }


def _key(setting: str) -> str:
    where, _, value = setting.removeprefix("mechanism.").removeprefix("elements.").partition(" = ")
    if value.startswith("["):
        return where
    return f"{where}." + value.strip('"').replace("true", "True")


def judged(outcomes: list[dict[str, Any]]) -> dict[str, Any]:
    """Count added terms: right, by another value of the option, as a rival, and false."""
    nothing = [outcome for outcome in outcomes if not outcome["missing"]]
    names = {term.key: term.name for term in (*TERMS, *LOSSY)}
    confusion: dict[str, dict[str, int]] = {}
    for outcome in outcomes:
        missing = dict(zip(outcome["keys"], outcome["missing"], strict=True))
        for key, rivals in zip(outcome["taken"], outcome["rivals"], strict=True):
            same_option = [k for k in missing if _option(k) == _option(key)]
            named_rival = [k for k in missing if _option(k).rpartition(".")[2] in rivals]
            if key in missing:
                _count(confusion, missing.pop(key), "found")
            elif same_option:
                _count(confusion, missing.pop(same_option[0]), "by another choice")
            elif named_rival:
                _count(confusion, missing.pop(named_rival[0]), "named beside another")
            else:
                _count(confusion, "not there", names.get(key, key))
        for name in missing.values():
            _count(confusion, name, "missed")

    def counted(column: str) -> int:
        return sum(row.get(column, 0) for row in confusion.values())

    seconds = [outcome["seconds"] for outcome in outcomes]
    return {
        "joints": len(outcomes),
        "terms": sum(len(outcome["missing"]) for outcome in outcomes),
        "found": counted("found"),
        "by_another_choice": counted("by another choice"),
        "named_beside_another": counted("named beside another"),
        "put_in": sum(len(outcome["taken"]) for outcome in outcomes),
        "not_there": sum(confusion.get("not there", {}).values()),
        "nothing_missing": len(nothing),
        "false_finds": sum(bool(outcome["taken"] or outcome["left"]) for outcome in nothing),
        "seconds": [float(np.median(seconds)), max(seconds)],
        "confusion": confusion,
    }


def _option(key: str) -> str:
    """Return owner and option of a key, without the value."""
    return ".".join(key.split(".")[:2])


def _count(table: dict[str, dict[str, int]], row: str, column: str) -> None:
    table.setdefault(row, {}).setdefault(column, 0)
    table[row][column] += 1


def main() -> None:
    """Run all joints and print the summary."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--recordings", type=int, default=400)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--other", action="store_true", help="other joints, another motion")
    parser.add_argument("--to", type=Path)
    options = parser.parse_args()
    path = options.to or FOLDER / f"random_joints{'-other' if options.other else ''}.json"
    numbers = range(options.first, options.first + options.recordings)
    with ProcessPoolExecutor(options.workers) as pool:
        outcomes = list(pool.map(partial(run_case, other=options.other), numbers))
    result = {"judged": judged(outcomes), "recordings": outcomes}
    path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(result["judged"], indent=1))


if __name__ == "__main__":
    main()
