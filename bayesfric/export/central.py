"""Parameter vectors to export: draws, and one that stands for them all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesfric.export.at_joint import Array
from bayesfric.finished import Finished
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import turned
from bayesfric.mechanism.scaling import Scaling, scalings

# Draws that medians are taken of: whatever is exported, the middle is the same.
_MANY = 1000


def open_scalings(found: Finished) -> tuple[Scaling, ...]:
    """Scalings of link and load losses that the run's recordings leave open."""
    named = {name for n in found.summary.identifiability.null_directions for name in n.parameters}
    return tuple(
        one
        for one in scalings(found.joint)
        if {f"{one.element}.alpha_drive", f"{one.element}.alpha_back"} & named
    )


@dataclass(frozen=True, eq=False)
class Vectors:
    """What a run exports.

    Where a scaling is open, every vector is moved along it to where driving and back-driving
    lose the same: no torque changes, and the motor's torque reaches the link whole on average.
    """

    scalings: tuple[Scaling, ...]
    middle: Array  # (d,) medians of the parameters, angles about their mean direction
    draws: Array  # (n, d)


def vectors(found: Finished, most: int, seed: int | None = None) -> Vectors:
    """Take at most so many draws of a run, evenly spread or by chance; and the medians of many."""
    chain, moved = found.joint, open_scalings(found)
    picked = found.picked(most)
    if seed is not None:
        size = min(most, len(found.draws))
        chosen = np.random.default_rng(seed).choice(len(found.draws), size, replace=False)
        picked = found.draws[chosen]
    draws = _evened(found.values(picked), moved)
    many = _evened(found.values(found.picked(_MANY)), moved)
    middle = _evened(_medians(chain, many)[None], moved)[0]
    return Vectors(moved, middle, draws)


def _evened(values: Array, moved: tuple[Scaling, ...]) -> Array:
    for one in moved:
        names = one.chain.names
        drive, back = (values[:, names.index(name)] for name in (one.drive, one.back))
        factor = 1.0 + 0.5 * (drive - back)
        values = np.stack([one.scaled(v, f) for v, f in zip(values, factor, strict=True)])
    return values


def _medians(chain: Joint, draws: Array) -> Array:
    out = np.median(draws, axis=0)
    for k, p in enumerate(chain.parameters):
        if p.circular:
            towards = float(np.angle(np.mean(np.exp(1j * draws[:, k]))))
            out[k] = float(np.median(turned(draws[:, k], towards)))
    return np.asarray(out)
