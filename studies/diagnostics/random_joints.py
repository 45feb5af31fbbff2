"""Does ``terms = "auto"`` find what joints have and their models lack? SIMULATED, from file on.

``python studies/diagnostics/random_joints.py`` makes recordings as files, of joints with one to
three terms that the model lacks and of joints that lack none, and has what is missing put in.
Writes ``random_joints.json`` and prints what the README has; ``--recordings N`` for less,
``--first K`` for others, ``--other`` for other joints that move in another way.
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

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "calibration"))

from bench import Bench, Drive, recorded

from bayesfric import Element, Joint, Load, Model

SEED = 2027
# Of joints that nothing was chosen by.
OTHER_SEED = 4711
# No term is missing in this share of the joints, beside as many with some.
NOTHING = 0.5


@dataclass(frozen=True)
class Missing:
    """A term that a joint may have and its model may lack."""

    name: str  # as in the tables of the README
    owner: str
    options: dict[str, Any]
    values: dict[str, tuple[float, float]]  # uniform ranges

    @property
    def key(self) -> str:
        """What a setting names it by, whatever its numbers of cycles."""
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
# Beside a loss per transmitted torque that the model has.
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
    """Build a motor that swings a load, with some terms more."""
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


def one(number: int, *, other: bool = False) -> dict[str, Any]:
    """Ask of one joint what its model lacks; ``other`` joints move in another way."""
    seed = OTHER_SEED if other else SEED
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    count = 0 if rng.random() < NOTHING else int(rng.integers(1, 4))
    lossy = bool(rng.random() < 0.5)
    known = LOSSY if lossy else TERMS
    picked: list[Missing] = []
    for k in rng.permutation(len(known)).tolist():
        # one choice of an option
        if len(picked) < count and not any(set(known[k].options) & set(o.options) for o in picked):
            picked.append(known[k])
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
        begun = time.process_time()
        _, taken, left = Model(joint((), lossy=lossy), recordings).completed()
    return {
        "number": number,
        "lossy": lossy,
        "missing": [term.name for term in picked],
        "keys": [term.key for term in picked],
        "taken": [_key(f.hint) for f in taken],
        # kinds that this motion does not tell from one
        "rivals": [list(f.rivals) for f in taken],
        "left": [f.kind for f in left.findings],
        "stuck": stuck,
        "seconds": round(time.process_time() - begun, 2),
    }


def _key(setting: str) -> str:
    where, _, value = setting.removeprefix("mechanism.").removeprefix("elements.").partition(" = ")
    if value.startswith("["):
        return where
    return f"{where}." + value.strip('"').replace("true", "True")


def judged(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Count what was put in, what another choice of the same option was, and what was made up."""
    nothing = [one for one in found if not one["missing"]]
    names = {term.key: term.name for term in (*TERMS, *LOSSY)}
    confusion: dict[str, dict[str, int]] = {}
    for one in found:
        left = dict(zip(one["keys"], one["missing"], strict=True))
        for key, rivals in zip(one["taken"], one["rivals"], strict=True):
            kin = [k for k in left if _option(k) == _option(key)]
            near = [k for k in left if _option(k).rpartition(".")[2] in rivals]
            if key in left:
                _count(confusion, left.pop(key), "found")
            elif kin:
                _count(confusion, left.pop(kin[0]), "by another choice")
            elif near:
                _count(confusion, left.pop(near[0]), "named beside another")
            else:
                _count(confusion, "not there", names.get(key, key))
        for name in left.values():
            _count(confusion, name, "missed")

    def counted(column: str) -> int:
        return sum(row.get(column, 0) for row in confusion.values())

    seconds = [one["seconds"] for one in found]
    return {
        "joints": len(found),
        "terms": sum(len(one["missing"]) for one in found),
        "found": counted("found"),
        "by_another_choice": counted("by another choice"),
        "named_beside_another": counted("named beside another"),
        "put_in": sum(len(one["taken"]) for one in found),
        "not_there": sum(confusion.get("not there", {}).values()),
        "nothing_missing": len(nothing),
        "false_finds": sum(bool(one["taken"] or one["left"]) for one in nothing),
        "seconds": [float(np.median(seconds)), max(seconds)],
        "confusion": confusion,
    }


def _option(key: str) -> str:
    """Give owner and option of a key, without the choice."""
    return ".".join(key.split(".")[:2])


def _count(table: dict[str, dict[str, int]], row: str, column: str) -> None:
    table.setdefault(row, {}).setdefault(column, 0)
    table[row][column] += 1


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--recordings", type=int, default=400)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--other", action="store_true", help="other joints, another motion")
    parser.add_argument("--to", type=Path)
    options = parser.parse_args()
    to = options.to or HERE / f"random_joints{'-other' if options.other else ''}.json"
    numbers = range(options.first, options.first + options.recordings)
    with ProcessPoolExecutor(options.workers) as pool:
        found = list(pool.map(partial(one, other=options.other), numbers))
    result = {"judged": judged(found), "recordings": found}
    to.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(result["judged"], indent=1))


if __name__ == "__main__":
    main()
