"""Where a search among shapes starts: at every value that the table says to try.

Far from its own, what shapes a term looks the same at any value, and a search that goes downhill
ends at a limit, where the term does not show at all. Shapes are exponents, Stribeck velocities and
time constants.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle, islice

import numpy as np

from bayesfric.estimates.descent import LocalMinimum, Terms, TorqueProblem, minimise
from bayesfric.estimates.sizes import measured_scales, sizes_at
from bayesfric.recordings.arrays import Array

# Steps with shapes held: the torque is linear then but for products such as rise times loss.
_STEPS = 3
# Of what the tried shapes lead to so many, the lowest, are searched from.
_FOLLOWED = 4
# Ends whose heights differ by less than this share are one.
_SAME = 1e-6


def at_tried_shapes(
    problem: TorqueProblem, terms: Terms, starts: Sequence[Array], rng: np.random.Generator
) -> tuple[list[Array], int]:
    """Move starts to a shape that is tried, and all else to what fits best there.

    With shapes held the torque is linear but for products such as rise times friction, so three
    steps downhill are enough to tell them apart.

    Shapes: starts (d,).
    """
    shapes = _tried(problem)
    if not shapes:
        return list(starts), 0
    count = max(len(starts), *(len(tried) for tried in shapes.values()))
    moved = np.stack(list(islice(cycle(starts), count)))
    for column, tried in shapes.items():
        moved[:, column] = np.resize(rng.permutation(tried), count)
    held = list(shapes)
    ends: list[LocalMinimum] = []
    for x in moved:
        lower, upper = problem.lower.copy(), problem.upper.copy()
        lower[held] = upper[held] = x[held]
        ends.append(minimise(problem, terms, x, lower=lower, upper=upper, iterations=_STEPS))
    apart: list[LocalMinimum] = []
    for one in sorted(ends, key=lambda one: one.squares):
        if not apart or one.squares > (1.0 + _SAME) * apart[-1].squares + problem.rounding:
            apart.append(one)
    return [one.x for one in apart[:_FOLLOWED]], count


def _tried(problem: TorqueProblem) -> dict[int, Array]:
    """Values within the limits for each free shape, by its column."""
    chain = problem.chain
    free = [(k, chain.parameters[chain.names.index(name)]) for k, name in enumerate(problem.free)]
    shaping = [(k, p, p.row.tries) for k, p in free if p.row.tries is not None]
    if not shaping:
        return {}
    scales = measured_scales(chain, problem.observations)
    found = {}
    for k, p, tries in shaping:
        values = np.array(tries(sizes_at(chain, p.owner, scales)))
        found[k] = np.unique(np.clip(values, problem.lower[k], problem.upper[k]))
    return found
