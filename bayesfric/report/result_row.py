"""One number as every view prints it: tables, page, comparison and figures format this one type."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

from bayesfric.estimates.point_estimate import HALF
from bayesfric.report.numbers import Medium, finer
from bayesfric.report.summary.derived_quantities import described_as
from bayesfric.report.summary.doubts import bound_hint
from bayesfric.report.summary.record import (
    PosteriorRow,
    Readable,
    Summary,
    ValueRow,
    is_skewed,
    sd_towards,
)
from bayesfric.results.reported import Status

# What rows are, in the order of the tables.
GROUPS = {
    "free": "Quantities seen at the motor (base parameters)",
    "parameter": "Parameters",
    "derived": "Derived quantities",
    "known": "Taken as known",
}
# Statuses that read otherwise than they are called.
_WORDS = {"prior": "needs the prior", "bound": "at its bound", "known": "taken as known"}


@dataclass(frozen=True)
class ResultRow:
    """A parameter or derived quantity by one method, of one run or from elsewhere."""

    name: str
    # estimate, posterior median or known value; where it is `unidentified` one of many that fit
    value: float
    # of `results.reported`; also an estimate on its `bound`, and what was fixed or is a reference
    status: Status | Literal["bound", "known"]
    unit: str = ""
    symbol: str = ""  # LaTeX without dollar signs
    meaning: str = ""
    group: str = "parameter"
    # none where it is `unidentified`
    sd: float | None = None
    interval: tuple[float, float] | None = None
    level: float | None = None
    # of what is known on one side only: the interval's end, and the bound on the other side
    limit: float | None = None
    bound: float | None = None
    at_most: bool = True
    span: tuple[float, float] | None = None  # values that fit as well, of an open estimate
    plain: bool = False  # whether its sd takes residuals for uncorrelated
    converged: bool = True
    # whether it is what a posterior has by that name: a total of least squares includes the share
    # of a load-dependent friction, the parameter does not
    alike: bool = True
    remark: str = ""
    disagreement: float | None = None  # difference to the first posterior in standard deviations
    posterior: PosteriorRow | None = None  # of the file, where it is a posterior's

    def sd_towards(self, other: float) -> float | None:
        """Give the standard deviation that counts on the side of another value, if there is one."""
        if self.limit is not None:
            end = self.limit if (other > self.value) == (self.limit > self.value) else self.bound
            return None if end is None else abs(end - self.value) / HALF
        if self.interval is None or not self.sd:
            return self.sd
        return sd_towards(other, self.value, self.interval, self.sd)

    @property
    def informed(self) -> bool:
        """Whether the data have a say in it."""
        of_prior = self.posterior is not None and self.posterior.verdict == "prior"
        return self.status != "unidentified" and not (of_prior and self.limit is None)

    @property
    def skewed(self) -> bool:
        """Whether one sd would misname the interval's two sides."""
        return self.interval is not None and is_skewed(self.value, *self.interval)

    @property
    def in_words(self) -> str:
        """Its status for print."""
        return _WORDS.get(self.status, self.status) if self.converged else "not converged"

    @property
    def hint(self) -> str:
        """What to do about a bound that holds it."""
        return bound_hint(self.name, self.posterior) if self.posterior and self.converged else ""

    def texts(self, medium: Medium) -> tuple[str, str]:
        """Write value and interval; a skewed one has distances to its ends and no sd."""
        if self.status == "unidentified":
            return medium.none, medium.none
        if self.limit is not None:
            sign = medium.limits[not self.at_most]
            return sign + medium.number(self.limit, 3), medium.none
        if not self.sd:
            return medium.number(self.value, 5), medium.none
        if self.interval is None:
            return medium.value(self.value, self.sd), medium.none
        digits_of = finer(self.value, *self.interval, self.sd)
        interval = medium.interval(*self.interval, digits_of)
        if self.skewed:
            return medium.ends(self.value, *self.interval, digits_of), interval
        return medium.value(self.value, self.sd), interval

    def lines(self, medium: Medium) -> Iterator[str]:
        """Write a comparison's lines: value, interval, distance and remark."""
        value, interval = self.texts(medium)
        if value != medium.none:
            yield value + "†" * self.plain
        if interval != medium.none:
            yield interval
        if self.disagreement is not None:
            yield f"{round(self.disagreement, 1) + 0.0:+.1f} sd"  # no -0.0
        if self.remark:
            yield self.remark


def estimate_row(name: str, row: ValueRow, converged: bool = True) -> ResultRow:
    """Judge one number of a point estimate, whose search converged or did not."""
    fields: dict[str, Any] = {"name": name, "value": row.value, **described_as(row)}
    if not converged:
        fields |= {"converged": False, "remark": "the search has not converged"}
        return ResultRow(status="unidentified", **fields)
    if row.sd is not None and row.determined is not False and row.at_bound is None:
        sd = row.sd if row.sd_robust is None else row.sd_robust
        return ResultRow(status="identified", sd=sd, plain=row.sd_robust is None, **fields)
    # a scaling does not move a zero away from its bound
    if row.span is not None and row.span[0] < row.span[1]:
        low, high = row.span
        fields |= {"span": (low, high)}
        fields["remark"] = f"not determined: {low:.3g} to {high:.3g} fit as well"
        return ResultRow(status="unidentified", **fields)
    if row.at_bound is not None:
        return ResultRow(status="bound", remark=f"at its {row.at_bound} bound", **fields)
    return ResultRow(status="unidentified", remark="not determined", **fields)


def posterior_row(name: str, row: PosteriorRow, summary: Summary) -> ResultRow:
    """Give one number of a posterior, as reported."""
    reported = row.reported
    group = "parameter" if name in summary.parameters else "derived"
    fields: dict[str, Any] = {"name": name, **described_as(row), "value": row.value}
    fields |= {"posterior": row, "converged": row.converged, "status": reported.status}
    fields |= {
        "level": row.level,
        "group": "free" if group == "derived" and row.gauge_free else group,
    }
    if not row.converged:
        return ResultRow(**fields, remark="the sampling has not converged")
    if reported.status == "unidentified":
        return ResultRow(**fields, remark="not determined: prior and bounds")
    remarks = ["doubtful: see what the run warns of"] * (reported.status == "doubtful")
    if reported.bound is not None:
        fields |= {"limit": reported.bound, "bound": row.bound, "at_most": bool(reported.at_most)}
        return ResultRow(**fields, remark="; ".join(remarks))
    remarks += [_prior_in_words(row)] * (reported.status == "prior") + row.remarks
    return ResultRow(
        **fields, sd=reported.sd, interval=(reported.low, reported.high),
        plain=not summary.accounts, remark="; ".join(remarks),
    )  # fmt: skip


def known_row(name: str, row: ValueRow) -> ResultRow:
    """Give a parameter that was fixed."""
    return ResultRow(name, row.value, "known", **described_as(row), remark="taken as known")


def _prior_in_words(row: PosteriorRow) -> str:
    """Say what determines a number that the data alone do not."""
    priors = f"by the data and your prior on {', '.join(row.given_by)}" if row.given_by else ""
    if row.mirrored is None:
        return priors or "data, prior and bounds together"
    seen = f"{100.0 * row.mirrored:.2g} % of the outputs"
    mirrored = f"the data of the other way of driving, assumed to lose as much: {seen} see this"
    return "; ".join(filter(None, [mirrored, priors]))


def result_rows(summary: Readable) -> dict[str, ResultRow]:
    """Give every parameter and derived quantity of a summary, by name."""
    read = Summary.read(summary)
    return {name: posterior_row(name, row, read) for name, row in read.rows.items()}


def table_rows(summary: Readable, run: str = "summary.json") -> list[ResultRow]:
    """List what tables of a run show, group by group; not what depends on the motion.

    ``run`` names it in messages.
    """
    read = Summary.read(summary, run)
    rows = [row for name, row in result_rows(read).items() if not read.rows[name].of_motion]
    rows += [
        ResultRow(name, row.value, "known", **described_as(row), group="known")
        for name, row in read.fixed.items()
    ]
    return sorted(rows, key=lambda row: [*GROUPS].index(row.group))
