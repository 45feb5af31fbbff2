"""What the posterior leaves unexplained, and what was found in what it leaves."""

from __future__ import annotations

from pydantic import Field, FiniteFloat

from bayesfric.report.summary.part import Name, NotNegative, Open, Part, Share
from bayesfric.report.summary.rows import amperes


class RecordingRow(Open):
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


class BackEmfPart(Part):
    """What a nominal back-EMF's error cannot be told from, as ``SpeedTerm`` has it."""

    recordings: list[str]  # whose torque comes from a voltage
    among: int
    nominal: NotNegative
    unit: str
    same_as_back_emf: list[str] = Field(default_factory=list)
    explained: FiniteFloat


class RestsPart(Part):
    """Rests of one recording at which the law would have moved, as ``RestsBeyond`` has them."""

    recording: str
    share: Share
    start: FiniteFloat
    stop: FiniteFloat
    beyond: NotNegative

    @property
    def place(self) -> str:
        """Where it is, in words."""
        return f"{self.recording} at {self.start:.3g} s"


class Residual(Part):
    """What the posterior leaves unexplained, recording by recording."""

    residual_rms: NotNegative | None = None
    explained: FiniteFloat | None = None
    unit: str = ""
    quantity: str = "output"
    # N m/A or N/A, where all that is explained was measured as a current
    torque_constant: FiniteFloat | None = None
    # where a torque comes from a voltage
    back_emf: BackEmfPart | None = None
    # rests that were not used, and that the law contradicts
    rests: list[RestsPart] = Field(default_factory=list)
    integration_steps: int | None = None
    discretisation_error: FiniteFloat | None = None
    recordings: dict[Name, RecordingRow] = Field(default_factory=dict)

    @property
    def current_rms(self) -> float | None:
        """The residuals' root mean square in A, where a current was measured."""
        if self.residual_rms is None or not self.torque_constant:
            return None
        return amperes(self.residual_rms, self.torque_constant)
