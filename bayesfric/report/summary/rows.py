"""Pieces of ``summary.json``, checked when read and written as set: rows and recordings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from bayesfric.base.errors import BadInput
from bayesfric.base.options import configuration_error
from bayesfric.estimates.point_estimate import HALF, Bound, Kind
from bayesfric.mechanism.quantities import turned
from bayesfric.results.reported import Determined, Reported, Spread
from bayesfric.results.roll_out import Input, RollOut, tells_nothing
from bayesfric.results.roll_out import Part as RecordingPart

# JSON has lists only; a pair is one with a low and a high end.
Pair = Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]
NotNegative = Annotated[FiniteFloat, Field(ge=0.0)]
Share = Annotated[FiniteFloat, Field(ge=0.0, le=1.0)]
Name = Annotated[str, Field(min_length=1)]
# Ends of the interval whose distances from the median differ by more than this are skewed.
_SKEWED = 0.2
# Share inside 90 % bands below which they are called too narrow. Positions within a second of each
# other are nearly one, so that few recordings may well leave their bands for a tenth of the time.
FEWEST = 0.8


class Part(BaseModel):
    """A piece of a summary. What is not set is not written: a run read and written is the same."""

    # keys of other versions are ignored; what they lack has a default
    model_config = ConfigDict(frozen=True, extra="ignore", strict=True, populate_by_name=True)

    @classmethod
    def read(cls, document: Self | Mapping[str, Any], where: str = "summary.json") -> Self:
        """Check what a file, called ``where`` in messages, or a caller holds.

        An instance is returned as it is. BadInput, naming the key, where something is missing or
        of another type.
        """
        if isinstance(document, cls):
            return document
        try:
            return cls.model_validate(document)
        except ValidationError as error:
            wrong = configuration_error(f"{where}: ", "configuration", error, document, cls)
            hint = "name a run that 'bayesfric fit' wrote, or fit it again"
            raise BadInput(wrong.where, wrong.what, hint) from None

    def as_dict(self) -> dict[str, Any]:
        """Give strings, numbers, lists and dicts, as JSON has them."""
        return self.model_dump(mode="json", exclude_unset=True, by_alias=True)


class Open(Part):
    """A piece that keeps further keys."""

    model_config = ConfigDict(frozen=True, extra="allow", strict=True)


class Described(Part):
    """What a quantity is; the symbol is LaTeX without dollar signs."""

    unit: str
    symbol: str = ""
    meaning: str = ""


def is_skewed(middle: float, low: float, high: float) -> bool:
    """Whether one sd would misname an interval's two sides."""
    down, up = middle - low, high - middle
    return abs(up - down) > _SKEWED * (up + down)


def sd_towards(other: float, middle: float, interval: Sequence[float], sd: float) -> float:
    """Give the sd that counts on the side of another value: a skewed number has one a side."""
    low, high = interval
    if not is_skewed(middle, low, high):
        return sd
    return abs((high if other > middle else low) - middle) / HALF


class EstimatedRow(Described):
    """One number of a point estimate, as ``EstimatedValue`` of estimates has it."""

    value: FiniteFloat
    sd: NotNegative | None = None
    sd_robust: NotNegative | None = None
    kind: Kind | None = None
    gauge_free: bool | None = None
    determined: bool | None = None
    at_bound: Bound | None = None
    span: Pair | None = None


class PosteriorRow(Described):
    """One parameter or derived quantity of a posterior."""

    mean: FiniteFloat
    sd: NotNegative  # if the model is right, as is `interval`
    median: FiniteFloat | None = None
    interval: Pair
    level: Annotated[FiniteFloat, Field(gt=0.0, lt=1.0)]
    rhat: FiniteFloat | None = None
    ess: FiniteFloat | None = None
    converged: bool | None = None
    prior: str = ""
    prior_default: bool = False
    prior_sd: NotNegative | None = None
    prior_interval: Pair | None = None  # of the same level
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
    doubted: list[str] = Field(default_factory=list)  # kinds of doubts that concern it
    undoubted: Determined | None = None  # its verdict without them
    given_by: list[str] = Field(default_factory=list)  # parameters whose priors give its scale
    # share of outputs that see its way of driving, where they are too few to determine it and it
    # follows from the other way
    mirrored: Share | None = None
    # with model discrepancy, where the recordings show any
    model_error_interval: Pair | None = None
    model_error_sd: NotNegative | None = None
    reported: Reported | None = None

    @property
    def middle(self) -> float:
        """The median, or where there is none the mean."""
        return self.mean if self.median is None else self.median

    @property
    def value(self) -> float:
        """The one to print."""
        return self.middle if self.reported is None else self.reported.value

    @property
    def doubtful(self) -> bool:
        """Whether what the data say of it is doubted; of what they leave open they say nothing."""
        return bool(self.doubted) and self.verdict != "prior"

    @property
    def widened(self) -> Spread | None:
        """With model discrepancy, where there is any."""
        if self.model_error_interval is None or self.model_error_sd is None:
            return None
        low, high = self.model_error_interval
        return Spread(self.middle, low, high, self.model_error_sd)

    @property
    def printed(self) -> Spread:
        """What to print: as reported, or before that with model discrepancy if there is any."""
        if self.reported is None and self.widened is not None:
            return self.widened
        source = self.reported or self
        low, high = source.interval
        return Spread(self.value, low, high, source.sd)

    @property
    def remarks(self) -> list[str]:
        """What to know of it besides its verdict.

        Zero is of an angle a place like any other; what cannot be negative leans on that bound.
        """
        remarks = []
        if self.at_bound:
            end = {"lower": "down to the least", "upper": "up to the most"}[self.at_bound]
            remarks.append(f"reaches {end} that it may be")
        elif self.period is None and self.printed.low <= 0.0 <= self.printed.high:
            remarks.append("could be zero")
        if self.undefined_share:
            remarks.append(f"undefined in {100 * self.undefined_share:.0f} % of the draws")
        return remarks


class KnownRow(Described):
    """A parameter that was fixed."""

    value: FiniteFloat


class ReferenceRow(Part):
    """A value from elsewhere: the manufacturer's, or from CAD."""

    value: FiniteFloat
    unit: str
    sd: NotNegative | None = None
    source: str = "reference"


AnyRow = TypeVar("AnyRow", PosteriorRow, EstimatedRow, KnownRow, ReferenceRow)
# Keys of rows that whole turns move.
_PLACES = {"mean", "median", "value", "bound", "interval", "model_error_interval", "span"}


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
    moved = dict(row)
    for key, x in row.items():
        if key in _PLACES and x is not None:
            moved[key] = [end + by for end in x] if isinstance(x, list) else x + by
        elif key == "reported" and x is not None:
            moved[key] = _moved(x, by)
    return moved


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
    """What a nominal back-EMF's error cannot be distinguished from, as ``SpeedTerm`` has it."""

    recordings: list[str]  # whose torque comes from a voltage
    among: int
    nominal: NotNegative
    unit: str
    same_as_back_emf: list[str] = Field(default_factory=list)
    explained: FiniteFloat


class RestsPart(Part):
    """Standstills of one recording that violate the stiction of the law, as ``RestsBeyond``."""

    recording: str
    share: Share
    start: FiniteFloat
    stop: FiniteFloat
    beyond: NotNegative
    held: NotNegative


class Residual(Part):
    """What the posterior leaves unexplained, recording by recording."""

    residual_rms: NotNegative | None = None
    explained: Annotated[FiniteFloat, Field(le=1.0)] | None = None
    unit: str = ""
    quantity: str = "output"
    # N m/A or N/A, where all that is explained was measured as a current
    torque_constant: FiniteFloat | None = None
    back_emf: BackEmfPart | None = None  # where a torque comes from a voltage
    rests: list[RestsPart] = Field(default_factory=list)  # standstills that were not used
    recordings: dict[Name, RecordingRow] = Field(default_factory=dict)


class MotionError(Part):
    """How far a motion is from the measured one, in its unit."""

    mae: NotNegative
    rmse: NotNegative
    inside: Share
    inside_alone: Share
    width: NotNegative | None = None


class RollOutRow(Part):
    """One recording, or all together."""

    part: RecordingPart | None = None
    input: Input | None = None
    position: MotionError
    speed: MotionError
    blind: Share = 0.0  # of the time in which the position's band is too wide
    over: Share = 0.0  # of the draws that went another way over the top

    @property
    def narrow(self) -> bool:
        """Whether the position leaves its bands far too often."""
        return self.position.inside < FEWEST

    @property
    def wide(self) -> bool:
        """Whether being inside the position's band says nothing."""
        return tells_nothing(self.blind, self.over)


class RollOutPart(Part):
    """Recordings simulated with draws of the posterior."""

    level: Share
    draws: int
    seed: int
    unit: Literal["rad", "m"]
    recordings: dict[Name, RollOutRow]
    pooled: RollOutRow
    unexplained: dict[Name, NotNegative]
    left: FiniteFloat
    torque_unit: str


def rollout_part(rollout: RollOut) -> RollOutPart:
    """Sum roll-outs up."""
    rows = {
        one.name: vars(one) | {"position": vars(one.at_position), "speed": vars(one.at_speed)}
        for one in rollout.rolled
    }
    mean = {key: sum(row[key] for row in rows.values()) / len(rows) for key in ("blind", "over")}
    errors = {key.removeprefix("at_"): vars(error) for key, error in rollout.pooled.items()}
    values = {key: getattr(rollout, key, None) for key in RollOutPart.model_fields}
    values |= {"unit": rollout.rolled[0].unit, "recordings": rows, "pooled": mean | errors}
    return RollOutPart.model_validate(values)
