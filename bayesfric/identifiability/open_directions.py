"""Directions in which the data leave parameters open: which, why, and what would lift them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesfric.base.templates import factor, percent
from bayesfric.identifiability.coverage import Coverage
from bayesfric.identifiability.local import WEAK, LocalInformation, meaning_of
from bayesfric.identifiability.remedies import HARDLY, Remedy, Trial, left_along, remedies
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
    meaning: str  # what can change
    reasons: tuple[str, ...]  # why it does not show
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

    Parameters
    ----------
    local
        The picture by ``free`` parameters.
    free
        Those, in the order of ``local.names``.
    coverage, back
        What the recordings went through, and how often the load drives an element.
    tried
        Recordings that could help.
    told
        Names of parameters whose prior tells them already.
    """
    for number, (row, null) in enumerate(open_rows(local)):
        named = np.flatnonzero(np.abs(row) > (_ROUNDING if null else _NAMED)).tolist()
        in_units = {free[j].name: free[j].unit for j in named if local.shifted[j]}
        exponents = {
            local.labels[j]: float(row[j] * local.units[j])
            if local.shifted[j]
            else float(round(row[j], 9 if null else 3))
            for j in named
        }
        log_sd = np.inf if null else left_along(local.information, row)
        more = bool(np.any(np.abs(row[row != 0.0]) <= _NAMED))
        theory = number < local.from_theory
        yield OpenDirection(
            "null" if null else "weak",
            exponents,
            in_units,
            log_sd,
            meaning_of(exponents, in_units) if null else _weak(exponents, in_units, log_sd, more),
            tuple(_scaling(coverage) if theory else _reasons(free, row, null, coverage, back)),
            remedies(local, row, tried, told),
        )


def _weak(
    exponents: Mapping[str, float], in_units: Mapping[str, str], log_sd: float, more: bool
) -> str:
    """Say what one sd along a weak direction is; ``more`` than what is named changes a little."""
    changes = ", ".join(
        f"{name} {x * log_sd:+.2g} {in_units[name]}".strip()
        if name in in_units
        else f"{name} times {factor(x * log_sd)}"
        for name, x in exponents.items()
    )
    beside = ", with smaller changes of others" if more else ""
    both = "all " if len(exponents) > 1 else ""
    return f"{changes}{beside}, or the other way round: {both}within one sd of the data"


def open_rows(local: LocalInformation) -> Iterator[tuple[Array, bool]]:
    """Null and weak directions in the local units, the largest entry of each one."""
    for row in local.null_rows:
        yield row, True
    d = local.directions
    told = zip(d.singular_values[~d.null], d.rows[~d.null], strict=True)
    for value, row in reversed(list(told)):
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


def _scaling(coverage: Sequence[Coverage]) -> Iterator[str]:
    """Say why leg and gearbox scale together (section 4.2 of the paper)."""
    mass = ", and every recording carries the same known mass, which counts as load"
    yield (
        "the torque at the motor holds only products of these (section 4.2 of the paper): a load "
        "twice as heavy behind a gearbox that passes on twice as much feels the same"
        + mass
        * all(one.added_mass for one in coverage)
    )


def _reasons(
    free: Sequence[Parameter],
    row: Array,
    null: bool,
    coverage: Sequence[Coverage],
    back: Mapping[str, float],
) -> Iterator[str]:
    """Say why a direction is open where theory does not."""
    members = [p for p, x in zip(free, row, strict=True) if abs(x) > _NAMED]
    # what they shape: the terms that they fill, or turn
    shaped = {kind for p in members for kind, _ in p.row.fills}
    rare = [element for element, share in back.items() if share < HARDLY]
    for element in rare:
        yield (
            f"the load {'hardly ever' if back[element] else 'never'} drives {element}: in "
            f"{percent(back[element])} % of the moving outputs at the estimate"
        )
    if rare and len(members) > 1:
        yield f"while the motor always drives, what lies on either side of {rare[0]} acts alike"
    turn, steady = max(one.turn for one in coverage), min(one.steady for one in coverage)
    small = ("gravity" in shaped or any(p.circular for p in members)) and turn < 1.0
    slow = "inertia" in shaped and steady > 0.8
    if small:
        yield f"the load turns through {turn:.2g} rad only"
    if slow:
        yield (
            f"the joint hardly accelerates: in {100.0 * steady:.0f} % of the outputs inertia takes "
            "less than a twentieth of the torque"
        )
    if rare or small or slow:
        return
    if len(members) > 1:
        yield "their effects on the output have nearly the same shape in these recordings"
    elif null:
        yield f"no output changes with {members[0].name} in these recordings"
    else:
        yield "its effect on the output is small beside the noise"
