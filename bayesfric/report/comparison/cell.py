"""One number as one column of a comparison tells it, and whether it is determined at all."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

from bayesfric.estimates.point_estimate import HALF, Bound
from bayesfric.mechanism.parameter import turned
from bayesfric.report.numbers import Medium, finer
from bayesfric.report.summary.conclusions import put_reported
from bayesfric.report.summary.record import Readable, Summary
from bayesfric.report.summary.rows import (
    EstimatedRow,
    KnownRow,
    PosteriorRow,
    ReferenceRow,
    is_skewed,
    sd_towards,
)

AnyRow = TypeVar("AnyRow", PosteriorRow, EstimatedRow, KnownRow, ReferenceRow)

Status = Literal["determined", "undetermined", "bound", "limit", "known"]
_NOT_DETERMINED = "not determined"
DOUBTFUL = "doubtful: not what the data determine, see what the run warns of"
# Keys of rows that whole turns move.
_PLACES = {"mean", "median", "value", "bound", "interval", "model_error_interval", "span"}
TOGETHER = "data, prior and bounds together"
NOT_CONVERGED = "the sampling has not converged"
_LOST = "the search has not converged"


def settled_by(row: PosteriorRow) -> str:
    """Say what settles a number that the data alone do not."""
    if row.doubted:
        return DOUBTFUL
    by = f"determined by the data and your prior on {', '.join(row.given_by)}"
    if row.mirrored is not None:
        seen = f"{100.0 * row.mirrored:.2g} % of the outputs"
        told = f"the data of the other way of driving, taken to lose alike: {seen} see this one"
        return f"{told}; {by}" if row.given_by else told
    return by if row.given_by else TOGETHER


@dataclass(frozen=True)
class Cell:
    """One number as one column tells it."""

    # estimate, posterior median or known value; where `status` is `undetermined` one of many that
    # fit as well
    value: float
    # `determined`; `undetermined`: the data leave it open; `bound`: an estimate that stands on a
    # bound; `limit`: a posterior that the data push against a bound; `known`: taken as known, or a
    # reference
    status: Status
    # standard deviation, accounting for correlated residuals where the column does; `None` where
    # there is none
    sd: float | None = None
    # the one for uncorrelated residuals, where the column has both or only that
    sd_plain: float | None = None
    accounts: bool = False  # whether `sd` accounts for correlated residuals
    # of a posterior
    interval: tuple[float, float] | None = None
    level: float | None = None
    # what fits as well, where the number is open and that is known
    span: tuple[float, float] | None = None
    # end of the interval away from the bound, and which bound that is and where, if `status` is
    # `limit`
    limit: float | None = None
    at_bound: Bound | None = None
    bound: float | None = None
    remark: str = ""  # what else to know, in a few words
    # difference to the first posterior in standard deviations; see `comparison`
    disagreement: float | None = None
    # whether there is a posterior, or an estimate, at all; `undetermined` where not
    converged: bool = True
    doubted: bool = False  # whether its run says that it is doubtful, however narrow
    # whether it is what a posterior has by that name: a total of least squares holds what bends
    # the torque, such as a load loss, the parameter does not
    alike: bool = True

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

    def shown(self, medium: Medium, *, sds: bool = True) -> tuple[str, str]:
        """Write value and interval; beside what is skewed, distances to its ends and no sd.

        Without ``sds`` all have those distances, where the medium writes any.
        """
        if self.limit is not None:
            sign = medium.limits[self.at_bound == "upper"]
            return sign + medium.number(self.limit, 3), medium.none
        if not self.sd:
            return medium.number(self.value, 5), medium.none
        if self.interval is None:
            return medium.value(self.value, self.sd), medium.none
        fine = finer(self.value, *self.interval, self.sd)
        interval = medium.interval(*self.interval, fine)
        if self.skewed or not sds:
            return medium.ends(self.value, *self.interval, fine), interval
        return medium.value(self.value, self.sd), interval

    @property
    def plain(self) -> bool:
        """Whether its sd takes residuals for uncorrelated."""
        return self.status == "determined" and not self.accounts

    def parts(self, medium: Medium) -> Iterator[tuple[str, str]]:
        """Write what a table has of it, each with its kind; an open one in words only."""
        value, interval = self.shown(medium)
        if self.status not in ("undetermined", "limit"):
            yield "plain" if self.plain else "value", value
        if self.interval is not None and self.sd:
            yield "interval", interval
        if self.disagreement is not None:
            yield "quiet", f"{round(self.disagreement, 1) + 0.0:+.1f} sd"  # no -0.0
        if self.remark:
            yield "open" if self.status == "undetermined" else "quiet", self.remark


def estimate_cell(row: EstimatedRow, converged: bool = True) -> Cell:
    """Judge one number of a point estimate, whose search ended at a minimum or did not."""
    if not converged:
        return Cell(row.value, "undetermined", remark=_LOST, converged=False)
    if row.sd is None or row.determined is False or row.at_bound is not None:
        # a scaling does not move a zero away from its bound
        span = row.span if row.span is not None and row.span[0] < row.span[1] else None
        if row.at_bound is not None and span is None:
            return Cell(row.value, "bound", remark=f"at its {row.at_bound} bound")
        return left_open(row.value, span)
    if row.sd_robust is None:
        return Cell(row.value, "determined", sd=row.sd, sd_plain=row.sd)
    return Cell(row.value, "determined", sd=row.sd_robust, sd_plain=row.sd, accounts=True)


def left_open(value: float, span: list[float] | None, why: str = "") -> Cell:
    """Say that the data leave a number open, with what fits as well or ``why``."""
    if span is None:
        return Cell(value, "undetermined", remark=_NOT_DETERMINED + why)
    low, high = span
    remark = f"{_NOT_DETERMINED}: {low:.3g} to {high:.3g} fit as well"
    return Cell(value, "undetermined", span=(low, high), remark=remark)


def posterior_cell(row: PosteriorRow, accounts: bool) -> Cell:
    """Judge one number of a posterior, as reported.

    ``accounts`` is whether the noise model accounts for correlated residuals.
    """
    one = row.reported
    assert one is not None  # put_reported concludes of every run
    if not one.how.converged:
        return Cell(row.value, "undetermined", remark=NOT_CONVERGED, converged=False)
    if one.bound is not None:
        words = f"{'at most' if one.at_most else 'at least'} {one.bound:.3g}"
        words += f"; {DOUBTFUL}" if row.doubted else ""
        return Cell(
            row.value, "limit", level=row.level, limit=one.bound, at_bound=row.at_bound,
            bound=row.bound, remark=words, doubted=bool(row.doubted),
        )  # fmt: skip
    if row.verdict == "prior":
        return left_open(row.value, None, ": prior and bounds")
    low, high = one.interval
    return Cell(
        row.value,
        "determined",
        sd=one.sd,
        sd_plain=None if accounts else row.sd,
        accounts=accounts,
        interval=(low, high),
        level=row.level,
        remark="; ".join([settled_by(row)] * (row.verdict == "weak") + row.beside),
        doubted=bool(row.doubted),
    )


def turns_of(runs: Iterable[Summary]) -> dict[str, float]:
    """Give the first value of every angle, next to which others of it are told."""
    rows = ((name, row) for run in runs for name, row in run.parameters.items())
    found: dict[str, float] = {}
    for name, row in rows:
        if row.period is not None:
            found.setdefault(name, row.middle)
    return found


def next_to(row: AnyRow, other: float | None) -> AnyRow:
    """Move all numbers of an angle by whole turns next to another value, if any: 3.13 to -3.13."""
    middle = getattr(row, "middle", None)
    middle = row.value if middle is None else middle
    by = 0.0 if other is None else float(turned(middle, other) - middle)
    return type(row).model_validate(_moved(row.model_dump(), by)) if by else row


def _moved(told: dict[str, Any], by: float) -> dict[str, Any]:
    moved = dict(told)
    for key, x in told.items():
        if key in _PLACES and x is not None:
            moved[key] = [end + by for end in x] if isinstance(x, list) else x + by
        elif key == "reported" and x is not None:
            moved[key] = _moved(x, by)
    return moved


def posterior_cells(summary: Readable) -> dict[str, Cell]:
    """Judge every parameter and derived quantity of a summary."""
    read = put_reported(Summary.read(summary))
    return {name: posterior_cell(row, read.accounts) for name, row in read.rows.items()}
