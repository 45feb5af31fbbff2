"""What a run warns of, found and worded once: its page and the terminal say the same."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.page.facts import DoubtRow, Facts, read_facts
from bayesfric.report.summary.noise import p_words, white_words

# Verdicts on what was held out that warn of nothing.
_FINE = ("covered", "undecided")


@dataclass(frozen=True)
class Alert:
    """One thing to know before using a number.

    Attributes
    ----------
    kind
        What it is about, for programs.
    text
        One sentence without its full stop.
    section
        Of the page, which tells more; empty where none does.
    """

    kind: str
    text: str
    section: str = ""


# How to word each kind of summary["doubts"], which may hold more than "kind" and "parameters".
DOUBTS: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "unexplained": lambda d: (
        f"the model explains only {100 * d['share']:.2g} % of the measured {d['quantity']}, and "
        "what it leaves is no noise: look for somebody's hand on the joint, a wrong column, unit "
        "or sign, or take another mechanism; until then no number here is determined by these data"
    ),
    "feedback": lambda d: (
        f"the torque follows the {d['law']} ({', '.join(d['recordings'])}), as if a controller "
        "made it so: friction, gravity and inertia cannot be told from the controller's; record "
        "a motion along a path of its own"
    ),
    "negative": lambda d: (
        f"least squares finds {_listed(d['values'])}, and nothing that loses energy can be "
        "negative: are the signs of torque and position alike, and does no controller push the "
        "joint along? Until then no number here is determined by these data"
    ),
    "memory": lambda d: (
        f"the residuals ask for noise of order AR({d['asked']}), but that would move the estimates "
        f"by {d['shift']:.2g} of their sds and make the residuals {d['rise']:.3g} times as large: "
        f"it is no noise but something the model lacks; {_taken(d['taken'])}, and the intervals "
        "are too narrow"
    ),
    "noise": lambda d: (
        "these numbers depend on what the noise is taken for"
        + (f": white noise would give {_listed(d['white'])}" if d["white"] else "")
        + (f", and residuals {d['rise']:.3g} times smaller" if d["rise"] > 1.0 + 1e-2 else "")
        + "; a narrower band or a better model may make them agree"
    ),
    "acceleration": lambda d: (
        f"the acceleration is only {d['ratio']:.2g} times as large as its noise (rms), so "
        f"{', '.join(d['parameters'])} come out too small; lower band, or leave lowpass, band and "
        "decimate out to have them chosen"
    ),
}


def _listed(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in values.items())


def _taken(order: int) -> str:
    return f"AR({order}) is taken" if order else "white noise is taken"


def alerts_of(summary: Mapping[str, Any], where: str = "run") -> tuple[Alert, ...]:
    """Gather what a summary warns of; see :func:`alerts`.

    Raises
    ------
    BadInput
        Where the summary, of the run ``where``, lacks something.
    """
    return alerts(read_facts(summary, where), comparison({where: summary}).contested)


def alerts(facts: Facts, contested: Sequence[str]) -> tuple[Alert, ...]:
    """Gather what a run warns of, what makes its numbers unsafe first.

    Parameters
    ----------
    facts
        Of the run.
    contested
        Numbers of which other methods give other values.
    """
    found = [Alert("sampler", text, "sampling") for text in facts.sampler.problems]
    found += (Alert(one.kind, _doubt(one), "noise") for one in facts.doubts)
    if facts.sampler.status != "unusable":  # else there is no posterior to judge the model by
        found += _of_model(facts, contested)
    found += (Alert("warning", text) for text in _gathered(facts))
    if facts.may_be_simulated:
        text = "the recordings may be simulated, not measured: the configuration tells how"
        found.append(Alert("simulated", text))
    return tuple(found)


def _of_model(facts: Facts, contested: Sequence[str]) -> Iterator[Alert]:
    shares = {
        sure: ", ".join(
            f"{one.on} {'explains' if sure else 'may explain'} {100 * one.share:.2g} % of what it "
            "leaves"
            for one in facts.fit.lacks
            if one.sure is sure
        )
        for sure in (True, False)
    }
    if shares[True]:
        text = f"the model lacks something: {shares[True]}; values may be off by more than their ±"
        yield Alert("lacks", text, "prediction")
    if shares[False]:
        text = f"whether the model lacks something cannot be told: {shares[False]}"
        yield Alert("may lack", text, "prediction")
    test = facts.noise.innovation_whiteness
    if test is not None and not test.white:
        told = f" (Ljung-Box {p_words(test.p_value)})" if test.p_value is not None else ""
        words = white_words(test.white)
        text = f"the innovations, which neither model nor noise foretells, {words}{told}"
        yield Alert("not white", text, "noise")
    held_out = facts.validation
    if held_out is not None and held_out.pooled.verdict not in _FINE:
        text = f"held out, {held_out.pooled.verdict}: {held_out.pooled.says}"
        yield Alert("held out", text, "held-out")
    if contested:
        text = (
            "other methods, on the same data, give other values than the posterior for "
            f"{', '.join(contested)}: where the model is not exactly right, no ± holds that"
        )
        yield Alert("methods", text, "methods")


def _doubt(doubt: DoubtRow) -> str:
    """Word a doubt; of a kind that only a newer version knows, its name and parameters."""
    if words := DOUBTS.get(doubt.kind):
        return words(doubt.model_dump())
    return f"{doubt.kind}: {', '.join(doubt.parameters)}"


def _gathered(facts: Facts) -> Iterator[str]:
    """Warnings, one line for what is told of several recordings alike."""
    recordings = facts.fit.recordings
    told: dict[str, list[str]] = {}
    for text in facts.warnings:
        name, colon, rest = text.partition(": ")
        told.setdefault(rest if colon and name in recordings else text, []).append(text)
    for rest, lines in told.items():
        of = f" ({len(lines)} of {len(recordings)} recordings)"
        yield lines[0] if len(lines) == 1 else rest + of
