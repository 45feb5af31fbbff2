"""What a ``summary.json`` tells, read back and checked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from bayesfric.complaints import complaint
from bayesfric.errors import BadInput
from bayesfric.estimates.estimate import Kind, Method

# JSON has lists only; a pair is one with a low and a high end.
Pair = Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]
NotNegative = Annotated[FiniteFloat, Field(ge=0.0)]
Bound = Literal["lower", "upper"]
Name = Annotated[str, Field(min_length=1)]
Table = TypeVar("Table", bound=BaseModel)


class Part(BaseModel):
    """A piece of a ``summary.json``."""

    # what other versions add is none of ours; what they lack has a default
    model_config = ConfigDict(frozen=True, extra="ignore", strict=True)


class EstimatedRow(Part):
    """One number of a point estimate; see :class:`bayesfric.estimates.estimate.EstimatedValue`."""

    unit: str
    value: FiniteFloat
    sd: NotNegative | None = None
    sd_robust: NotNegative | None = None
    symbol: str = ""
    meaning: str = ""
    kind: Kind | None = None
    gauge_free: bool | None = None
    determined: bool | None = None
    at_bound: Bound | None = None
    span: Pair | None = None


class EstimateTable(Part):
    """A point estimate."""

    parameters: dict[Name, EstimatedRow]
    converged: bool = True
    residual_rms: NotNegative | None = None
    residual_unit: str = ""
    assumption: str = ""
    notes: list[str] = Field(default_factory=list)


class PosteriorRow(Part):
    """One parameter or derived quantity of a posterior."""

    unit: str
    mean: FiniteFloat
    median: FiniteFloat | None = None
    sd: NotNegative
    interval: Pair
    level: Annotated[FiniteFloat, Field(gt=0.0, lt=1.0)]
    verdict: Literal["data", "weak", "prior"]
    converged: bool | None = None
    symbol: str = ""
    meaning: str = ""
    gauge_free: bool | None = None
    data_sd: NotNegative | None = None
    prior_sd: NotNegative | None = None
    at_bound: Bound | None = None
    bound: FiniteFloat | None = None
    bound_physical: bool | None = None
    period: FiniteFloat | None = None
    doubted: list[str] = Field(default_factory=list)
    undefined_share: Annotated[FiniteFloat, Field(ge=0.0, le=1.0)] | None = None

    @property
    def middle(self) -> float:
        """The number to print: the median, or of files that lack it the mean."""
        return self.mean if self.median is None else self.median


class KnownRow(Part):
    """A parameter that was taken as known."""

    unit: str
    value: FiniteFloat


class ReferenceRow(Part):
    """A value from elsewhere: the manufacturer's, or from CAD."""

    value: FiniteFloat
    unit: str
    sd: NotNegative | None = None
    source: str = "reference"


class Likelihood(Part):
    """What the posterior compares with the recording."""

    method: Literal["input-error", "output-error"] = "input-error"


class Noise(Part):
    """What residuals were taken for."""

    model: str = "white"
    residual_lag1: FiniteFloat | None = None
    accounts_for_correlation: bool | None = None
    autoregression: dict[Name, list[FiniteFloat]] = Field(default_factory=dict)


class Residual(Part):
    """What the posterior leaves unexplained."""

    residual_rms: NotNegative | None = None
    unit: str = ""


class Sampler(Part):
    """Whether the posterior can be relied on."""

    status: str = "reliable"
    problems: list[str] = Field(default_factory=list)


class RunSummary(Part):
    """The part of a ``summary.json`` that comparisons need."""

    parameters: dict[Name, PosteriorRow]
    derived: dict[Name, PosteriorRow] = Field(default_factory=dict)
    fixed: dict[Name, KnownRow] = Field(default_factory=dict)
    estimates: dict[Method, EstimateTable] = Field(default_factory=dict)
    references: dict[Name, ReferenceRow] = Field(default_factory=dict)
    likelihood: Likelihood = Field(default_factory=Likelihood)
    noise: Noise = Field(default_factory=Noise)
    fit: Residual = Field(default_factory=Residual)
    sampler: Sampler = Field(default_factory=Sampler)

    @property
    def accounts(self) -> bool:
        """Whether the intervals account for correlated residuals."""
        return accounts_for_correlation(self.noise, self.likelihood)


def accounts_for_correlation(noise: Noise, likelihood: Likelihood) -> bool:
    """Whether noise is taken for correlated; version 0.1.0 told it by its coefficients only."""
    if noise.accounts_for_correlation is not None:
        return noise.accounts_for_correlation
    return bool(noise.autoregression) or likelihood.method == "output-error"


def read_summary(summary: Mapping[str, Any], where: str) -> RunSummary:
    """Check what a ``summary.json`` holds.

    Parameters
    ----------
    summary
        The file's contents.
    where
        What to call it in complaints.

    Raises
    ------
    BadInput
        Naming the key, where something is missing or of another type.
    """
    return read_as(RunSummary, summary, where)


def read_as(kind: type[Table], summary: Mapping[str, Any], where: str) -> Table:
    """Check another part of a ``summary.json``; see :func:`read_summary`."""
    try:
        return kind.model_validate(summary)
    except ValidationError as error:
        said = complaint(Path(where), error, summary, kind)
        mend = "name a run that 'bayesfric fit' wrote, or fit it again"
        raise BadInput(said.where, said.what, mend) from None
