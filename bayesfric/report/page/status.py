"""The first glance of a run's page: three answers, out of the summary's data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from bayesfric.report.alerts import roll_out_doubt
from bayesfric.report.paper.tables import ParameterRow, ParameterTable, counts
from bayesfric.report.summary.record import OF_MECHANISM, Summary
from bayesfric.report.summary.self_check import found_least, narrow

# `yes`, `partly`, `no`, and `unasked` where nothing tells, or not enough.
Kind = Literal["yes", "partly", "no", "unasked"]

_UNKNOWN = ("doubted", "open", "lost")


@dataclass(frozen=True)
class Glance:
    """What one look must tell; the template ``first_screen.html.j2`` words it."""

    # whether the numbers can be relied on, whether they are known, whether the model is right
    trusted: Kind
    known: Kind
    right: Kind
    # the joint's parameters by what settles them: `data`, `zero` (data, but its interval holds
    # zero), `together`, `limit`, or not: `doubted`, `open`, `lost`
    settled: tuple[str, ...]
    named: dict[str, tuple[str, ...]]  # those parameters, by the same words
    combined: int  # combinations of them that the data determine
    # what speaks against the model: `unexplained`, `memory` (what it leaves is no noise), `error`,
    # `missing` (something else explains the torque), `held-out`, `roll-out`
    against: tuple[str, ...]
    # what may speak against it and cannot be told: `held-out`
    undecided: tuple[str, ...]
    # of the self-check: what its intervals hold least often, and how often
    worst: tuple[str, float] | None = None
    # the same of what only data, prior and bounds determine together, where that is worse
    worst_together: tuple[str, float] | None = None


def glance(table: ParameterTable, summary: Summary) -> Glance:
    """Answer the three questions of a run."""
    by = [(_settled(row), row.name) for row in table.joint]
    settled = tuple(sorted((kind for kind, _ in by), key=_ORDER.index))
    named = {one: tuple(name for kind, name in by if kind == one) for one in dict.fromkeys(settled)}
    combined = counts([r for r in table.rows if r.group == "free"])["data"]
    against, undecided = tuple(_against(summary)), tuple(_undecided(summary))
    right = _right(summary, against, undecided)
    worst, together = found_least(summary), found_least(summary, "weak")
    worse = together if worst and together and together[1] < worst[1] else None
    return Glance(
        _trusted(summary), _known(settled, combined), right, settled, named, combined, against,
        undecided, worst, worse,
    )  # fmt: skip


_ORDER = ("data", "zero", "together", "limit", *_UNKNOWN)


def _settled(row: ParameterRow) -> str:
    if not row.cell.converged:
        return "lost"
    if row.cell.doubted:
        return "doubted"
    return "zero" if row.by == "data" and row.row and row.row.may_be_zero else row.by


def _trusted(summary: Summary) -> Kind:
    status = summary.sampler.status
    if status not in ("reliable", "tentative"):
        return "no"
    return "partly" if status == "tentative" or summary.doubts or narrow(summary) else "yes"


def _known(settled: Sequence[str], combined: int) -> Kind:
    unknown = [one for one in settled if one in _UNKNOWN]
    if all(one == "data" for one in settled):
        return "yes"
    return "no" if len(unknown) == len(settled) and not combined else "partly"


def _against(summary: Summary) -> list[str]:
    found = {
        **{kind: any(doubt.kind == kind for doubt in summary.doubts) for kind in OF_MECHANISM},
        "error": summary.widened,
        "missing": any(one.severity == "doubt" for one in summary.findings),
        "held-out": summary.validation is not None and not summary.validation.pooled.fine,
        "roll-out": summary.rollout is not None and roll_out_doubt(summary.rollout) is not None,
    }
    return [name for name, applies in found.items() if applies]


def _undecided(summary: Summary) -> list[str]:
    found = {
        "held-out": summary.validation is not None
        and summary.validation.pooled.verdict == "undecided",
    }
    return [name for name, applies in found.items() if applies]


def _right(summary: Summary, against: Sequence[str], undecided: Sequence[str]) -> Kind:
    if summary.sampler.status == "unusable":
        return "unasked"  # there is no posterior to judge it by
    if against:
        return "no" if "unexplained" in against else "partly"
    if undecided:
        return "unasked"
    asked = summary.regression is not None and summary.regression.reason is None
    # bands that are wider than any motion say nothing for it
    rolled = summary.rollout is not None and not summary.rollout.pooled.wide
    return "yes" if asked or summary.validation or rolled else "unasked"
