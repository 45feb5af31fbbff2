"""Directions in which the data leave parameters open: which, why, and what would lift them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesfric.identifiability.coverage import Coverage
from bayesfric.identifiability.local import WEAK, LocalInformation, NullDirection
from bayesfric.identifiability.remedies import HARDLY, Remedy, Trial, left_along, remedies
from bayesfric.identifiability.sentences import Statement, stated
from bayesfric.mechanism.parameter import Parameter
from bayesfric.recordings.arrays import Array

# Entries of a null direction smaller than this are rounding.
_ROUNDING = 1e-5
# Entries of a weak direction smaller than this share of the largest are not named.
_NAMED = 0.2


@dataclass(frozen=True)
class OpenDirection:
    """Parameters that can change together, and the data say little or nothing."""

    kind: Literal["null", "weak"]  # null where nothing changes at all
    # parameter or alpha and its power of one factor; of those in in_units the change in their unit
    # that goes with the factor e
    exponents: dict[str, float]
    in_units: dict[str, str]  # parameters next to zero, of which no logarithm is taken, and unit
    log_sd: float  # that the data leave of the factor's logarithm; infinite for a null direction
    meaning: Statement  # what can change
    reasons: tuple[Statement, ...]  # why it does not show
    remedies: tuple[Remedy, ...]  # what lifts it

    @property
    def null(self) -> bool:
        """Whether it changes no output at all."""
        return self.kind == "null"


def open_directions(
    local: LocalInformation,
    free: Sequence[Parameter],
    coverage: Sequence[Coverage],
    back: Mapping[str, float],
    tried: Sequence[Trial],
    told: Collection[str],
) -> Iterator[OpenDirection]:
    """List null directions first, then weak ones, the weakest first.

    ``local`` is the picture by ``free`` parameters; ``told`` names those whose prior tells them
    already.
    """
    for number, (row, null) in enumerate(open_rows(local)):
        theory = number < local.from_theory
        least = _ROUNDING if null else _NAMED
        named = [j for j, x in enumerate(row) if abs(x) > least]
        in_units = {free[j].name: free[j].unit for j in named if local.shifted[j]}
        exponents = {
            local.labels[j]: float(row[j] * local.units[j])
            if local.shifted[j]
            else float(round(row[j], 9 if null else 3))
            for j in named
        }
        log_sd = np.inf if null else left_along(local.information, row)
        if not null:
            more = bool(np.any(np.abs(row[row != 0.0]) <= least))
            told = {"exponents": exponents, "in_units": in_units, "log_sd": log_sd, "more": more}
            meaning = stated("meaning", "weak", **told)
        elif in_units and len(exponents) > 1:
            meaning = stated("meaning", "shifts", exponents=exponents, in_units=in_units)
        else:
            meaning = NullDirection(exponents).meaning
        yield OpenDirection(
            "null" if null else "weak",
            exponents,
            in_units,
            log_sd,
            meaning,
            tuple(_reasons(free, row, null, theory, coverage, back)),
            remedies(local, row, tried, told),
        )


def open_rows(local: LocalInformation) -> Iterator[tuple[Array, bool]]:
    """Null and weak directions in the local units, the largest entry of each one."""
    for row in local.null_rows:
        yield row, True
    d = local.directions
    told = [
        (s, row) for s, row, null in zip(d.singular_values, d.rows, d.null, strict=True) if not null
    ]
    for value, row in reversed(told):
        if np.abs(row).max() > WEAK * value:
            sparse = _without(row, local.null_rows)
            yield sparse / sparse[int(np.argmax(np.abs(sparse)))], False


def _without(row: Array, null: Array) -> Array:
    """Take null directions off a direction, which changes no output, to make it short.

    The sum of absolute entries is least where one of them is zero, so those are tried.
    """
    for other in null:
        hits = np.flatnonzero(np.abs(other) > 1e-6)
        choices = [row] + [row - row[c] / other[c] * other for c in hits]
        row = min(choices, key=lambda one: float(np.abs(one).sum()))
    return row


def _reasons(
    free: Sequence[Parameter],
    row: Array,
    null: bool,
    theory: bool,
    coverage: Sequence[Coverage],
    back: Mapping[str, float],
) -> list[Statement]:
    """Say why a direction is open; ``theory`` where it is the scaling of section 4.2."""
    members = [p for p, x in zip(free, row, strict=True) if abs(x) > _NAMED]
    # what they shape: the terms that they fill, or turn
    shaped = {kind for p in members for kind, _ in p.row.fills}
    if theory:
        return [stated("reason", "scaling", with_mass=all(one.added_mass for one in coverage))]
    found = []
    for element, share in back.items():
        if share < HARDLY:
            found.append(stated("reason", "hardly_driven", element=element, share=share))
            if len(members) > 1:
                found.append(stated("reason", "alike", element=element))
    turn = max(one.turn for one in coverage)
    if ("gravity" in shaped or any(p.circular for p in members)) and turn < 1.0:
        found.append(stated("reason", "small_turn", turn=turn))
    steady = min(one.steady for one in coverage)
    if "inertia" in shaped and steady > 0.8:
        found.append(stated("reason", "steady", steady=steady))
    if not found and null and len(members) == 1:
        found.append(stated("reason", "unseen", name=members[0].name))
    elif not found:
        found.append(stated("reason", "same_shape" if len(members) > 1 else "small"))
    return found
