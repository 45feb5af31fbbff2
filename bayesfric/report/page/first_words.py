"""The first screen of a run's page: what is known, what is not and why, and what to do next."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from bayesfric.identifiability.sentences import capital, factor
from bayesfric.report.page.facts import Facts, OpenDirectionRow, RemedyRow
from bayesfric.report.paper.methods_text import listed
from bayesfric.report.paper.tables import ParameterRow, ParameterTable, counts
from bayesfric.report.summary.read_back import accounts_for_correlation

_COUNTS = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
# Lines of the list of what is known; the rest is in the table.
_MOST = 8


@dataclass(frozen=True)
class OpenGroup:
    """Parameters that the data leave open for one reason.

    ``why`` holds whole sentences.
    """

    names: tuple[str, ...]
    why: tuple[str, ...]


@dataclass(frozen=True)
class NextStep:
    """One thing to do, and what it was found to do."""

    text: str
    effect: str


@dataclass(frozen=True)
class FirstWords:
    """Everything on the first screen.

    Attributes
    ----------
    headline
        Sentences on how much the data determined.
    known
        Rows the data determine, those of data, prior and bounds together among them.
    more
        Number of such rows that are left to the table.
    limits
        Rows that the data bound on one side.
    open
        What they leave open, by reason.
    answer, trust
        Whether the sampling can be trusted, and why.
    steps
        What to do next, the best first; empty where nothing is known to help.
    otherwise
        A sentence in place of, or behind, the steps.
    command
        What it tells to run; empty where there is nothing to run.
    judged
        Whether there is a posterior to judge the model by.
    """

    headline: tuple[str, ...]
    known: tuple[ParameterRow, ...]
    more: int
    limits: tuple[ParameterRow, ...]
    open: tuple[OpenGroup, ...]
    answer: str
    trust: str
    steps: tuple[NextStep, ...]
    otherwise: str
    command: str
    judged: bool


def first_words(table: ParameterTable, facts: Facts) -> FirstWords:
    """Put a run's findings into plain words."""
    joint = table.joint
    combined = [r for r in table.rows if r.group == "free"]
    known = [r for r in [*combined, *joint] if r.cell.status == "determined"]
    if any(r.cell.status == "undetermined" for r in joint):
        # what data alone determine says more than what they share with the prior
        known.sort(key=lambda r: r.row is not None and r.row.verdict != "data")
    else:  # then the joint's own parameters are what is asked for
        known.sort(key=lambda r: r.group != "parameter")
    judged = all(r.cell.converged for r in joint)
    steps = (*_without_recording(facts), *_steps(facts.identifiability.directions or []))
    if not joint:
        otherwise, command = "", ""
    elif not judged:
        steps = ()
        otherwise = "None before the sampling agrees with itself: mend what is said of it above."
        command = ""
    else:
        otherwise, command = _otherwise(joint, facts, bool(steps)), _command(joint)
    return FirstWords(
        tuple(_headline(joint, combined)),
        tuple(known[:_MOST]),
        max(0, len(known) - _MOST),
        tuple(r for r in [*joint, *combined] if r.cell.status == "limit"),
        tuple(_groups(joint, combined, facts)),
        *_trust(facts),
        steps,
        otherwise,
        command,
        judged,
    )


def _headline(joint: Sequence[ParameterRow], combined: Sequence[ParameterRow]) -> Iterator[str]:
    sound = [r for r in joint if r.cell.converged]
    if joint and not sound:
        yield "The sampling failed: this run says nothing of the parameters."
        return
    n, found = len(joint), counts(sound)
    if len(sound) < n:
        lost = [r.name for r in joint if not r.cell.converged]
        yield f"Not converged, and without a number here: {listed(lost)}."
    if n and found.data == n:
        yield f"The data determine all {_count(n)} parameters of the joint."
    elif n:
        parts = [f"the data determine {_count(found.data)} by themselves"]
        if found.together:
            parts.append(f"{_count(found.together)} together with priors and bounds")
        if found.limits:
            parts.append(f"bound {_count(found.limits)} on one side only")
        if found.open:
            parts.append(f"leave {_count(found.open)} open")
        yield f"Of the joint's {_count(n)} sampled parameters, {listed(parts)}."
    told = counts(combined).data
    if told and found.data < n:
        what = "combination" if told == 1 else "combinations"
        yield (
            f"They do determine {_count(told)} {what} of them: what the motor feels, whatever "
            "the scale of leg and gearbox."
        )


def _groups(
    joint: Sequence[ParameterRow], combined: Sequence[ParameterRow], facts: Facts
) -> Iterator[OpenGroup]:
    """Give each open parameter to the first direction that holds it."""
    left = [r.name for r in [*joint, *combined] if r.cell.status == "undetermined"]
    lost = {r.name for r in [*joint, *combined] if not r.cell.converged}
    if lost:
        yield OpenGroup(
            tuple(name for name in left if name in lost),
            (
                "The ensembles disagree, or stand still: what they make together is no posterior. "
                "What the recording can tell of these is not known before they agree.",
            ),
        )
        left = [name for name in left if name not in lost]
    seen: list[tuple[dict[str, float], str, list[str]]] = []
    if facts.identifiability.directions is not None:
        for one in facts.identifiability.directions:
            # a weak direction holds a little of everything; its words name what changes most
            named = {
                n: x for n, x in one.exponents.items() if one.kind == "null" or n in one.meaning
            }
            seen.append((named, one.meaning, one.reasons))
    else:
        for direction in facts.identifiability.null_directions:
            seen.append((direction.parameters, direction.meaning, []))
    for exponents, meaning, reasons in seen:
        members = [name for name in left if name in exponents or _alpha(name) in exponents]
        if members:
            left = [name for name in left if name not in members]
            why = (
                _sentence(_without_names(meaning, exponents, members)),
                *(_sentence(f"because {text}") for text in reasons),
            )
            yield OpenGroup(tuple(members), why)
    if left:
        yield OpenGroup(
            tuple(left),
            (
                "The data alone would leave these more than twice as wide as they are: what is "
                "shown of them is their prior, and the bounds that other parameters set.",
            ),
        )


def _without_names(meaning: str, exponents: dict[str, float], members: list[str]) -> str:
    """Take a leading list of the names off a meaning: they stand above it."""
    listed = f"{', '.join(exponents)} "
    if not meaning.startswith(listed):
        return meaning
    others = [name for name in exponents if name not in members]
    start = f"together with {', '.join(others)} these " if others else "these "
    return start + meaning.removeprefix(listed)


def _alpha(name: str) -> str:
    """Name the torque factor that a load loss sets: mu is open where alpha is."""
    element, _, quantity = name.partition(".")
    return f"{element}.alpha_{quantity.removeprefix('load_')}" if "load_" in quantity else name


def _trust(facts: Facts) -> tuple[str, str]:
    s = facts.sampler
    if s.status == "tentative" and facts.doubts and not s.problems:
        return (
            "Not yet: it is tentative.",
            "The sampling has converged, but model, noise or recording are not what they are taken "
            "for: the warnings say why, and what to do.",
        )
    if s.status == "tentative":
        return (
            "Not yet: it is tentative.",
            "Treat every number here as provisional: the ensembles are too short, or do not "
            "agree well enough. What is not converged by itself has no number. Fit again with "
            "more steps.",
        )
    if s.status != "reliable":
        return (
            f"No: it is {s.status}.",
            "The ensembles disagree, or a parameter never moved: what has not converged by itself "
            "has no number here, and the rest is provisional.",
        )
    many = f"{_count(s.ensembles)} independent ensembles" if s.ensembles else "independent runs"
    said = f"{capital(many)} of walkers agree"
    if s.max_rhat is not None and s.min_ess is not None:
        said += (
            f" (nested R-hat {s.max_rhat:.4f}, 1.01 allowed) and hold at least "
            f"{spaced(s.min_ess)} independent draws of every parameter"
        )
    return "Yes, it is reliable.", said + "."


def _without_recording(facts: Facts) -> Iterator[NextStep]:
    """Name what can be done before anything is recorded."""
    if on := [lack.on for lack in facts.fit.lacks if lack.sure]:
        yield NextStep(
            f"Look for what the model lacks: what it leaves depends on {listed(on)}",
            "Needs no recording: the figure of residuals shows where. It may be a quadratic or "
            "Stribeck loss, losses by direction or by load, or gravity. Neither more data nor "
            "another noise model mends it.",
        )
    white = facts.noise.innovation_whiteness
    # where the order was chosen, auto itself found that no memory helps
    chosen = facts.noise.order_chosen_from
    accounts = accounts_for_correlation(facts.noise, facts.likelihood)
    if not accounts and white is not None and not white.white and not chosen:
        yield NextStep(
            'Fit again with model = "auto" under [noise]',
            "Needs no recording; the intervals then account for residuals that have a memory.",
        )


def _steps(directions: Sequence[OpenDirectionRow]) -> Iterator[NextStep]:
    """List remedies, those that leave fewest directions open first, each one once."""
    found: dict[str, tuple[RemedyRow, list[int]]] = {}
    for number, direction in enumerate(directions):
        for remedy in direction.remedies:
            found.setdefault(remedy.text, (remedy, []))[1].append(number)

    def order(one: tuple[RemedyRow, list[int]]) -> tuple[int, int, int]:
        remedy, lifted = one
        after = len(directions) if remedy.open_after is None else remedy.open_after
        # an experiment was simulated; a value from elsewhere has to be believed
        return after, -len(lifted), remedy.kind == "known value"

    for remedy, lifted in sorted(found.values(), key=order):
        of = f"{_count(len(lifted))} of {_count(len(directions))} open directions"
        effect = "lifts the open direction" if len(directions) == 1 else f"lifts {of}"
        if remedy.log_sd_after is not None:
            left = remedy.log_sd_after
            size = f"{100 * left:.2g} %" if left < 0.3 else f"a factor {factor(left)}"
            effect += f"; simulated beforehand, what is open would be known to {size}"
        yield NextStep(capital(remedy.text), capital(effect) + ".")


def _otherwise(joint: Sequence[ParameterRow], facts: Facts, steps: bool) -> str:
    command = "the command below"
    best = "ranks experiments and writes the best as a file to play"
    if steps:
        return f"For a parameter of your choice, {command} {best}."
    if all(r.cell.status in ("determined", "limit") for r in joint):
        return f"Nothing is open. To know a parameter better, {command} {best}."
    if facts.identifiability.directions is None:
        return (
            f"Which experiments would determine what is open was not looked for: {command} {best}."
        )
    return f"Nothing that was tried lifts what is open by itself: {command} {best}."


def _command(joint: Sequence[ParameterRow]) -> str:
    """Ask for advice on what is open, or else on what is known least."""

    def known(row: ParameterRow) -> tuple[bool, float]:
        spread = row.row.sd / abs(row.row.mean) if row.row and row.row.mean else 0.0
        return row.cell.status != "undetermined", -spread

    # a constant in the measurement is asked for last
    asked = [row for row in joint if row.name.partition(".")[0] != "offset"] or joint
    name = min(asked, key=known).name
    return f"bayesfric identify YOUR-CONFIGURATION.toml --advise {shlex.quote(name)}"


def _count(n: int) -> str:
    return _COUNTS[n] if n < len(_COUNTS) else str(n)


def spaced(x: float) -> str:
    """Write a whole number with narrow spaces between thousands."""
    return f"{x:,.0f}".replace(",", "\u202f")


def _sentence(text: str) -> str:
    return capital(text).removesuffix(".") + "."
