"""``bayesfric identify``: what the recordings can and cannot tell, before sampling."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.commands.problem import Problem
from bayesfric.estimates.descent import few_threads
from bayesfric.estimates.methods import estimate_by
from bayesfric.identifiability.identify import (
    Identification,
    OpenDirection,
    Prospect,
    identify,
)
from bayesfric.identifiability.known_quantities import speed_term
from bayesfric.identifiability.local import LocalInformation, local_information
from bayesfric.identifiability.plausible import Point, estimate_point, points_around
from bayesfric.identifiability.remedies import HARDLY, WEAK
from bayesfric.identifiability.words import capital, factor
from bayesfric.inference.target import Target

Array = NDArray[np.float64]

# A sd larger than the value itself: the number says nothing, and is not printed.
_NOTHING = 1.0


def identification(
    problem: Problem, *, progress: Callable[[str], None] = lambda _: None
) -> Identification:
    """Look at a problem's likelihood at its estimate and at other points.

    Parameters
    ----------
    problem
        From :func:`bayesfric.commands.problem.read_problem`.
    progress
        Called with the name of each stage before it begins.

    Raises
    ------
    BadInput
        If nothing can be estimated from these recordings.
    """
    target, point, local = local_picture(problem, progress)
    # the seed of the whole analysis, in a stream of its own
    seed = np.random.SeedSequence(problem.config.tables.sampling.seed, spawn_key=(4,))
    with problem.config.named(), few_threads(problem.observations):
        others = points_around(target, point, local, np.random.default_rng(seed))
        speed = speed_term(target, point.parameters, _from_voltage(problem))
        return identify(target, [point, *others], speed=speed)


def local_picture(
    problem: Problem, progress: Callable[[str], None]
) -> tuple[Target, Point, LocalInformation]:
    """Estimate, and look at the likelihood there; see :func:`identification`."""
    with problem.config.named():
        estimate = _estimate(problem, progress)
    progress("identifiability")
    target = problem.target(estimate)
    with problem.config.named(), few_threads(problem.observations):
        point = estimate_point(target, estimate)
        return target, point, local_information(target, point.parameters)


def open_directions(target: Target, parameters: Array) -> list[dict[str, Any]]:
    """List what is open at one point, why, and what would lift it, ready for JSON.

    Parameters
    ----------
    target
        Likelihood, priors and noise.
    parameters
        ``(d,)`` for example the posterior's median, noise scales last.

    Raises
    ------
    BadInput
        If a simulation fails beside the point.
    """
    found = identify(target, [Point("estimate", parameters)])
    return [_direction_record(one) for one in found.directions]


def identify_record(found: Identification, problem: Problem) -> dict[str, Any]:
    """Put an identification into the form that ``--json`` prints; what is infinite is ``None``."""
    values = found.singular_values
    return {
        "config": str(problem.config.path),
        "method": found.method,
        "points": {origin: found.origins.count(origin) for origin in dict.fromkeys(found.origins)},
        "thresholds": {
            "null": found.local.directions.tolerance,
            "weak_log_sd": WEAK,
            "hardly_ever": HARDLY,
        },
        "directions": [_direction_record(one) for one in found.directions],
        "singular_values": {
            "at_estimate": values[0].tolist(),
            "least": values.min(axis=0).tolist(),
            "largest": values.max(axis=0).tolist(),
            "null_at_each_point": list(found.null_counts),
        },
        "combinations": {one.name: _prospect_record(one) for one in found.combinations},
        "parameters": {
            one.name: {
                **_prospect_record(one),
                "prior_sd": _number(one.prior_sd),
                "verdict": one.verdict,
                "on_bound": one.on_bound,
            }
            for one in found.parameters
        },
        "back_driving": {
            one.element: {
                "at_estimate": one.at_estimate,
                "plausible": list(one.plausible),
                "anywhere": list(one.anywhere),
                "meaning": text,
            }
            for one, text in zip(found.back_driving, back_driving_text(found), strict=True)
        },
        "recordings": [
            {
                "name": f.name,
                "outputs": f.outputs,
                "moving": f.moving,
                "load_drives": f.back_driven,
                "at_levels": f.at_levels,
                "piecewise_constant": f.piecewise_constant,
                "turn": f.turn,
                "steady": f.steady,
                "added_mass": f.added_mass,
                "radius": f.radius,
            }
            for f in found.recordings
        ],
        "known_mass": None
        if found.mass is None
        else {
            "exponents_without": found.mass.exponents,
            "determines": list(found.mass.owed),
            "meaning": mass_text(found),
        },
        "voltage": None
        if found.speed is None
        else {
            "recordings": list(found.speed.recordings),
            "same_as_back_emf": list(found.speed.same),
            "explained": found.speed.explained,
            "meaning": speed_text(found),
        },
        "notes": list(found.notes),
    }


def identify_text(found: Identification, problem: Problem) -> Iterator[str]:
    """Word an identification for a person: first what cannot be told, then the tables."""
    null = [one for one in found.directions if one.null]
    weak = [one for one in found.directions if not one.null]
    yield _headline(len(null), len(weak), len(problem.recordings))
    for number, one in enumerate(found.directions, start=1):
        yield ""
        yield f"{number}. {capital(one.meaning)}."
        for reason in one.reasons:
            yield f"   Why: {reason}."
        for remedy in one.remedies:
            yield f"   To lift it: {remedy.text}{_effect(remedy.left)}."
        if not one.remedies:
            yield "   Nothing that was tried lifts it by itself."
        if len(found.origins) > 1:
            yield f"   {_at_points(one, len(found.origins))}"
    texts = [*back_driving_text(found), mass_text(found), speed_text(found)]
    if any(texts):
        yield ""
        yield from (f"{capital(text)}." for text in texts if text)
    for note in found.notes:
        yield f"{capital(note)}."
    told = [one for one in found.combinations if one.data_sd < WEAK * abs(one.value)]
    if told:
        yield ""
        yield "What is determined, whatever else is not"
        yield f"  {'':<30} {'value':>11} {'':<8} {'sd from data':>12}"
        for row in told:
            sd = _relative(row.data_sd, row.value)
            yield f"  {row.name:<30} {_value(row)} {row.unit:<8} {sd:>12}"
    yield ""
    yield "Parameters: sd from the data alone, of the prior, and from both (independent noise)"
    yield (
        f"  {'':<30} {'estimate':>11}   {'data':>9}   {'prior':>9}   {'both':>9}   "
        "verdict to expect"
    )
    for row in found.parameters:
        bound = f", on its {row.on_bound} bound" if row.on_bound else ""
        # shares of a value that means nothing would mean nothing either
        value = row.value if np.isfinite(row.data_sd) else 0.0
        sds = [_relative(sd, value) for sd in (row.data_sd, row.prior_sd, row.expected_sd)]
        yield (
            f"  {row.name:<30} {_value(row)}   {sds[0]:>9}   {sds[1]:>9}   {sds[2]:>9}"
            f"   {row.verdict}{bound}"
        )
    yield ""
    yield "Recordings, at the estimate"
    unit = "rad" if problem.chain.load.motion == "rotary" else "m"
    for f in found.recordings:
        parts = [f"{f.outputs} outputs", f"moves through {f.turn:.3g} {unit}"]
        parts += [f"load drives {n} in {100 * s:.2g} %" for n, s in f.back_driven.items()]
        if f.piecewise_constant:
            parts.append("torque nearly piecewise constant")
        if f.added_mass:
            parts.append(f"with {f.added_mass:g} kg at {f.radius:g} m")
        yield f"  {f.name}: {', '.join(parts)}"
    yield ""
    values = found.singular_values
    yield (
        "Singular values of the Jacobian over its noise, in logarithms (estimate; range over "
        f"{len(values)} points)"
    )
    for at, low, high in zip(values[0], values.min(axis=0), values.max(axis=0), strict=True):
        yield f"  {at:>10.3g}   {low:.3g} to {high:.3g}"


def back_driving_text(found: Identification) -> list[str]:
    """One sentence an element with a load loss: how often the load drives it."""
    texts = []
    verdicts = {one.name: one.verdict for one in found.parameters}
    for one in found.back_driving:
        low, high = one.plausible
        name = f"{one.element}.load_back"
        rests = verdicts.get(name) == "prior"
        prior = f": {name} rests on its prior" if rests else ""
        span = f"{100 * low:.2g} to {100 * high:.2g} % at points that suit the data"
        at = f"{100 * one.at_estimate:.2g} %"
        if high == 0.0:
            texts.append(f"back-driving of {one.element} is never seen{prior}")
        elif low == 0.0 and rests:
            texts.append(
                f"back-driving of {one.element} is never seen for certain, in {at} of the moving "
                f"outputs at the estimate ({span}){prior}"
            )
        elif one.at_estimate < HARDLY:
            texts.append(
                f"back-driving of {one.element} is hardly ever seen, in {at} of the moving "
                f"outputs at the estimate ({span}){prior}"
            )
        else:
            texts.append(f"the load drives {one.element} in {at} of the moving outputs ({span})")
    return texts


def mass_text(found: Identification) -> str:
    """Say what rests on the added mass being known; empty where none is."""
    if found.mass is None:
        return ""
    if not found.mass.owed and any(one.null for one in found.directions):
        return ""
    if not found.mass.owed:
        return "the added mass need not be known: the torque tells all of this without it"
    names = ", ".join(found.mass.owed)
    text = f"the known added mass is what determines {names}"
    if found.mass.exponents and all(abs(x - 1.0) < 1e-5 for x in found.mass.exponents.values()):
        text += (
            f"; were it unknown, {', '.join(found.mass.exponents)} and the mass could all be "
            "multiplied by one factor"
        )
    return text


def speed_text(found: Identification) -> str:
    """Say what a torque from a voltage leaves confounded; empty where none is."""
    if found.speed is None:
        return ""
    told = "its torque comes" if len(found.speed.recordings) == 1 else "their torques come"
    where = f"in {len(found.speed.recordings)} recordings " if len(found.recordings) > 1 else ""
    if found.speed.same:
        names = " and ".join(found.speed.same)
        return (
            f"{where}{told} from a voltage, less the nominal back-EMF kt²/R times speed; that and "
            f"{names} have exactly the same shape, so viscous loss and back-EMF cannot be told "
            f"apart: {names} is viscous loss plus the error of the nominal kt²/R. A measured "
            "current, or kt and R measured at a standstill, would tell them apart"
        )
    return (
        f"{where}{told} from a voltage, less the nominal back-EMF kt²/R times speed; parameters "
        f"make up for {100 * found.speed.explained:.0f} % of an error in it"
    )


def _estimate(problem: Problem, progress: Callable[[str], None]) -> dict[str, float]:
    """Estimate by the method that the likelihood belongs to, load losses held by their priors.

    Where the load never drives the motor, nothing but noise says what is lost when it
    does, and an estimate by the data alone ends in a corner: a gearbox that cannot be driven
    back at all. What the data do tell outweighs these priors by far.
    """
    method = problem.config.tables.likelihood.method
    given = problem.given()
    losses = {
        name: (prior.mean(), prior.sd())
        for element in problem.chain.elements
        for name in (f"{element.name}.load_drive", f"{element.name}.load_back")
        if (prior := problem.priors.get(name)) is not None and not prior.fixed
    }
    finite = {name: pair for name, pair in losses.items() if np.isfinite(pair).all()}
    knowledge = replace(given.knowledge, told={**finite, **given.knowledge.told})
    given = replace(given, knowledge=knowledge)
    found = estimate_by([method], given, progress=lambda name: progress(f"{name} estimate"))
    return dict(found[method].point)


def _headline(null: int, weak: int, recordings: int) -> str:
    these = "this recording" if recordings == 1 else f"these {recordings} recordings together"
    if not null and not weak:
        return f"{capital(these)} can tell every parameter."
    parts = []
    if null:
        parts.append(f"cannot tell {null} {'thing' if null == 1 else 'things'} at all")
    if weak:
        parts.append(f"can tell {weak} {'thing' if weak == 1 else 'things'} only weakly")
    return f"{capital(these)} {' and '.join(parts)}:"


def _direction_record(one: OpenDirection) -> dict[str, Any]:
    return {
        "kind": "null" if one.null else "weak",
        "exponents": one.exponents,
        "in_units": one.shifted,
        "log_sd": _number(one.log_sd),
        "meaning": one.meaning,
        "reasons": list(one.reasons),
        "remedies": [
            {
                "kind": r.kind,
                "text": r.text,
                "parameters": list(r.parameters),
                "log_sd_after": None if r.left is None else _number(r.left),
                "open_after": r.open_after,
            }
            for r in one.remedies
        ],
        "null_at_points": one.null_at,
        "open_at_points": one.open_at,
    }


def _prospect_record(one: Prospect) -> dict[str, Any]:
    return {
        "unit": one.unit,
        "meaning": one.meaning,
        "value": one.value,
        "data_sd": _number(one.data_sd),
        "expected_sd": _number(one.expected_sd),
    }


def _at_points(one: OpenDirection, points: int) -> str:
    if one.null:
        text = f"No output changes along it at {one.null_at} of {points} points looked at"
        weak = one.open_at - one.null_at
        return text + (f", and next to none at {weak} more." if weak else ".")
    return f"It is as weak at {one.open_at} of {points} points looked at."


def _effect(left: float | None) -> str:
    if left is None:
        return ""
    size = f"{100 * left:.2g} %" if left < 0.3 else f"a factor {factor(left)}"
    return f" (simulated: it leaves {size})"


def _value(one: Prospect) -> str:
    """Estimate, unless the data say nothing about it."""
    return f"{one.value:>11.5g}" if np.isfinite(one.data_sd) else f"{'-':>11}"


def _relative(sd: float, value: float) -> str:
    if not np.isfinite(sd):
        return "none"
    share = sd / abs(value) if value else np.inf
    return f"{100 * share:.2g} %" if share < _NOTHING else f"±{sd:.3g}"


def _from_voltage(problem: Problem) -> Sequence[str]:
    """Names of the recordings whose torque was computed from a voltage."""
    names = []
    for r in problem.recordings:
        if any("kt V/R" in step for step in r.steps):
            names.append(r.name)
    return names


def _number(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None
