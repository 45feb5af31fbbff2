"""What a user may say about a recording and its processing."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator, model_validator

from bayesfric.recordings import units


def _reader(*kinds: units.Kind, off: bool = False) -> BeforeValidator:
    """Return a validator that turns text with a unit into an SI number."""

    def read(value: Any) -> Any:
        if isinstance(value, bool):
            raise ValueError(f"expected a number or text with a unit, got {value}")
        if off and value == "off":
            return 0.0
        return units.quantity(value, *kinds) if isinstance(value, str) else value

    return BeforeValidator(read)


_DELIMITERS = "\t !#$%&'()*,/:;<=>?@[\\]^_`{|}~"


Seconds = Annotated[float, _reader("time"), Field(ge=0, allow_inf_nan=False)]
Hertz = Annotated[float, _reader("frequency"), Field(gt=0, allow_inf_nan=False)]
HertzOrOff = Annotated[float, _reader("frequency", off=True), Field(ge=0, allow_inf_nan=False)]
Kilograms = Annotated[float, _reader("mass"), Field(ge=0, allow_inf_nan=False)]
Metres = Annotated[float, _reader("length"), Field(ge=0, allow_inf_nan=False)]


def _is(text: str | None, *kinds: units.Kind) -> str | None:
    """Check a text's dimension but keep the text, for kinds settled only by the mechanism."""
    if text is not None and not units.quantity(text, *kinds) > 0:
        raise ValueError(f"expected a positive value, got '{text}'")
    return text


class _Options(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Channel(_Options):
    """One measured signal: which column it is in and what its numbers mean."""

    column: str | int = Field(description="Column: its name in the header, or its number from 1.")
    unit: str = Field(
        description="Unit of the raw numbers, such as 'rad', 'rpm', 'N m', 'turn/4096', "
        "'9.84e-5 N m' (then a raw 1 is that much)."
    )
    sign: Literal[1, -1] = Field(default=1, description="-1 turns the signal around.")
    twos_complement: int | None = Field(
        default=None,
        ge=2,
        le=53,
        description="Bits of a signed number recorded as unsigned: values from 2**(bits-1) up "
        "get 2**bits subtracted.",
    )
    times: str | int | None = Field(
        default=None,
        description="A further column multiplied in sample by sample, such as the supply voltage "
        "that a duty cycle refers to.",
    )
    times_unit: str = Field(
        default="", description="Unit of the column in 'times'; empty for a plain number."
    )

    @field_validator("column", "times")
    @classmethod
    def _number_from_one(cls, value: str | int | None) -> str | int | None:
        if isinstance(value, int) and value < 1:
            raise ValueError(f"columns are numbered from 1, got {value}")
        return value


class Position(Channel):
    """The position channel, of the joint or of the motor."""

    side: Literal["motor", "joint"] | None = Field(
        default=None,
        description="Where it is measured; may be left out only if the gear ratio is 1.",
    )


class Velocity(Channel):
    """The velocity channel, of the joint or of the motor."""

    side: Literal["motor", "joint"] | None = Field(
        default=None,
        description="Where it is measured; may be left out only if the gear ratio is 1.",
    )


class Torque(Channel):
    """The motor torque (or force) itself, or a signal proportional to it."""

    constant: str | None = Field(
        default=None, description="What turns the signal into a torque, such as '35.15 N/V'."
    )


class Current(Channel):
    """The motor current."""

    torque_constant: str = Field(description="Torque per current, such as '0.32 N m/A'.")

    @field_validator("torque_constant")
    @classmethod
    def _dimension(cls, value: str) -> str | None:
        return _is(value, "torque_constant", "force_constant")


class Voltage(Channel):
    """The motor voltage; torque = kt V/R - kt**2 (motor speed)/R."""

    torque_constant: str = Field(description="Torque per current kt, such as '0.354 N m/A'.")
    resistance: str = Field(description="Winding resistance R, such as '3.4 ohm'.")

    @field_validator("torque_constant")
    @classmethod
    def _dimension(cls, value: str) -> str | None:
        return _is(value, "torque_constant", "force_constant")

    @field_validator("resistance")
    @classmethod
    def _resistance(cls, value: str) -> str | None:
        return _is(value, "resistance")


class Source(_Options):
    """One or more files of the same layout, each giving one recording."""

    file: str | list[str] = Field(
        description="File or files, relative to the configuration's folder; may hold wildcards "
        "(*, ?, **)."
    )
    format: Literal["csv", "parquet", "mat", "npz", "json"] | None = Field(
        default=None, description="File format; found from the suffix if left out."
    )
    delimiter: str | None = Field(
        default=None,
        description="CSV: the character between columns, or 'tab' or 'whitespace'; found by itself "
        "if left out.",
    )
    header: bool | None = Field(
        default=None,
        description="CSV: whether the first line names the columns; found by itself if left out.",
    )
    decimal: Literal[".", ","] = Field(default=".", description="CSV: decimal mark.")
    skip_rows: int = Field(
        default=0, ge=0, description="CSV: lines to skip at the beginning of the file."
    )
    table: str | None = Field(
        default=None,
        description="JSON: dotted path of keys to the rows or columns. MAT: name of a struct.",
    )
    time: Channel | None = Field(default=None, description="The time channel.")
    rate: Hertz | None = Field(
        default=None,
        description="Sampling rate in Hz, or text such as '1 kHz', if there is no time channel.",
    )
    position: Position = Field(description="The position channel.")
    velocity: Velocity | None = Field(
        default=None,
        description="The velocity channel; if given it is used in place of the differentiated "
        "position.",
    )
    torque: Torque | None = Field(default=None, description="The torque channel, or ...")
    current: Current | None = Field(default=None, description="... the current channel, or ...")
    voltage: Voltage | None = Field(default=None, description="... the voltage channel.")
    start: Seconds | None = Field(
        default=None, description="Leave out what lies before, in seconds from the first stamp."
    )
    stop: Seconds | None = Field(
        default=None, description="Leave out what lies after, in seconds from the first stamp."
    )
    exclude: tuple[tuple[Seconds, Seconds], ...] = Field(
        default=(),
        description="Spans [start, stop] in seconds from the first stamp that are not compared "
        "with the model; nor is what lies closer to them than the trim.",
    )
    valid: str | int | None = Field(
        default=None,
        description="Column that is 0 or false where the torque is not what the motor gave, such "
        "as a 'torque enabled' flag; samples there are not compared with the model.",
    )
    added_mass: Kilograms = Field(
        default=0.0, description="Known mass added for the recording, kg."
    )
    radius: Metres = Field(default=0.0, description="Distance of the added mass from the axis, m.")
    name: str | None = Field(
        default=None,
        min_length=1,
        description="Name of the recording; the file's stem if left out.",
    )

    @field_validator("file")
    @classmethod
    def _some_file(cls, value: str | list[str]) -> str | list[str]:
        files = [value] if isinstance(value, str) else value
        if not files or not all(files):
            raise ValueError("names no file")
        return value

    @field_validator("delimiter")
    @classmethod
    def _one_character(cls, value: str | None) -> str | None:
        if value is not None and len(value) != 1 and value not in ("tab", "whitespace"):
            raise ValueError(f"expected one character, 'tab' or 'whitespace', got '{value}'")
        if value is not None and len(value) == 1 and value not in _DELIMITERS:
            raise ValueError(f"'{value}' is part of numbers, or no delimiter of text files")
        return value

    @field_validator("exclude")
    @classmethod
    def _forward(cls, value: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        for start, stop in value:
            if not start < stop:
                raise ValueError(f"a span must end after it starts, got [{start:g}, {stop:g}]")
        return value

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.time is None) == (self.rate is None):
            raise ValueError("give exactly one of 'time' (a channel) and 'rate' (like '1 kHz')")
        given = [key for key in ("torque", "current", "voltage") if getattr(self, key) is not None]
        if len(given) != 1:
            found = " and ".join(f"'{key}'" for key in given) or "none"
            raise ValueError(f"give exactly one of 'torque', 'current', 'voltage', got {found}")
        if self.start is not None and self.stop is not None and not self.start < self.stop:
            raise ValueError(f"'stop' ({self.stop:g} s) must lie after 'start' ({self.start:g} s)")
        if self.delimiter is not None and self.delimiter == self.decimal:
            raise ValueError(f"'delimiter' and 'decimal' are both '{self.decimal}'")
        return self


class Processing(_Options):
    """How a recording is filtered, differentiated and decimated."""

    lowpass: HertzOrOff | None = Field(
        default=None,
        description="Cut-off of the zero-phase Butterworth low-pass of the position, in Hz; if "
        "left out six times the band, at most a fifth of the sampling rate; 'off' or 0 for none.",
    )
    order: int = Field(default=4, ge=1, le=12, description="Order of the Butterworth filter.")
    decimate: int | None = Field(
        default=None,
        ge=1,
        description="Keep one output in this many samples; if left out what the band, or else "
        "the low-pass, takes.",
    )
    band: Hertz | None = Field(
        default=None,
        description="Cut-off in Hz of the filter that torque and model pass alike. If left out "
        "half the decimated rate where low-pass or decimate are given, and else as far as the "
        "position resolves the acceleration and the torque has power, at most a twentieth of "
        "the sampling rate.",
    )
    differentiation: Literal["exact", "central"] = Field(
        default="exact",
        description="'exact': its gain is right within 1e-4 in all that the low-pass lets pass; "
        "'central': differences of the two neighbours, whose gain falls with frequency, as in "
        "published analyses.",
    )
    dead_zone: float | str | None = Field(
        default=None,
        description="Joint speed below which a sample is not used, in SI units or text such as "
        "'1 deg/s'; 1 % of the 99th percentile of the speed if left out; 0 for none.",
    )
    trim: Seconds | None = Field(
        default=None,
        description="Cut from both ends of every segment after differentiation, in seconds; the "
        "longer of 10 samples and one period of the low-pass if left out.",
    )
    resample: str = Field(
        default="auto",
        description="'auto' (if the time steps jitter), 'never', or a period such as '5 ms'.",
    )
    gap: float = Field(
        default=5.0,
        gt=1,
        allow_inf_nan=False,
        description="A time step longer than this many median periods separates segments.",
    )
    jitter: float = Field(
        default=0.01,
        ge=0,
        allow_inf_nan=False,
        description="Relative rms jitter of the time steps above which 'auto' resamples.",
    )
    min_samples: int = Field(
        default=50, ge=5, description="Segments with fewer samples are left out."
    )

    @field_validator("dead_zone")
    @classmethod
    def _speed(cls, value: float | str | None) -> float | str | None:
        # kept as text: whether rad/s or m/s is meant is settled by the mechanism
        number = (
            units.quantity(value, "angular_speed", "speed") if isinstance(value, str) else value
        )
        if number is not None and not 0 <= number < float("inf"):
            raise ValueError(f"expected a speed of 0 or more, got {value}")
        return value

    @field_validator("resample")
    @classmethod
    def _period(cls, value: str) -> str:
        if value not in ("auto", "never") and not units.quantity(value, "time") > 0:
            raise ValueError(f"expected 'auto', 'never' or a period like '5 ms', got '{value}'")
        return value
