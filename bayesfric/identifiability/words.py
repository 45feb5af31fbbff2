"""Open directions in words: what can change, and why nothing shows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesfric.identifiability.local import LocalInformation, describe
from bayesfric.identifiability.recording_facts import RecordingFacts
from bayesfric.identifiability.remedies import HARDLY

Array = NDArray[np.float64]

# Entries of a weak direction smaller than this share of the largest are not named.
_NAMED = 0.2
# Entries of a null direction smaller than this are rounding.
_ROUNDING = 1e-5


@dataclass(frozen=True)
class Wording:
    """A direction in words.

    Attributes
    ----------
    exponents
        Parameter or alpha and its power of one factor; of those in ``shifted`` the change in
        their unit that goes with the factor e.
    shifted
        Parameters next to zero, of which no logarithm is taken, and their unit.
    log_sd
        Sd of the logarithm of the factor; infinite for a null direction.
    meaning
        What can change together.
    """

    exponents: dict[str, float]
    shifted: dict[str, str]
    log_sd: float
    meaning: str


def described(
    local: LocalInformation, row: Array, units: Mapping[str, str], *, null: bool, log_sd: float
) -> Wording:
    """Word a direction.

    Parameters
    ----------
    local
        Of the target at the estimate.
    row
        ``(d,)`` the direction in the local units, its largest entry one.
    units
        Unit of each parameter.
    null
        Whether it changes no output.
    log_sd
        What the data leave of it.
    """
    least = _ROUNDING if null else _NAMED
    named = [j for j, x in enumerate(row) if abs(x) > least]
    shifted = {local.labels[j]: units[local.labels[j]] for j in named if local.shifted[j]}
    exponents = {
        local.labels[j]: float(row[j] * local.units[j])
        if local.shifted[j]
        else float(round(row[j], 9 if null else 3))
        for j in named
    }
    if null and not (shifted and len(exponents) > 1):
        return Wording(exponents, shifted, np.inf, describe(local.labels, row).meaning)
    if null:
        terms = [
            f"{label} by {x:+.2g} {shifted[label]}".rstrip()
            if label in shifted
            else f"{label} by k^{x:.3g}"
            for label, x in exponents.items()
        ]
        text = f"changing {', '.join(terms)} together changes no output"
        return Wording(exponents, shifted, np.inf, text)
    terms = [
        f"{label} {x * log_sd:+.2g} {shifted[label]}".rstrip()
        if label in shifted
        else f"{label} times {factor(x * log_sd)}"
        for label, x in exponents.items()
    ]
    whole = "all within" if len(terms) > 1 else "within"
    also = ", with smaller changes of others" if np.any(np.abs(row[row != 0.0]) <= least) else ""
    text = f"{', '.join(terms)}{also}, or the other way round: {whole} one sd of the data"
    return Wording(exponents, shifted, log_sd, text)


def factor(log_sd: float) -> str:
    """Word a change of a logarithm as a factor."""
    if log_sd > np.log(1000.0):
        return "more than 1000"
    return f"{np.exp(log_sd):.2g}" if log_sd > -np.log(1000.0) else "less than 0.001"


def capital(text: str) -> str:
    """Begin a sentence; names of parameters stay as they are written."""
    first = text.split(" ", 1)[0].rstrip(",")
    return text if "." in first or "_" in first else text[:1].upper() + text[1:]


def why(
    local: LocalInformation,
    row: Array,
    null: bool,
    theory: bool,
    facts: Sequence[RecordingFacts],
    shares: Mapping[str, Array],
    plausible: NDArray[np.bool_],
) -> tuple[str, ...]:
    """Say why a direction is open, from what the recordings hold.

    Parameters
    ----------
    local, row, null
        As for :func:`described`.
    theory
        Whether it is the scaling of section 4.2.
    facts
        Of the recordings.
    shares
        By element, how often the load drives it at each point, ``(n_points,)``.
    plausible
        ``(n_points,)`` which of the points suit the data.
    """
    members = {name for name, x in zip(local.names, row, strict=True) if abs(x) > _NAMED}
    if theory:
        text = (
            "the torque at the motor holds only products of these (section 4.2 of the paper): "
            "a load twice as heavy behind a gearbox that passes on twice as much feels the same"
        )
        if all(f.added_mass for f in facts):
            text += ", and every recording carries the same known mass, which counts as load"
        return (text,)
    found = []
    for element, share in shares.items():
        if share[plausible].min() < HARDLY:
            often = "never" if share[plausible].max() == 0.0 else "hardly ever"
            found.append(
                f"the load {often} drives {element}: in {100 * share[0]:.2g} % of the moving "
                f"outputs at the estimate, {_percent(share[plausible])} at others that suit"
            )
            if len(members) > 1:
                found.append(
                    f"while the motor always drives, what lies in front of {element} and what lies "
                    "behind it act alike"
                )
    constant = [f for f in facts if f.piecewise_constant]
    if len(members) > 1 and constant and len(constant) == len(facts):
        found.append(
            f"the torque is {'' if null else 'nearly '}piecewise constant "
            f"({100 * min(f.at_levels or 0.0 for f in constant):.0f} % of the outputs lie at a few "
            "levels); there the equation of motion ties speed, acceleration and gravity together"
        )
    if members & {"load.first_moment", "load.gravity_angle"}:
        turn = max(f.turn for f in facts)
        if turn < 1.0:
            found.append(f"the load turns through {turn:.2g} rad only")
    if any(name.endswith("inertia") for name in members):
        steady = min(f.steady for f in facts)
        if steady > 0.8:
            found.append(
                f"the joint hardly accelerates: in {100 * steady:.0f} % of the outputs inertia "
                "takes less than a twentieth of the torque"
            )
    if not found and null and len(members) == 1:
        (name,) = members
        found.append(f"no output changes with {name} in these recordings")
    elif not found:
        found.append(
            "their effects on the output have nearly the same shape in these recordings"
            if len(members) > 1
            else "its effect on the output is small beside the noise"
        )
    return tuple(found)


def _percent(share: Array) -> str:
    low, high = 100.0 * share.min(), 100.0 * share.max()
    return f"{high:.2g} %" if high - low < 0.01 else f"{low:.2g} to {high:.2g} %"
