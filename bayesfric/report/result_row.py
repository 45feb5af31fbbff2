"""One number as every view prints it: tables, page, comparison and figures format this one type."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

from bayesfric.estimates.point_estimate import HALF, Bound
from bayesfric.report.numbers import Medium, finer
from bayesfric.report.summary.derived_quantities import described_as
from bayesfric.report.summary.doubts import bound_hint
from bayesfric.report.summary.record import (
    Described,
    PosteriorRow,
    Readable,
    Summary,
    ValueRow,
    is_skewed,
    sd_towards,
)

Determination = Literal["determined", "undetermined", "bound", "limit", "known"]
# What determined a number, short enough for a column of a paper.
_DETERMINED_BY = {
    "data": "data",
    "weak": "data and prior",
    "limit": "data, on one side",
    "open": "prior",
    "known": "known",
}


@dataclass(frozen=True)
class ResultRow:
    """A parameter or derived quantity by one method, of one run or from elsewhere."""

    # estimate, posterior median or known value; where `status` is `undetermined` one of many that
    # fit as well
    value: float
    # `bound`: an estimate on its bound; `limit`: a posterior that the data push against a bound;
    # `known`: fixed, or a reference
    status: Determination
    # accounts for correlated residuals where `accounts`; `sd_plain` takes them for uncorrelated
    sd: float | None = None
    sd_plain: float | None = None
    accounts: bool = False
    interval: tuple[float, float] | None = None  # of a posterior
    level: float | None = None
    span: tuple[float, float] | None = None  # values that fit as well, of an open estimate
    # of a `limit`: end of the interval away from the bound, and which bound that is and where
    limit: float | None = None
    at_bound: Bound | None = None
    bound: float | None = None
    remark: str = ""
    disagreement: float | None = None  # difference to the first posterior in standard deviations
    converged: bool = True
    doubted: bool = False  # whether its run says that it is doubtful, however narrow
    # whether it is what a posterior has by that name: a total of least squares includes the share
    # of a load-dependent friction, the parameter does not
    alike: bool = True
    # what it is
    name: str = ""
    unit: str = ""
    symbol: str = ""  # LaTeX without dollar signs
    meaning: str = ""
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
    def skewed(self) -> bool:
        """Whether one sd would misname the interval's two sides."""
        return self.interval is not None and is_skewed(self.value, *self.interval)

    @property
    def plain(self) -> bool:
        """Whether its sd takes residuals for uncorrelated."""
        return self.status == "determined" and not self.accounts

    @property
    def by(self) -> str:
        """What determined it: ``data``, ``weak`` (and prior), ``limit``, ``open`` or ``known``."""
        if self.posterior is None:
            return "known"
        if self.status == "determined":
            return "data" if self.posterior.verdict == "data" else "weak"
        return "limit" if self.status == "limit" else "open"

    @property
    def verdict(self) -> str:
        """What determined it, for a column of a paper."""
        if not self.converged:
            return "not converged"
        if self.doubted:
            return "doubtful"
        by = self.by
        if by == "limit" and self.posterior and self.posterior.given_by:
            return "data and prior, on one side"
        return _DETERMINED_BY[by]

    @property
    def in_words(self) -> str:
        """What determined it, for a page."""
        if self.posterior is None or "data and prior" not in self.verdict:
            return self.verdict
        return _weak_by(self.posterior) + self.verdict.removeprefix("data and prior")

    @property
    def hint(self) -> str:
        """What to do about a bound that holds it."""
        return bound_hint(self.name, self.posterior) if self.posterior and self.converged else ""

    def texts(self, medium: Medium, *, sds: bool = True) -> tuple[str, str]:
        """Write value and interval; a skewed one has distances to its ends and no sd.

        Without ``sds`` all have those distances, where the medium writes any.
        """
        if self.limit is not None:
            sign = medium.limits[self.at_bound == "upper"]
            return sign + medium.number(self.limit, 3), medium.none
        if not self.sd:
            return medium.number(self.value, 5), medium.none
        if self.interval is None:
            return medium.value(self.value, self.sd), medium.none
        digits_of = finer(self.value, *self.interval, self.sd)
        interval = medium.interval(*self.interval, digits_of)
        if self.skewed or not sds:
            return medium.ends(self.value, *self.interval, digits_of), interval
        return medium.value(self.value, self.sd), interval

    def shown(self, medium: Medium) -> tuple[str, str]:
        """Write value and interval for a table of one run: an open one has neither."""
        if self.by == "open":
            return f"{medium.none} ({self.verdict})", medium.none
        value, interval = self.texts(medium, sds=medium.sds)
        doubt = " (doubtful)" if self.doubted else ""
        return (value + doubt, interval) if interval == medium.none else (value, interval + doubt)

    def parts(self, medium: Medium) -> Iterator[tuple[str, str]]:
        """Write a comparison's lines, each with its kind; an open one has words only."""
        value, interval = self.texts(medium)
        if self.status not in ("undetermined", "limit"):
            yield "plain" if self.plain else "value", value
        if self.interval is not None and self.sd:
            yield "interval", interval
        if self.disagreement is not None:
            yield "quiet", f"{round(self.disagreement, 1) + 0.0:+.1f} sd"  # no -0.0
        if self.remark:
            yield "open" if self.status == "undetermined" else "quiet", self.remark


def estimate_row(name: str, row: ValueRow, converged: bool = True) -> ResultRow:
    """Judge one number of a point estimate, whose search converged or did not."""
    fields: dict[str, Any] = {"value": row.value, "name": name, **described_as(row)}
    if not converged:
        remark = "the search has not converged"
        return ResultRow(status="undetermined", remark=remark, converged=False, **fields)
    if row.sd is not None and row.determined is not False and row.at_bound is None:
        accounts = row.sd_robust is not None
        fields |= {"sd": row.sd_robust if accounts else row.sd, "sd_plain": row.sd}
        return ResultRow(status="determined", accounts=accounts, **fields)
    # a scaling does not move a zero away from its bound
    if row.span is not None and row.span[0] < row.span[1]:
        low, high = row.span
        remark = f"not determined: {low:.3g} to {high:.3g} fit as well"
        return ResultRow(status="undetermined", span=(low, high), remark=remark, **fields)
    if row.at_bound is not None:
        return ResultRow(status="bound", remark=f"at its {row.at_bound} bound", **fields)
    return ResultRow(status="undetermined", remark="not determined", **fields)


def posterior_row(name: str, row: PosteriorRow, accounts: bool) -> ResultRow:
    """Judge one number of a posterior, as reported.

    ``accounts`` is whether the noise model accounts for correlated residuals.
    """
    reported = row.reported
    fields: dict[str, Any] = {"name": name, **described_as(row), "posterior": row}
    fields |= {"value": row.value, "doubted": row.converged and bool(row.doubted)}
    if not row.converged:
        remark = "the sampling has not converged"
        return ResultRow(status="undetermined", remark=remark, converged=False, **fields)
    if reported.bound is not None:
        remark = f"{'at most' if reported.at_most else 'at least'} {reported.bound:.3g}"
        return ResultRow(
            status="limit", level=row.level, limit=reported.bound, at_bound=row.at_bound,
            bound=row.bound, remark="; ".join([remark] + [_DOUBTFUL] * fields["doubted"]), **fields,
        )  # fmt: skip
    if row.verdict == "prior":
        fields |= {"doubted": False, "remark": "not determined: prior and bounds"}
        return ResultRow(status="undetermined", **fields)
    low, high = reported.interval
    return ResultRow(
        status="determined", sd=reported.sd, sd_plain=None if accounts else row.sd,
        accounts=accounts, interval=(low, high), level=row.level,
        remark="; ".join([_weak_by(row)] * (row.verdict == "weak") + row.remarks), **fields,
    )  # fmt: skip


def known_row(name: str, value: float, described: Described) -> ResultRow:
    """Give a parameter that was fixed."""
    fields: dict[str, Any] = described_as(described)
    return ResultRow(value, "known", remark="taken as known", name=name, **fields)


_DOUBTFUL = "doubtful: not what the data determine, see what the run warns of"


def _weak_by(row: PosteriorRow) -> str:
    """Say what determines a number that the data alone do not."""
    if row.doubted:
        return _DOUBTFUL
    priors = f"determined by the data and your prior on {', '.join(row.given_by)}"
    if row.mirrored is not None:
        seen = f"{100.0 * row.mirrored:.2g} % of the outputs"
        mirrored = f"the data of the other way of driving, assumed to lose as much: {seen} see this"
        return f"{mirrored}; {priors}" if row.given_by else mirrored
    return priors if row.given_by else "data, prior and bounds together"


def result_rows(summary: Readable) -> dict[str, ResultRow]:
    """Judge every parameter and derived quantity of a summary, by name."""
    read = Summary.read(summary)
    return {name: posterior_row(name, row, read.accounts) for name, row in read.rows.items()}
