"""``bayesfric identify --advise``: which recording to make next, and the torque to play."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.commands.identify import local_picture
from bayesfric.commands.problem import Problem
from bayesfric.errors import BadInput
from bayesfric.estimates.descent import few_threads
from bayesfric.identifiability.candidates import Candidate
from bayesfric.identifiability.next_recording import Advice, Ranking, Uncertainty, ranking
from bayesfric.identifiability.plausible import points_around
from bayesfric.report.files import write_beside

# Points besides the estimate that everything is simulated at.
_AROUND = 6
# Candidates that the text lists; --json has them all.
_LISTED = 8


def advice_file(name: str, output: Path | None, *, force: bool) -> Path:
    """Settle where the winning excitation goes, before anything is computed.

    Parameters
    ----------
    name
        What is advised on.
    output
        As given; ``advice-<name>.csv`` in the current folder if not.
    force
        Whether a file that is there may be replaced.

    Raises
    ------
    BadInput
        If it is no CSV, or is there already.
    """
    path = output or Path(f"advice-{name}.csv")
    if path.suffix.lower() != ".csv":
        raise BadInput(str(path), "is not named .csv", "name the excitation something.csv")
    if path.exists() and not force:
        raise BadInput(
            str(path), "exists already", "name another file with -o, or replace it with --force"
        )
    return path


def advice(
    problem: Problem, name: str, *, progress: Callable[[str], None] = lambda _: None
) -> Ranking:
    """Rank recordings to make next by what they would leave of one quantity.

    Parameters
    ----------
    problem
        From :func:`bayesfric.commands.problem.read_problem`.
    name
        A free parameter or a derived quantity.
    progress
        Called with the name of each stage before it begins.

    Raises
    ------
    BadInput
        If nothing has that name, it is fixed, or nothing can be estimated here.
    """
    target, point, local = local_picture(problem, progress)
    # the seed of the whole analysis, in a stream of its own
    seed = np.random.SeedSequence(problem.config.tables.sampling.seed, spawn_key=(5,))
    with problem.config.named(), few_threads(problem.observations):
        others = points_around(
            target, point, local, np.random.default_rng(seed), around=_AROUND, prior=0
        )
        options = problem.config.tables.advice
        return ranking(target, [point, *others], local, options, name, progress=progress)


def write_advice(found: Ranking, path: Path, problem: Problem, *, force: bool) -> bool:
    """Write the winning excitation: time and torque, their units in the second line.

    Returns
    -------
    bool
        Whether there was anything worth writing.

    Raises
    ------
    BadInput
        If it cannot be written.
    """
    if not found.worth:
        return False
    table = io.StringIO()
    np.savetxt(
        table,
        found.advices[0].candidate.rows,
        fmt=["%.10g", "%.6g"],
        delimiter=",",
        header=f"time,torque\ns,{_torque_unit(problem)}",
        comments="",
    )
    write_beside({path: table.getvalue()}, replace=force)
    return True


def advice_record(found: Ranking, problem: Problem, written: Path | None) -> dict[str, Any]:
    """Put a ranking into the form that ``--json`` prints; what is infinite is ``None``."""
    return {
        "config": str(problem.config.path),
        "quantity": found.name,
        "unit": found.unit,
        "meaning": found.meaning,
        "value": found.value,
        "determined": bool(np.isfinite(found.now.data_sd)),
        "now": _uncertainty(found.now, found),
        "points": found.points,
        "limits": {
            "torque": found.limits.torque,
            "speed": found.limits.speed,
            "angles": found.limits.angles,
            "duration": found.limits.duration,
            "lag": found.limits.lag,
            "masses": [list(one) for one in found.limits.masses if one[0]],
            "start": found.limits.start,
            "recorded_angles": list(found.limits.seen),
        },
        "verdict": verdict_text(found),
        "candidates": [
            {
                **_candidate(one.candidate, found),
                "rank": rank,
                "after": _uncertainty(one.after, found),
                "load_drives": {
                    name: {"mean": mean, "least": least, "most": most}
                    for name, (mean, least, most) in one.back_driven.items()
                },
                "peak_speed": one.speed,
                "angles": list(one.angles),
                "torque_lowered_to": one.lowered,
                "because_of": one.reason or None,
            }
            for rank, one in enumerate(found.advices, start=1)
        ],
        "dropped": [
            {**_candidate(candidate, found), "reason": reason}
            for candidate, reason in found.dropped
        ],
        "written": str(written) if written else None,
    }


def advice_text(found: Ranking, problem: Problem, written: Path | None) -> Iterator[str]:
    """Word a ranking for a person: what to do first, then the table."""
    unit = f" {found.unit}" if found.unit else ""
    value = f"{found.value:.4g}{unit}" if np.isfinite(found.now.data_sd) else "not determined yet"
    yield f"{found.name} ({found.meaning}): {value}"
    yield f"Now: {_told(found.now, found)}."
    yield verdict_text(found)
    if found.advices:
        best = found.advices[0]
        yield ""
        yield f"Best: {_described(best.candidate, found, problem)}"
        yield f"   It would leave {_told(best.after, found)}."
        yield f"   {_motion(best, problem)}."
    if written:
        yield f"   Torque to play, {best.candidate.duration:.3g} s: {written}"
        if best.candidate.kind == "longer":
            yield "   (as it was measured; record under the same control as before)"
    yield ""
    # one point alone is what is left where no other vector was found that suits the data
    at = f"all {found.points} points" if found.points > 1 else "the estimate, the only point"
    yield f"Limits kept at {at} simulated: {_limits(found, problem)}."
    yield ""
    yield f"  {'':>3} {'sd':>10} {'of value':>9} {'data alone':>11}   recording"
    for rank, one in _listed(found.advices):
        yield (
            f"  {rank:>3} {_sd(one.after.sd):>10} {_relative(one.after, found):>9} "
            f"{_sd(one.after.data_sd):>11}   {_described(one.candidate, found, problem)}"
            f"{_lowered(one)}"
        )
        yield f"  {'':>38}{_motion(one, problem)}"
    if found.advices:
        worst = found.advices[-1].after
        yield f"  {len(found.advices)} were tried; the least useful leaves {_sd(worst.sd)}"
    if found.dropped:
        yield ""
        yield "Left out"
        for candidate, reason in found.dropped:
            yield f"  {_described(candidate, found, problem)}: {reason}"


def verdict_text(found: Ranking) -> str:
    """Say in one sentence whether any candidate is worth making."""
    if not found.advices:
        return "Nothing that was tried can be played within the limits."
    best = found.advices[0].after
    if not np.isfinite(best.sd):
        return (
            f"No recording that was tried determines {found.name}, and no prior confines it: "
            "its sd stays infinite. Give it a prior, or a known mass (masses in [advice])."
        )
    if not found.determined:
        text = (
            f"No recording that was tried determines {found.name}: whatever is recorded, its "
            "posterior will rest on the priors"
        )
        masses = [one for one in found.limits.masses if one[0]]
        return text + ("." if masses else "; a known mass (masses in [advice]) may.")
    if not found.worth:
        return (
            "Nothing that was tried is worth the effort: the best leaves "
            f"{100 * best.sd / found.now.sd:.0f} % of the sd there is."
        )
    if not np.isfinite(best.data_sd):
        return "The best leaves it to the priors where they are narrower than the data are."
    if not np.isfinite(found.now.data_sd):
        return "The recordings there are leave it open; the best of the next would determine it."
    return f"The best of the next would leave {100 * best.sd / found.now.sd:.2g} % of that sd."


def _listed(advices: Sequence[Advice]) -> Iterator[tuple[int, Advice]]:
    """Give the first few with their ranks, then the first of each kind that is not there."""
    seen: set[tuple[str, float]] = set()
    for rank, one in enumerate(advices, start=1):
        kind = (one.candidate.kind, one.candidate.added_mass)
        if rank <= _LISTED or kind not in seen:
            yield rank, one
        seen.add(kind)


def _uncertainty(one: Uncertainty, found: Ranking) -> dict[str, Any]:
    # a share of a value that is not determined would mean nothing
    known = np.isfinite(one.data_sd) and found.value != 0.0
    return {
        "sd": _number(one.sd),
        "relative_sd": _number(one.sd / abs(found.value)) if known else None,
        "data_sd": _number(one.data_sd),
        "least": _number(one.least),
        "most": _number(one.most),
    }


def _candidate(one: Candidate, found: Ranking) -> dict[str, Any]:
    return {
        "kind": one.kind,
        "form": one.form,
        "peak_torque": one.amplitude,
        "duration": one.duration,
        "added_mass": one.added_mass,
        "radius": one.radius,
        "start": one.q0 if one.made is not None else found.limits.start,
    }


def _described(one: Candidate, found: Ranking, problem: Problem) -> str:
    text = f"{one.form}, {one.amplitude:.3g} {_torque_unit(problem)}, {one.duration:.3g} s"
    if one.added_mass:
        at = f" at {one.radius:g} m" if problem.chain.load.motion == "rotary" else ""
        return f"{text}, with {one.added_mass:g} kg{at}"
    return f"{text}, with no mass added" if len(found.limits.masses) > 1 else text


def _motion(one: Advice, problem: Problem) -> str:
    unit = _length_unit(problem)
    low, high = (round(x, 6) + 0.0 for x in one.angles)
    drives = ", ".join(
        f"the load drives {name} in {_share(share)}" for name, share in one.back_driven.items()
    )
    text = (
        f"peak {one.candidate.amplitude:.3g} {_torque_unit(problem)}, {one.speed:.3g} {unit}/s, "
        f"{low:.3g} to {high:.3g} {unit}"
    )
    return f"{text}; {drives}" if drives else text


def _limits(found: Ranking, problem: Problem) -> str:
    unit, limits = _length_unit(problem), found.limits
    angles = (
        f"{limits.angles[0]:.3g} to {limits.angles[1]:.3g} {unit}"
        if limits.angles
        else f"no limit of position (see the range of {unit} used by each)"
    )
    low, high = limits.seen
    seen = ""
    if not low <= limits.start <= high:
        seen = f", where it hangs (the recordings lie between {low:.3g} and {high:.3g})"
    return (
        f"{limits.torque:.3g} {_torque_unit(problem)}, {limits.speed:.3g} {unit}/s, {angles}; "
        f"starting at rest at {limits.start:.3g} {unit}{seen}; [advice] sets them"
    )


def _told(one: Uncertainty, found: Ranking) -> str:
    alone = (
        f"{_sd(one.data_sd)} from recordings alone"
        if np.isfinite(one.data_sd)
        else "recordings alone leave it open"
    )
    unit = f" {found.unit}" if found.unit else ""
    if not np.isfinite(one.sd):
        return f"no sd, {alone}"
    share = f" ({_relative(one, found)})" if np.isfinite(one.data_sd) else ""
    return f"sd {_sd(one.sd)}{unit}{share}, {alone}"


def _lowered(one: Advice) -> str:
    if not one.reason:
        return ""
    return f" (lowered to {100 * one.lowered:.0f} % for {one.reason})"


def _share(one: tuple[float, float, float]) -> str:
    mean, low, high = one
    if high == 0.0:
        return "0 %"
    return f"{100 * mean:.2g} % ({100 * low:.2g} to {100 * high:.2g})"


def _sd(sd: float) -> str:
    return f"{sd:.3g}" if np.isfinite(sd) else "none"


def _relative(one: Uncertainty, found: Ranking) -> str:
    """Share of the value; a value that is not determined has none."""
    if not np.isfinite(one.data_sd) or found.value == 0.0:
        return "-"
    return f"{100 * one.sd / abs(found.value):.2g} %"


def _torque_unit(problem: Problem) -> str:
    return "N m" if problem.chain.motor_motion == "rotary" else "N"


def _length_unit(problem: Problem) -> str:
    return "rad" if problem.chain.load.motion == "rotary" else "m"


def _number(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None
