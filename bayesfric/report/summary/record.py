"""What ``summary.json`` holds: a fit fills it, the file is read back into it, views print it."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from bayesfric.base.atomic_write import jsonable
from bayesfric.base.errors import BadInput
from bayesfric.base.options import configuration_error
from bayesfric.base.safe_read import read_json
from bayesfric.estimates import Method
from bayesfric.estimates.point_estimate import HALF, Bound, Kind
from bayesfric.identifiability.identification import OpenDirection
from bayesfric.identifiability.local import WIDE
from bayesfric.mechanism.quantities import turned
from bayesfric.report.words import clause, line_of, words_of
from bayesfric.results.reported import (
    KNOWN_BY,
    LEVEL,
    Determined,
    Reported,
    Verdict,
    outcome_of,
)

if TYPE_CHECKING:
    import pandas as pd

GAIN = "drive.gain"
# JSON has lists only; a pair is one with a low and a high end.
Pair = Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]
NotNegative = Annotated[FiniteFloat, Field(ge=0.0)]
Share = Annotated[FiniteFloat, Field(ge=0.0, le=1.0)]
Name = Annotated[str, Field(min_length=1)]


class Part(BaseModel):
    """A piece of a summary, checked when read."""

    # keys of other versions are ignored; what they lack has a default
    model_config = ConfigDict(frozen=True, extra="ignore", strict=True)

    @classmethod
    def read(cls, document: Self | Mapping[str, Any], where: str = "summary.json") -> Self:
        """Check what a file, called ``where`` in messages, or a caller holds.

        An instance is returned as it is. BadInput, naming the key, where something is missing or
        of another type.
        """
        if isinstance(document, cls):
            return document
        try:
            # as JSON, of which pydantic also reads tuples, but not "1" as a number
            return cls.model_validate_json(json.dumps(document, default=jsonable))
        except ValidationError as error:
            wrong = configuration_error(f"{where}: ", "configuration", error, document, cls)
            hint = "name a run that 'bayesfric fit' wrote, or fit it again"
            raise BadInput(wrong.where, wrong.problem, hint) from None

    def as_dict(self) -> dict[str, Any]:
        """Give what JSON has: strings, numbers, lists and dicts, and ``None`` for infinity."""
        return dict(jsonable(self.model_dump()))


# -- rows


class Described(Part):
    """What a quantity is; the symbol is LaTeX without dollar signs."""

    unit: str
    symbol: str = ""
    meaning: str = ""


class ValueRow(Described):
    """One number of a point estimate, a fixed parameter, or a value from elsewhere."""

    value: FiniteFloat
    sd: NotNegative | None = None
    # of an estimate, as ``EstimatedValue`` has it
    sd_robust: NotNegative | None = None
    kind: Kind | None = None
    gauge_free: bool | None = None
    determined: bool | None = None
    at_bound: Bound | None = None
    span: Pair | None = None


class ReferenceRow(ValueRow):
    """A value from elsewhere."""

    source: str = "reference"  # such as the manufacturer's, or from CAD


class PosteriorRow(Described):
    """One parameter or derived quantity of a posterior."""

    mean: FiniteFloat
    sd: NotNegative  # if the model is right, as is `interval`
    median: FiniteFloat | None = None
    interval: Pair
    level: Annotated[FiniteFloat, Field(gt=0.0, lt=1.0)]
    rhat: FiniteFloat | None = None
    ess: FiniteFloat | None = None
    converged: bool = True
    prior: str = ""
    prior_default: bool = False
    prior_sd: NotNegative | None = None
    contraction: FiniteFloat | None = None
    data_sd: NotNegative | None = None
    verdict: Determined
    at_bound: Bound | None = None
    bound: FiniteFloat | None = None
    bound_physical: bool | None = None
    period: FiniteFloat | None = None  # of an angle
    of_motion: bool = False  # whether another motion of the same joint has another value
    undefined_share: Share | None = None  # of the draws of a derived quantity
    gauge_free: bool | None = None
    doubted: list[str] = []  # kinds of doubts that concern it
    undoubted: Determined | None = None  # its verdict without them
    given_by: list[str] = []  # parameters whose priors give its scale
    # share of outputs that see its way of driving, where they are too few to determine it and it
    # follows from the other way
    mirrored: Share | None = None
    # with model discrepancy, where the recordings show any
    model_error_interval: Pair | None = None
    model_error_sd: NotNegative | None = None
    # concluded from the rest where it is not given
    reported: Reported = None  # type: ignore[assignment]

    @model_validator(mode="after")
    def _with_reported(self) -> Self:
        if "reported" not in self.model_fields_set:
            self.__dict__["reported"] = self._concluded()
        return self

    def changed(self, update: Mapping[str, Any]) -> Self:
        """Change keys, and what is reported with them."""
        row = self.model_copy(update=update)
        return row.model_copy(update={"reported": row._concluded()})

    def _concluded(self) -> Reported:
        if self.model_error_interval is None or self.model_error_sd is None:
            return self.conclude(self.middle, self.interval, self.sd)
        return self.conclude(self.middle, self.model_error_interval, self.model_error_sd)

    def conclude(self, value: float, interval: Sequence[float], sd: float) -> Reported:
        """Report a number with the status that the row gives it."""
        own_prior = bool(self.given_by) or (bool(self.prior) and not self.prior_default)
        limit, status = self.converged and self._leans("data"), KNOWN_BY[self.verdict]
        if not self.converged:
            status = "unidentified"
        elif self.doubtful:
            status = "doubtful"
        elif limit:
            status = "limit"
        elif self.verdict == "prior" and own_prior:
            status = "prior"
        at_most = self.at_bound == "lower" if limit else None
        bound = interval[1 if at_most else 0] if limit else None
        return Reported(
            value=value, sd=sd, interval=[*interval], status=status, bound=bound, at_most=at_most
        )

    @property
    def middle(self) -> float:
        """The median, or where there is none the mean."""
        return self.mean if self.median is None else self.median

    @property
    def value(self) -> float:
        """The one to print."""
        return self.reported.value

    @property
    def doubtful(self) -> bool:
        """Whether what the data say of it is doubted; of what they leave open they say nothing."""
        return bool(self.doubted) and self.verdict != "prior"

    def _leans(self, *verdicts: Determined) -> bool:
        """Whether data, with priors on a scale if need be, say how far its bound is."""
        known = self.data_sd is not None and self.data_sd < WIDE * (self.prior_sd or math.inf)
        informed = self.verdict in verdicts or known or bool(self.given_by)
        return self.at_bound is not None and informed

    @property
    def held(self) -> bool:
        """Whether the data push it against its bound; a prior alone leans on bounds too."""
        return self._leans("data", "weak")

    @property
    def remarks(self) -> list[str]:
        """What to know of it besides its verdict.

        Zero is of an angle a place like any other; what cannot be negative leans on that bound.
        """
        remarks = []
        if self.at_bound:
            end = {"lower": "down to the least", "upper": "up to the most"}[self.at_bound]
            remarks.append(f"reaches {end} that it may be")
        elif self.period is None and self.reported.low <= 0.0 <= self.reported.high:
            remarks.append("could be zero")
        if self.undefined_share:
            remarks.append(f"undefined in {100 * self.undefined_share:.0f} % of the draws")
        return remarks


def is_skewed(middle: float, low: float, high: float, *, least: float = 0.2) -> bool:
    """Whether one sd would misname an interval's sides, which differ by a share ``least``."""
    down, up = middle - low, high - middle
    return abs(up - down) > least * (up + down)


def sd_towards(other: float, middle: float, interval: Sequence[float], sd: float) -> float:
    """Give the sd that counts on the side of another value: a skewed number has one a side."""
    low, high = interval
    if not is_skewed(middle, low, high):
        return sd
    return abs((high if other > middle else low) - middle) / HALF


AnyRow = TypeVar("AnyRow", PosteriorRow, ValueRow)


def first_angles(tables: Iterable[Mapping[str, PosteriorRow]]) -> dict[str, float]:
    """Give the first value of every angle, by name: :func:`unwrapped` puts others next to it."""
    angles: dict[str, float] = {}
    for table in tables:
        for name, row in table.items():
            if row.period is not None:
                angles.setdefault(name, row.middle)
    return angles


def unwrapped(row: AnyRow, other: float | None) -> AnyRow:
    """Move all numbers of an angle by whole turns next to another value, if any: 3.13 to -3.13."""
    middle = row.middle if isinstance(row, PosteriorRow) else row.value
    by = 0.0 if other is None else float(turned(middle, other) - middle)
    return type(row).model_validate(_moved(row.model_dump(), by)) if by else row


def _moved(row: dict[str, Any], by: float) -> dict[str, Any]:
    places = {"mean", "median", "value", "bound", "interval", "model_error_interval", "span"}
    moved = dict(row)
    for key, x in row.items():
        if key in places and x is not None:
            moved[key] = [end + by for end in x] if isinstance(x, list) else x + by
        elif key == "reported":
            moved[key] = _moved(x, by)
    return moved


def of_noise(name: str) -> bool:
    """Whether a parameter is one of the noise."""
    return name.partition(".")[0] == "noise"


# -- messages


class Message(Part):
    """What to know before using a number; further keys fill the words of its kind.

    A finding has those of :class:`bayesfric.diagnostics.explanation.Finding`.
    """

    model_config = ConfigDict(frozen=True, extra="allow", strict=True)

    kind: str
    severity: Literal["note", "doubt"] = "doubt"
    parameters: list[str] = []  # which it makes doubtful
    remark: str = ""  # its text, where that is not made of the kind's words

    def of_kind(self, kind: str, **changes: Any) -> Message:
        """Say something else about the same finding."""
        values = self.model_dump(exclude={"remark"}) | {"what": self.kind}
        return Message.model_validate({**values, "kind": kind, **changes})

    @property
    def details(self) -> dict[str, Any]:
        """Further keys."""
        return self.model_extra or {}

    @property
    def text(self) -> str:
        """One sentence without its full stop."""
        return self.remark or line_of(self.kind, self.model_dump())

    @property
    def section(self) -> str:
        """Section of the page that says more; may be empty."""
        about = words_of(self.kind).get("section", "")
        return "model-error" if self.kind in ("missing", "put in") else about

    @property
    def brief(self) -> str:
        """Line of the short answer; empty for what needs nothing to be done."""
        short = {"sampler": line_of("sampler"), "warning": self.remark.split(";")[0]}
        short |= dict.fromkeys(("put in", "back-EMF", "simulated"), "")
        return short.get(self.kind, self.text)


# -- estimates, noise and likelihood


class EstimateTable(Part):
    """A point estimate."""

    parameters: dict[Name, ValueRow]
    converged: bool = True
    point: dict[Name, FiniteFloat] = {}
    residual_rms: NotNegative | None = None
    residual_unit: str = ""
    outputs: int | None = None
    assumption: str = ""
    notes: list[str] = []


class Identifiability(Part):
    """What no recording of this kind can determine."""

    null_directions: list[dict[str, Any]] = []  # exponents of `parameters`, and the `meaning`
    directions: list[OpenDirection] = []


class Noise(Part):
    """The noise model, and the evidence for it."""

    model: str = "white"
    parameters: list[str] = []
    order: int | None = None
    accounts_for_correlation: bool | None = None
    residual_lag1: FiniteFloat | None = None
    innovation_lag1: FiniteFloat | None = None
    innovation_whiteness: dict[str, Any] | None = None  # `test`, its `p_value`, and if `white`
    autoregression: dict[Name, list[FiniteFloat]] = {}
    order_chosen_from: list[dict[str, Any]] = []  # evidence for each order
    # partial autocorrelations that priors are around, and how far from these they reach
    memory: list[FiniteFloat] = []
    room: NotNegative = 0.0


class Residual(Part):
    """What the posterior leaves unexplained, recording by recording."""

    residual_rms: NotNegative | None = None
    measured_rms: NotNegative | None = None  # of the torque itself
    # share of the torque's variance, of which an offset explains nothing
    explained: Annotated[FiniteFloat, Field(le=1.0)] | None = None
    unit: str = ""
    quantity: str = "output"
    # N m/A or N/A, where all that is explained was measured as a current
    torque_constant: FiniteFloat | None = None
    back_emf: dict[str, Any] | None = None  # where a torque comes from a voltage
    rests: list[dict[str, Any]] = []  # standstills that were not used
    recordings: dict[Name, dict[str, Any]] = {}  # how each was processed, and what is left of it


class Sampler(Part):
    """How the posterior was sampled, and whether it can be relied on."""

    status: str = "reliable"
    problems: list[str] = []
    draws: int | None = None
    walkers: int | None = None
    ensembles: int | None = None
    warmup: int | None = None
    steps: int | None = None
    thin: int | None = None
    tau: FiniteFloat | None = None
    min_ess: FiniteFloat | None = None
    max_rhat: FiniteFloat | None = None
    acceptance: FiniteFloat | None = None
    stuck_walkers: int | None = None
    not_finite: int | None = None
    not_finite_share: FiniteFloat | None = None
    seconds: FiniteFloat | None = None
    seed: int | None = None


# -- the whole


class Summary(Part):
    """Every number of a run, with its messages."""

    bayesfric: str = ""
    parameters: dict[Name, PosteriorRow]
    fixed: dict[Name, ValueRow] = {}
    derived: dict[Name, PosteriorRow] = {}
    estimates: dict[Method, EstimateTable] = {}
    references: dict[Name, ReferenceRow] = {}
    likelihood: dict[str, Any] = {"method": "input-error"}  # and what its `linearisation` changes
    identifiability: Identifiability = Identifiability()
    noise: Noise = Noise()
    fit: Residual = Residual()
    # what only templates print, as `parts` makes it
    validation: dict[str, Any] | None = None
    friction: dict[str, Any] | None = None
    self_check: dict[str, Any] | None = None
    model_error: dict[str, Any] | None = None  # whether `shown`, and the `chance` of any candidate
    # simulated replicates (`twins`), kinds of candidates (`asked`), the `reason` for no test, and
    # the `share` of the samples that were used
    regression: dict[str, Any] | None = None
    warnings: list[str] = []
    sampler: Sampler = Sampler()
    rollout: dict[str, Any] | None = None
    doubts: list[Message] = []
    findings: list[Message] = []
    taken: list[Message] = []  # by terms = "auto"
    may_be_simulated: bool | None = None
    source: dict[str, Any] | None = None

    @property
    def accounts(self) -> bool:
        """Whether the intervals account for correlated residuals."""
        test = self.noise.innovation_whiteness
        if len(self.noise.order_chosen_from) > 1 and test is not None and test["white"]:
            # white noise that was tested, not assumed, leaves nothing to account for
            return True
        return bool(self.noise.accounts_for_correlation)

    @property
    def gauge_free(self) -> dict[str, PosteriorRow]:
        """Derived quantities that no scaling of load and gearbox, and no other motion, changes."""
        return {
            name: row for name, row in self.derived.items() if row.gauge_free and not row.of_motion
        }

    @property
    def only_doubted(self) -> bool:
        """Whether the sampling converged, and something else makes the run tentative."""
        doubted = bool(self.doubts) and not self.sampler.problems
        return doubted and self.sampler.status == "tentative"

    @property
    def widened(self) -> bool:
        """Whether the intervals to print allow for model discrepancy."""
        return bool(self.model_error and self.model_error["shown"])

    @property
    def assumed_constant(self) -> str:
        """Say which torque constant was assumed, where torque is a current without a gain."""
        constant = self.fit.torque_constant
        if constant is None or GAIN in self.parameters or GAIN in self.fixed:
            return ""
        return line_of("constant", {"constant": constant, "unit": self.fit.unit})

    @property
    def reasons(self) -> list[str]:
        """Why numbers are doubtful, each in one clause, for print."""
        return list(
            dict.fromkeys(
                clause(doubt.kind, doubt.model_dump()) for doubt in self.doubts if doubt.parameters
            )
        )

    @property
    def first(self) -> str:
        """What comes first: a doubt, or what a model lacks that is incomplete; may be empty."""
        lacking = self.findings[:1] if self.verdict.outcome == "usable" else []
        for message in self.doubts[:1] or [finding.of_kind("missing") for finding in lacking]:
            return clause(message.kind, message.model_dump())
        return ""

    @property
    def verdict(self) -> Verdict:
        """Verdict on the run."""
        tested = self.regression if self.regression and not self.regression["reason"] else None
        outcome = outcome_of(
            converged=not self.sampler.problems and self.sampler.status != "unusable",
            # a model that could not be checked is a separate outcome
            doubted=any(doubt.kind not in ("few", "still") for doubt in self.doubts),
            lacking=self.widened and bool(self.findings),
            tested=tested is not None,
        )
        doubtful = sum(r.doubtful for n, r in self.rows.items() if not of_noise(n))
        left, total = self.fit.residual_rms, self.fit.measured_rms
        share = left / total if left is not None and total else None
        return Verdict(outcome, share, tested["asked"] if tested else 0, doubtful)

    @property
    def rows(self) -> dict[str, PosteriorRow]:
        """Derived quantities and parameters by name."""
        return {**self.derived, **self.parameters}

    @property
    def joint(self) -> dict[str, PosteriorRow]:
        """Sampled parameters of the joint: without those of the noise."""
        return {n: row for n, row in self.parameters.items() if not of_noise(n)}

    @property
    def level(self) -> float:
        """Share of the posterior that its intervals hold."""
        return next((row.level for row in self.rows.values()), LEVEL)

    def with_rows(self, changes: Mapping[str, Mapping[str, Any]], **update: Any) -> Self:
        """Change keys of rows, by name of parameter or derived quantity, and other parts."""
        for group in ("parameters", "derived"):
            rows = getattr(self, group)
            new = {name: rows[name].changed(changes[name]) for name in rows if name in changes}
            update[group] = rows | new
        return self.model_copy(update=update)

    @property
    def frame(self) -> pd.DataFrame:
        """Parameters, then derived quantities: what every view prints, and how it was made."""
        import pandas as pd

        return pd.DataFrame(self.lines, columns=[*COLUMNS])

    @property
    def lines(self) -> list[dict[str, Any]]:
        """Lines of :attr:`frame`; those of ``summary.csv`` are its :data:`COLUMNS`."""
        lines = []
        for group in ("parameters", "derived"):
            for name, row in getattr(self, group).items():
                line = {"name": name, "group": group} | dict(row) | dict(row.reported)
                line |= {"low": row.reported.low, "high": row.reported.high}
                line["findings"] = ", ".join(row.doubted if row.doubtful else ())
                line |= {"posterior": row.middle, "posterior_sd": row.sd}
                line["posterior_low"], line["posterior_high"] = row.interval
                line["widened"] = row.model_error_interval is not None
                lines.append(line)
        return lines


COLUMNS = ("name", "value", "sd", "low", "high", "unit", "status", "findings", "bound", "at_most",
    "group", "symbol", "meaning", "level", "posterior", "posterior_sd", "posterior_low",
    "posterior_high", "widened", "converged", "rhat", "ess", "prior", "prior_sd",
    "data_sd", "contraction", "undefined_share", "gauge_free")  # fmt: skip
Readable = Summary | Mapping[str, Any]


def read_summary_file(run: Path) -> dict[str, Any]:
    """Read ``summary.json`` of a run directory; ``BadInput`` where there is no complete one."""
    file, again = run / "summary.json", "fit this run again"
    hint = "name a run directory, as 'bayesfric fit' makes it"
    try:
        if not run.is_dir():
            problem = "is a file" if run.exists() else "there is no such folder"
            raise BadInput(str(run), problem, hint)
        if not file.exists():
            raise BadInput(str(run), "holds no summary.json", hint)
    except OSError as error:  # of its name
        raise BadInput(str(run), f"cannot be read ({error.strerror})", hint) from None
    document = read_json(file, again)
    if not isinstance(document, dict):
        raise BadInput(str(file), "holds no table of results", again)
    # runs of 0.1 hold other numbers
    if version := re.match(r"0\.[01]\b", str(document.get("bayesfric"))):
        problem = f"is a run of bayesfric {version[0]}, which this version cannot read"
        raise BadInput(str(run), problem, "fit it again")
    return document
