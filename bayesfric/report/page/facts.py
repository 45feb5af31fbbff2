"""What a run's page needs of ``summary.json`` besides the numbers of the tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ConfigDict, Field, FiniteFloat

from bayesfric.report.summary.read_back import (
    Likelihood,
    Name,
    Noise,
    NotNegative,
    Pair,
    Part,
    Residual,
    Sampler,
    read_as,
)


class Row(Part):
    """How one parameter was sampled, and what stood against its prior."""

    sd: NotNegative
    prior: str = ""
    prior_default: bool = False
    prior_sd: NotNegative | None = None
    rhat: FiniteFloat | None = None
    ess: FiniteFloat | None = None
    white_interval: Pair | None = None
    white_sd: NotNegative | None = None
    prior_sensitivity: FiniteFloat | None = None
    likelihood_sensitivity: FiniteFloat | None = None
    diagnosis: str = ""


class NullDirection(Part):
    """Parameters that change together without changing any predicted torque."""

    parameters: dict[Name, FiniteFloat] = Field(default_factory=dict)
    meaning: str


class RemedyRow(Part):
    """Something to do about an open direction."""

    kind: str = ""
    text: str
    log_sd_after: NotNegative | None = None
    open_after: int | None = None


class OpenDirectionRow(Part):
    """A null or weak direction, with why and what lifts it."""

    kind: str = "null"
    exponents: dict[Name, FiniteFloat] = Field(default_factory=dict)
    meaning: str
    reasons: list[str] = Field(default_factory=list)
    remedies: list[RemedyRow] = Field(default_factory=list)


class Identifiability(Part):
    """What no recording of this kind can tell; ``directions`` is ``None`` in older runs."""

    null_directions: list[NullDirection] = Field(default_factory=list)
    directions: list[OpenDirectionRow] | None = None


class Tried(Part):
    """One order of the noise that was looked at."""

    order: int
    bic: FiniteFloat
    innovation_share: FiniteFloat | None = None
    p_value: FiniteFloat | None = None


class Whiteness(Part):
    """Whether what the noise model does not foretell passes as white."""

    test: str = ""
    p_value: FiniteFloat | None = None
    white: bool


class NoiseFacts(Noise):
    """Noise model and the evidence for it."""

    innovation_lag1: FiniteFloat | None = None
    innovation_whiteness: Whiteness | None = None
    order_chosen_from: list[Tried] = Field(default_factory=list)


class CoverageFacts(Part):
    """How much of what was held out lies in a predictive interval."""

    share: FiniteFloat
    standard_error: NotNegative


class HeldOutFacts(Part):
    """How well one held-out part, or all of them, was predicted."""

    held_out: str = "all together"
    outputs: int
    verdict: str
    says: str
    coverage: dict[str, CoverageFacts]
    residual_rms: NotNegative
    predictive_sd: NotNegative | None = None


class ValidationFacts(Part):
    """What was predicted and not fitted."""

    predictive: str
    unit: str
    parts: dict[Name, HeldOutFacts]
    pooled: HeldOutFacts


class RecordingRow(Part):
    """How one recording was processed, and what is left of it."""

    residual_rms: NotNegative | None = None
    residual_lag1: FiniteFloat | None = None
    outputs: int | None = None
    sampling_rate: FiniteFloat | None = None
    lowpass: FiniteFloat | None = None
    band: FiniteFloat | None = None
    decimate: int | None = None
    n_samples: int | None = None
    n_segments: int | None = None
    dropped_trim: int | None = None
    dropped_excluded: int | None = None
    dropped_dead_zone: int | None = None


class Lack(Part):
    """What the residuals' mean depends on, or may depend on."""

    on: str
    share: NotNegative
    sure: bool = True


class DoubtRow(Part):
    """A reason to doubt some parameters; each kind has further keys of its own."""

    model_config = ConfigDict(frozen=True, extra="allow", strict=True)

    kind: str
    parameters: list[str] = Field(default_factory=list)


class FitFacts(Residual):
    """What the posterior leaves unexplained, recording by recording."""

    quantity: str = "output"
    lacks: list[Lack] = Field(default_factory=list)
    recordings: dict[Name, RecordingRow] = Field(default_factory=dict)


class SamplerFacts(Sampler):
    """How the posterior was sampled."""

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
    coordinates: str = ""
    seconds: FiniteFloat | None = None
    seed: int | None = None


class LikelihoodFacts(Likelihood):
    """What the posterior compares with the recording, and how."""

    evaluation: str = ""


class Facts(Part):
    """The part of a ``summary.json`` that only its page needs."""

    bayesfric: str = ""
    may_be_simulated: bool | None = None
    parameters: dict[Name, Row] = Field(default_factory=dict)
    derived: dict[Name, Row] = Field(default_factory=dict)
    identifiability: Identifiability = Field(default_factory=Identifiability)
    noise: NoiseFacts = Field(default_factory=NoiseFacts)
    fit: FitFacts = Field(default_factory=FitFacts)
    sampler: SamplerFacts = Field(default_factory=SamplerFacts)
    likelihood: LikelihoodFacts = Field(default_factory=LikelihoodFacts)
    validation: ValidationFacts | None = None
    doubts: list[DoubtRow] = Field(default_factory=list)
    warnings: list[str] = Field(default_factory=list)


def read_facts(summary: Mapping[str, Any], where: str) -> Facts:
    """Check what a page needs of a ``summary.json``.

    Raises
    ------
    BadInput
        Naming the key, where something is of another type.
    """
    return read_as(Facts, summary, where)
