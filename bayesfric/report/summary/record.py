"""What ``summary.json`` holds: a fit fills it, the file is read back into it, views print it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, FiniteFloat

from bayesfric.base.errors import BadInput
from bayesfric.base.safe_read import read_json
from bayesfric.estimates.point_estimate import Method
from bayesfric.report.summary.rows import (
    EstimatedRow,
    KnownRow,
    Name,
    NotNegative,
    Open,
    Pair,
    Part,
    PosteriorRow,
    ReferenceRow,
    Residual,
    RollOutPart,
    Share,
)
from bayesfric.report.words import clause, line_of, words_of
from bayesfric.results.reported import Status, Verdict, verdict

if TYPE_CHECKING:
    import pandas as pd

GAIN = "drive.gain"
# A summary is a page or two of numbers; anything larger is some other file.
_LARGEST = 20_000_000
# First version whose runs can be read.
_OLDEST = (0, 2)


class EstimateTable(Part):
    """A point estimate."""

    parameters: dict[Name, EstimatedRow]
    converged: bool = True
    point: dict[Name, FiniteFloat] = Field(default_factory=dict)
    residual_rms: NotNegative | None = None
    residual_unit: str = ""
    outputs: int | None = None
    assumption: str = ""
    notes: list[str] = Field(default_factory=list)


class Likelihood(Part):
    """What the posterior compares with the recording, and how."""

    method: Literal["input-error", "output-error"] = "input-error"
    linearisation: FiniteFloat | None = None


class NullDirection(Part):
    """Parameters that change together without changing any predicted torque."""

    parameters: dict[Name, FiniteFloat] = Field(default_factory=dict)
    meaning: str


class RemedyRow(Open):
    """What to do about an open direction."""

    kind: str = ""
    text: str
    log_sd_after: NotNegative | None = None


class OpenDirectionRow(Open):
    """A null or weak direction, with why and what lifts it."""

    kind: str = "null"
    exponents: dict[Name, FiniteFloat] = Field(default_factory=dict)
    meaning: str
    reasons: list[str] = Field(default_factory=list)
    remedies: list[RemedyRow] = Field(default_factory=list)


class Identifiability(Part):
    """What no recording of this kind can determine."""

    null_directions: list[NullDirection] = Field(default_factory=list)
    directions: list[OpenDirectionRow] = Field(default_factory=list)


class Tried(Part):
    """One order of the noise that was tried."""

    order: int
    bic: FiniteFloat


class Whiteness(Part):
    """Whether what the noise model does not predict passes as white."""

    test: str = ""
    p_value: FiniteFloat | None = None
    white: bool


class Noise(Part):
    """The noise model, and the evidence for it."""

    model: str = "white"
    parameters: list[str] = Field(default_factory=list)
    order: int | None = None
    accounts_for_correlation: bool | None = None
    residual_lag1: FiniteFloat | None = None
    innovation_lag1: FiniteFloat | None = None
    innovation_whiteness: Whiteness | None = None
    autoregression: dict[Name, list[FiniteFloat]] = Field(default_factory=dict)
    order_chosen_from: list[Tried] = Field(default_factory=list)
    # partial autocorrelations that priors are around, and how far from these they reach
    memory: list[FiniteFloat] = Field(default_factory=list)
    room: NotNegative = 0.0


class Coverage(Part):
    """How much of what was held out lies in a predictive interval."""

    share: FiniteFloat
    standard_error: NotNegative
    effective_outputs: FiniteFloat | None = None

    @property
    def text(self) -> str:
        """In per cent, with its error."""
        return f"{100 * self.share:.1f} ± {100 * self.standard_error:.1f} %"


class Discrepancy(Part):
    """By how much outputs are off beyond what noise and posterior explain."""

    value: FiniteFloat
    interval: Pair
    level: FiniteFloat = 0.9


class HeldOut(Part):
    """How well one held-out part, or all of them, was predicted."""

    held_out: str = "all together"
    from_: FiniteFloat | None = Field(None, alias="from")
    to: FiniteFloat | None = None
    outputs: int
    coverage: dict[str, Coverage]
    residual_rms: NotNegative
    predictive_sd: NotNegative | None = None
    discrepancy: Discrepancy | None = None
    verdict: str
    says: str

    @property
    def fine(self) -> bool:
        """Whether there is nothing to warn of."""
        return self.verdict in ("covered", "undecided")


class Validation(Part):
    """What was predicted and not fitted."""

    predictive: str = ""
    quantity: str = "output"
    unit: str
    parts: dict[Name, HeldOut]
    pooled: HeldOut


class Message(Open):
    """What to know before using a number; further keys fill the words of its kind."""

    kind: str
    severity: Literal["note", "doubt"] = "doubt"
    parameters: list[str] = Field(default_factory=list)  # which it makes doubtful
    remark: str = ""  # its text, where that is not made of the kind's words

    @property
    def text(self) -> str:
        """One sentence without its full stop."""
        return self.remark or line_of(self.kind, self.model_dump())

    @property
    def clause(self) -> str:
        """What it is, without what to do."""
        return clause(self.kind, self.model_dump())

    @property
    def section(self) -> str:
        """Section of the page that says more; may be empty."""
        if self.kind in ("missing", "put in"):
            return "model-error"
        return words_of(self.kind).section

    @property
    def brief(self) -> str:
        """Line of the short answer; empty for what needs nothing to be done."""
        if self.kind in ("put in", "back-EMF", "simulated"):
            return ""
        return {"sampler": line_of("sampler"), "warning": self.remark.split(";")[0]}.get(
            self.kind, self.text
        )


class FindingRow(Message):
    """What may be missing, as :class:`bayesfric.diagnostics.explanation.Finding` has it."""

    severity: Literal["note", "doubt"]
    p: Share
    hint: str = ""  # line of a configuration that would add it
    statistic: FiniteFloat
    shape: str = ""
    share: NotNegative = 0.0
    rivals: list[str] = Field(default_factory=list)
    moves: dict[Name, FiniteFloat] = Field(default_factory=dict)
    physical: bool = True
    recording: str = ""
    span: Pair | None = None

    def message(self, kind: str, **changes: Any) -> dict[str, Any]:
        """Give a message of another kind about this finding."""
        return self.model_dump(exclude={"remark"}) | {"kind": kind, "what": self.kind} | changes


class RegressionPart(Part):
    """How missing effects were tested."""

    twins: int = 0  # simulated replicates
    asked: int = 0  # kinds of candidates
    reason: Literal["few", "still"] | None = None  # why there was no test
    share: float = 1.0  # of the samples that were used


class SelfCheckRow(Part):
    """How fits of simulated recordings recover one quantity."""

    bias: FiniteFloat  # in posterior sds
    bias_error: NotNegative
    coverage: Share  # of the printed interval
    coverage_error: NotNegative


class SelfCheck(Part):
    """Calibration check: fits of recordings like this one, simulated where the truth is known."""

    asked: int  # recordings to simulate
    made: int  # that could be simulated and fitted
    reason: Literal["likelihood", "rest", "sampling", "still", "few"] | None = None  # why no rows
    rows: dict[Name, SelfCheckRow] = Field(default_factory=dict)
    # what filters, encoder and differentiation leave of the torque, as a share of the noise's
    # variance
    unexplained: NotNegative | None = None
    seconds: NotNegative
    cpu_seconds: NotNegative

    @property
    def why(self) -> str:
        """Why there is none; empty where there is."""
        return line_of(f"no self-check, {self.reason}", self.model_dump()) if self.reason else ""


class ModelError(Part):
    """Whether intervals allow for model discrepancy."""

    shown: bool
    chance: Share = 0.0  # probability that the model lacks any candidate


class FrictionRow(Part):
    """Friction of the whole joint at one constant speed of the motor and one load."""

    speed: FiniteFloat  # signed, of the motor
    quantile: Share  # among recorded speeds of either sign
    # of the load at the motor, without losses; positive against the motion, and zero unless
    # friction depends on it
    load: FiniteFloat = 0.0
    value: FiniteFloat  # posterior median, positive against the motion
    interval: Pair
    status: Status  # `identified`, `doubtful` or `unidentified`


class Friction(Part):
    """Friction of the whole joint at recorded speeds, with model discrepancy.

    Coefficients of friction trade against each other; their sum at a speed that was recorded is
    often known to a per cent.
    """

    unit: str  # N m, or N of a motor that slides
    speed_unit: str
    level: Share
    parameters: list[str] = Field(default_factory=list)  # those sampled
    rows: list[FrictionRow]


class Sampler(Part):
    """How the posterior was sampled, and whether it can be relied on."""

    status: str = "reliable"
    problems: list[str] = Field(default_factory=list)
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


class Summary(Part):
    """Every number of a run, with its messages."""

    bayesfric: str = ""
    parameters: dict[Name, PosteriorRow]
    fixed: dict[Name, KnownRow] = Field(default_factory=dict)
    derived: dict[Name, PosteriorRow] = Field(default_factory=dict)
    estimates: dict[Method, EstimateTable] = Field(default_factory=dict)
    references: dict[Name, ReferenceRow] = Field(default_factory=dict)
    likelihood: Likelihood = Field(default_factory=Likelihood)
    identifiability: Identifiability = Field(default_factory=Identifiability)
    noise: Noise = Field(default_factory=Noise)
    fit: Residual = Field(default_factory=Residual)
    validation: Validation | None = None
    warnings: list[str] = Field(default_factory=list)
    sampler: Sampler = Field(default_factory=Sampler)
    friction: Friction | None = None
    self_check: SelfCheck | None = None
    model_error: ModelError | None = None
    rollout: RollOutPart | None = None
    doubts: list[Message] = Field(default_factory=list)
    findings: list[FindingRow] = Field(default_factory=list)
    taken: list[FindingRow] = Field(default_factory=list)  # by terms = "auto"
    regression: RegressionPart | None = None
    may_be_simulated: bool | None = None
    source: dict[str, Any] | None = None

    @property
    def accounts(self) -> bool:
        """Whether the intervals account for correlated residuals."""
        test = self.noise.innovation_whiteness
        if len(self.noise.order_chosen_from) > 1 and test is not None and test.white:
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
        return (
            self.sampler.status == "tentative" and bool(self.doubts) and not self.sampler.problems
        )

    @property
    def widened(self) -> bool:
        """Whether the intervals to print allow for model discrepancy."""
        return self.model_error is not None and self.model_error.shown

    @property
    def scaled(self) -> bool:
        """Whether the torque's own factor is a parameter."""
        return GAIN in self.parameters or GAIN in self.fixed

    @property
    def assumed_constant(self) -> str:
        """Say which torque constant was assumed, where torque is a current without a gain."""
        constant = self.fit.torque_constant
        if constant is None or self.scaled:
            return ""
        return line_of("constant", {"constant": constant, "unit": self.fit.unit})

    @property
    def reasons(self) -> list[str]:
        """Why numbers are doubtful, each in one clause, for print."""
        return list(dict.fromkeys(doubt.clause for doubt in self.doubts if doubt.parameters))

    @property
    def first(self) -> str:
        """What comes first: a doubt, or what a model lacks that is incomplete; may be empty."""
        if self.doubts:
            return self.doubts[0].clause
        if self.verdict.outcome != "usable":
            return ""
        return clause("missing", self.findings[0].message("missing"))

    @cached_property
    def verdict(self) -> Verdict:
        """Verdict on the run."""
        tested = self.regression
        return verdict(
            converged=not self.sampler.problems and self.sampler.status != "unusable",
            # a model that could not be checked is a separate outcome
            doubts=sum(doubt.kind not in ("few", "still") for doubt in self.doubts),
            doubtful=sum(r.doubtful for n, r in self.rows.items() if not of_noise(n)),
            asked=None if tested is None or tested.reason else tested.asked,
            explained=self.fit.explained,
            lacking=self.widened and bool(self.findings),
        )

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
        return next((row.level for row in self.rows.values()), 0.9)

    def with_rows(self, changes: Mapping[str, Mapping[str, Any]], **update: Any) -> Summary:
        """Change keys of rows, by name of parameter or derived quantity, and other parts."""
        tables = {
            group: {
                name: row.model_copy(update=changes.get(name, {}))
                for name, row in getattr(self, group).items()
            }
            for group in ("parameters", "derived")
        }
        return self.model_copy(update=tables | update)

    @property
    def frame(self) -> pd.DataFrame:
        """Parameters, then derived quantities, as a table with a line for each.

        First what every view prints: value, sd, ends of the interval, status, and the findings that
        move it by more than that. Then how it was made: the posterior's own numbers, whether the
        interval allows for model discrepancy; and the keys of :class:`PosteriorRow`.
        """
        import pandas as pd

        lines = []
        for group in ("parameters", "derived"):
            for name, row in getattr(self, group).items():
                line = {"name": name, "group": group} | dict(row)
                if row.reported is not None:
                    line |= dict(row.reported) | dict(row.reported.how)
                    line["findings"] = ", ".join(row.reported.how.findings)
                line |= row.printed._asdict() | {"posterior": row.middle, "posterior_sd": row.sd}
                line["posterior_low"], line["posterior_high"] = row.interval
                lines.append(line)
        return pd.DataFrame(lines, columns=[*_FRAME])


_FRAME = ("name", "value", "sd", "low", "high", "unit", "status", "findings", "bound", "at_most",
    "group", "symbol", "meaning", "level", "posterior", "posterior_sd", "posterior_low",
    "posterior_high", "widened", "converged", "rhat", "ess", "prior", "prior_sd",
    "data_sd", "contraction", "undefined_share", "gauge_free")  # fmt: skip
Readable = Summary | Mapping[str, Any]


def of_noise(name: str) -> bool:
    """Whether a parameter is one of the noise."""
    return name.partition(".")[0] == "noise"


def read_summary_file(run: Path) -> dict[str, Any]:
    """Read ``summary.json`` of a run directory; ``BadInput`` where there is no complete one."""
    file, again = run / "summary.json", "fit this run again"
    hint = "name a run directory, as 'bayesfric fit' makes it"
    try:
        if not run.is_dir():
            what = "is a file" if run.exists() else "there is no such folder"
            raise BadInput(str(run), what, hint)
        if not file.exists():
            raise BadInput(str(run), "holds no summary.json", hint)
    except OSError as error:  # of its name
        raise BadInput(str(run), f"cannot be read ({error.strerror})", hint) from None
    document = read_json(file, again, largest=_LARGEST)
    if not isinstance(document, dict):
        raise BadInput(str(file), "holds no table of results", again)
    version = re.match(r"(\d{1,4})\.(\d{1,4})", str(document.get("bayesfric")))
    if version and tuple(map(int, version.groups())) < _OLDEST:
        what = f"is a run of bayesfric {version[0]}, which this version cannot read"
        raise BadInput(str(run), what, "fit it again")
    return document
