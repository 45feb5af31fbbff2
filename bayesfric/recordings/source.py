"""Recordings as a user gives them, in a configuration or in Python, and their processing."""

from __future__ import annotations

import glob
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field, ValidationError, field_validator, model_validator

from bayesfric.base.errors import BadInput, Unfit, nearest
from bayesfric.base.options import Options, configuration_error
from bayesfric.recordings import units
from bayesfric.recordings.measurement import Lag
from bayesfric.recordings.readers import TableOptions
from bayesfric.recordings.tables import Table
from bayesfric.recordings.units import Hertz, HertzOrOff, Kilograms, Metres, Seconds

if TYPE_CHECKING:
    import pandas as pd

_CHANNELS = "time position velocity torque current voltage target load_torque temperature"
CHANNELS = tuple(_CHANNELS.split())
# Unit of numbers that are in SI already, whether the joint turns or slides.
SI = "SI"


def _text_of(*kinds: units.Kind) -> AfterValidator:
    """Check a text's dimension but keep the text, as the mechanism determines the kind."""

    def check(text: str) -> str:
        if not (value := units.quantity(text, *kinds)) > 0:
            turned = ", and sign = -1" if value < 0 and "torque_constant" in kinds else ""
            raise Unfit(f"a positive value{turned}", f"got '{text}'")
        return text

    return AfterValidator(check)


TorqueConstant = Annotated[str, _text_of("torque_constant", "force_constant")]
Resistance = Annotated[str, _text_of("resistance")]


class Channel(Options):
    """One measured signal: which column it is in and what its numbers mean."""

    column: str | int = Field(description="Column: its name in the header, or its number from 1.")
    unit: str = Field(
        description="Unit of a raw 1, such as 'rad', 'rpm', 'turn/4096', '9.84e-5 N m' or 'SI'."
    )
    sign: Literal[1, -1, "by-speed"] = Field(
        1,
        description="-1 turns the signal around; 'by-speed', of torque and current: its sign means "
        "driving (+) or braking (-).",
    )
    twos_complement: int | None = Field(
        None, ge=2, le=53, description="Bits of a signed number that was recorded as unsigned."
    )
    sign_bit: int | None = Field(
        None, ge=1, le=52, description="Bit that is the sign; values from 2**bit up are negative."
    )
    times: str | int | None = Field(
        None, description="Column multiplied in, such as the supply voltage of a duty cycle."
    )
    times_unit: str = Field("", description="Unit of 'times'; empty for a plain number.")

    @field_validator("unit", "times_unit")
    @classmethod
    def _no_guess(cls, value: str) -> str:
        return units.known(value)

    @field_validator("sign")
    @classmethod
    def _by_speed(cls, value: Any) -> Any:
        if value == "by-speed" and not issubclass(cls, Torque | Current):
            raise Unfit("1 or -1", "'by-speed' is for torque and current")
        return value

    @field_validator("column", "times")
    @classmethod
    def _number_from_one(cls, value: str | int | None) -> str | int | None:
        if isinstance(value, int) and value < 1:
            raise ValueError(f"columns are numbered from 1, got {value}")
        return value


class Position(Channel):
    """The position channel, of the joint or of the motor."""

    side: Literal["motor", "joint"] | None = Field(
        None, description="Where it is measured; may be left out only if the gear ratio is 1."
    )


class Filtered(Channel):
    """A signal that the drive may have filtered before it was recorded."""

    lowpass: Hertz | None = Field(
        None,
        description="Cut-off (-3 dB) of the causal low-pass that it passed in the drive; undone.",
    )
    lowpass_order: Literal[1, 2] = Field(1, description="Order of that filter; 2 is Butterworth.")

    @property
    def lag(self) -> Lag | None:
        """Cut-off in Hz and order of that filter, if it is known."""
        return None if self.lowpass is None else (self.lowpass, self.lowpass_order)


class Velocity(Position, Filtered):
    """The velocity channel, of the joint or of the motor."""


class Effort(Channel):
    """What drives the joint: motor torque, force, current or voltage; its number may be known."""

    column: str | int = Field("", description="Column: its name or number from 1; or 'value'.")
    unit: str = Field("", description="Unit of a raw 1, as of the position.")
    value: float | str | None = Field(
        None,
        description="What it is throughout, in place of a column: 0 of a motor that is off, or "
        "text such as '24 V'; 'torque = 0' is short for it.",
    )
    sampled: Literal["instant", "average", "start", "end"] = Field(
        "instant",
        description="'instant': measured at its stamp; else a mean over one sampling period, of "
        "which the stamp is the middle ('average'), the 'start' or the 'end'.",
    )
    held: bool | None = Field(
        None,
        description="true: the drive holds a command until the next sample; false: it passes there "
        "in a line; left out: a line, and of a target alone target.smoothness.",
    )

    @model_validator(mode="before")
    @classmethod
    def _short(cls, given: Any) -> Any:
        is_value = isinstance(given, str | int | float) and not isinstance(given, bool)
        return {"value": given} if is_value else given

    @model_validator(mode="after")
    def _column_or_value(self) -> Self:
        if (self.column == "") == (self.value is None):
            got = "got neither" if self.value is None else "got both"
            raise Unfit("a 'column', or a 'value' in place of it", got)
        if self.value is None and not self.unit:
            raise Unfit("the 'unit' of the column", "got none")
        if isinstance(self.value, float) and self.value:
            raise Unfit("a number with its unit, such as '2 A'", f"got {self.value:g}")
        return self


class Torque(Effort, Filtered):
    """The motor torque (or force) itself, or a signal proportional to it."""

    constant: str | None = Field(None, description="Torque per unit of it, such as '35.15 N/V'.")

    @classmethod
    def __get_pydantic_json_schema__(cls, core: Any, handler: Any) -> dict[str, Any]:
        return {"anyOf": [handler(core), {"type": ["number", "string"]}]}


class Current(Effort, Filtered):
    """The motor current."""

    torque_constant: TorqueConstant = Field(description="Torque per current, such as '0.32 N m/A'.")


class Voltage(Effort):
    """The motor voltage; torque = kt V/R - kt**2 (motor speed)/R."""

    torque_constant: TorqueConstant = Field(description="Torque per current, as of the current.")
    resistance: Resistance = Field(description="Winding resistance R, such as '3.4 ohm'.")


class Target(Effort, Position):
    """The target position of the drive, whose controller determines the torque.

    ``clip(kp (target - position) - kd velocity, limit)``, on the side where the target is
    given. The unit of ``kp`` determines that: torque, current, voltage, or the duty of a supply.
    """

    kp: str | list[str] | None = Field(
        None,
        description="Gain of the drive's controller: '8 N m/rad', '3 A/rad', '5 V/rad', or "
        "'2 1/rad' for a duty, 1 being the whole of the supply in 'times'. A range such as "
        "['5 N m/rad', '20 N m/rad'] makes it a parameter, drive.kp; if left out it is any, or "
        "1 N m/rad where nothing else says how large a torque is.",
        examples=["8 N m/rad", ["5 N m/rad", "20 N m/rad"]],
    )
    kd: str | list[str] | None = Field(
        None,
        description="Its gain for the speed, such as '0.1 N m s/rad', or a range (drive.kd); left "
        "out it counts as viscous friction, from which no motion below the limit distinguishes it.",
    )
    velocity_filter: Seconds | None = Field(None, description="Lag of the drive's speed, s, or 0.")
    loop: Seconds | None = Field(None, description="Period of its loop, s; 0: continuous.")
    limit: str | None = Field(None, description="What the controller gives at most: '5 V' or '1'.")
    torque_constant: TorqueConstant | None = Field(
        None, description="Torque per current, where the controller gives no torque."
    )
    resistance: Resistance | None = Field(
        None, description="Winding resistance, where it gives a voltage or duty."
    )


class Columns(Options):
    """What the columns of a table mean, and what is known besides."""

    time: Channel | None = Field(None, description="The time channel.")
    rate: Hertz | None = Field(
        None, description="Sampling rate in Hz, or '1 kHz', if there is no time channel."
    )
    position: Position | None = Field(
        None, description="The position; without it 'velocity' is integrated, for no term of it."
    )
    velocity: Velocity | None = Field(None, description="The velocity, if it was measured.")
    torque: Torque | None = Field(None, description="The torque channel, or ...")
    current: Current | None = Field(None, description="... the current channel, or ...")
    voltage: Voltage | None = Field(None, description="... the voltage channel.")
    target: Target | None = Field(
        None,
        description="The position that the drive goes for and its controller's gains; in place of "
        "the torque where none was recorded. Beside it, a roll-out closes the loop.",
    )
    load_torque: Channel | None = Field(None, description="External torque, positive as positions.")
    temperature: Channel | None = Field(None, description="The joint's temperature, 'degC' or 'K'.")
    others: tuple[str | int, ...] = Field(
        (), description="Further columns, as of other joints, that may explain the torque."
    )
    steady: bool = Field(False, description="true: each row is a point at constant speed.")
    start: Seconds | None = Field(None, description="Leave out what lies before, s from the first.")
    stop: Seconds | None = Field(None, description="Leave out what lies after, s from the first.")
    exclude: tuple[tuple[Seconds, Seconds], ...] = Field(
        (), description="Spans [start, stop], s from the first stamp, not compared with the model."
    )
    valid: str | int | None = Field(
        None, description="Column that is 0 or false where the torque is not what the motor gave."
    )
    added_mass: Kilograms = Field(0.0, description="Known mass added for the recording, kg.")
    radius: Metres = Field(0.0, description="Distance of the added mass from the axis, m.")
    name: str | None = Field(
        None, min_length=1, description="Its name; the file's stem if left out."
    )

    @field_validator("exclude")
    @classmethod
    def _forward(cls, value: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        for start, stop in value:
            if not start < stop:
                raise ValueError(f"a span must end after it starts, got [{start:g}, {stop:g}]")
        return value

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.steady:
            timed = ("time", "rate", "position", "target", "start", "stop", "exclude")
            wrong = [key for key in timed if getattr(self, key)]
            if wrong or self.velocity is None:
                got = f"got '{wrong[0]}'" if wrong else "got no 'velocity'"
                raise Unfit("'velocity' and torque alone of steady points", got)
        elif (self.time is None) == (self.rate is None):
            got = "neither" if self.time is None else "both"
            raise Unfit("exactly one of 'time' (a channel) and 'rate' (like '1 kHz')", f"got {got}")
        if self.position is None and (self.velocity is None or self.target is not None):
            raise Unfit("a 'position', or a 'velocity' where there is no 'target'", "got neither")
        drives = [key for key in ("torque", "current", "voltage") if getattr(self, key) is not None]
        if len(drives) > 1 or not (drives or self.target):
            got = " and ".join(f"'{key}'" for key in drives) or "none"
            raise Unfit(
                "exactly one of 'torque', 'current', 'voltage', or a 'target'", f"got {got}"
            )
        if self.start is not None and self.stop is not None and not self.start < self.stop:
            raise ValueError(f"'stop' ({self.stop:g} s) must lie after 'start' ({self.start:g} s)")
        return self

    @property
    def motion(self) -> Position:
        """The position, or the velocity where there is none."""
        channel = self.position or self.velocity
        assert channel is not None
        return channel

    @property
    def channels(self) -> dict[str, Channel]:
        """The channels that have a column, by key."""
        channels = {key: getattr(self, key) for key in CHANNELS}
        return {key: x for key, x in channels.items() if x is not None and x.column != ""}

    @property
    def columns(self) -> list[str | int]:
        """Every column that is read."""
        channels = self.channels.values()
        columns = [c for x in channels for c in (x.column, x.times) if c is not None]
        columns += self.others
        return columns if self.valid is None else [*columns, self.valid]


class Source(Columns, TableOptions):
    """One or more files of the same layout, each giving one recording."""

    file: str | list[str] = Field(
        description="Files or patterns (*, ?, **), relative to the configuration's folder."
    )

    @property
    def files(self) -> list[str]:
        """Names and patterns of files."""
        return [self.file] if isinstance(self.file, str) else self.file

    @field_validator("file")
    @classmethod
    def _some_file(cls, value: str | list[str]) -> str | list[str]:
        files = [value] if isinstance(value, str) else value
        if not files or not all(files):
            raise ValueError("names no file")
        return value


class Processing(Options):
    """How a recording is filtered, differentiated and decimated."""

    lowpass: HertzOrOff | None = Field(
        None,
        description="Cut-off of the zero-phase Butterworth low-pass, in Hz; 'off' or 0 for none. "
        "If left out three times the band, at most a fifth of the sampling rate; a tenth of it "
        "where decimate is given.",
    )
    order: int = Field(4, ge=1, le=12, description="Order of the Butterworth filter.")
    decimate: int | None = Field(
        None, ge=1, description="Samples an output; if left out by the band, else by the low-pass."
    )
    band: Hertz | None = Field(
        None,
        description="Cut-off in Hz of the filter that torque and model pass. If left out a tenth "
        "above half the decimated rate, which is as high as the position resolves the "
        "acceleration and the torque has power, at most a tenth of the sampling rate.",
    )
    differentiation: Literal["exact", "central"] = Field(
        "exact",
        description="'exact' up to the low-pass, or 'central' differences, as in publications.",
    )
    dead_zone: float | str | None = Field(
        None, description="Joint speed that is at rest; 1 % of the 99th percentile if left out."
    )
    rest: bool = Field(
        False, description="true: samples at rest are used, as bounds of the static friction."
    )
    trim: Seconds | None = Field(
        None, description="Cut off each segment's ends, s; by samples and low-pass if left out."
    )
    max_samples: int = Field(1_000_000, ge=1000, description="Used at most, spread in segments.")

    @property
    def chooses_band(self) -> bool:
        """Whether the band is chosen by the recording, none of its filters being given."""
        return self.lowpass is None and self.decimate is None and self.band is None

    @field_validator("dead_zone")
    @classmethod
    def _speed(cls, value: float | str | None) -> float | str | None:
        # kept as text: whether rad/s or m/s is meant is settled by the mechanism
        number = value
        if isinstance(value, str):
            number = units.quantity(value, "angular_speed", "speed")
        if number is not None and not 0 <= float(number) < float("inf"):
            raise Unfit("a speed of 0 or more", f"got {value}")
        return value


# --- recordings in Python ------------------------------------------------------------------------

_Keys = TypeVar("_Keys", bound=Columns)
Side = Literal["motor", "joint"] | None
Units = Mapping[str, str] | None


@dataclass(frozen=True, eq=False)
class Recording:
    """One or more recorded files, or a table in memory, with the meaning of its columns.

    Make one by :meth:`from_arrays`, :meth:`from_dataframe` or :meth:`from_file`, which take the
    keys of a ``[[recordings]]`` table of a configuration (``name``, ``added_mass``, ``rate``,
    ``start``, ``exclude``, ``valid`` ...), and ``torque_constant`` and ``resistance`` of the
    ``current`` or ``voltage`` that is given in place of ``torque``.
    """

    source: Columns  # what the columns mean, and for files which they are
    folder: Path = field(default_factory=Path)  # that file names are relative to
    table: Table | None = None  # columns in memory
    needed_rate: float = math.inf  # Hz that its motion needs; faster ones are averaged to it

    @classmethod
    def from_arrays(
        cls,
        time: ArrayLike | None,
        position: ArrayLike | None,
        torque: ArrayLike | float | None = None,
        *,
        units: Units = None,
        side: Side = None,
        **keys: Any,
    ) -> Recording:
        """Take columns from arrays.

        Parameters
        ----------
        time
            Shape (n,); None if ``rate`` is given.
        position, torque
            Shape (n,). In place of torque, ``current`` or ``voltage`` may be given; 0, or text such
            as ``"2 A"``, is the same throughout. Position may be None if ``velocity`` is given.
        units
            By channel, such as ``{"time": "ms", "position": "deg"}``; SI where none is given.
        side
            Of position and velocity; may be left out only if the gear ratio is 1.
        **keys
            ``velocity``, ``current``, ``target``, ``valid`` ..., shape (n,); and all other keys.
        """
        keys |= {"time": time, "position": position, "torque": torque}
        keys |= {k: {"value": x} for k, x in keys.items() if k in CHANNELS and np.isscalar(x)}
        names = [key for key in (*CHANNELS, "valid") if keys.get(key) is not None]
        names = [key for key in names if not isinstance(keys[key], Mapping)]
        # copied, as the caller may change them
        try:
            arrays = [np.array(keys[name]) for name in names]
        except ValueError as error:
            raise BadInput("recording", f"is ragged ({error})", "give (n,) arrays") from None
        source = _checked(Columns, keys | {name: name for name in names}, units, side)
        return cls(source, table=Table("recording", names, arrays.__getitem__))

    @classmethod
    def from_dataframe(
        cls, frame: pd.DataFrame, *, units: Units = None, side: Side = None, **keys: Any
    ) -> Recording:
        """Take columns from a DataFrame.

        Parameters
        ----------
        frame
            One row a sample.
        units, side
            As in :meth:`from_arrays`.
        **keys
            ``time`` or ``rate``, ``position``, ``velocity``, ``torque``, ``current`` and so on:
            name of a column, or its number from 1, or a table of keys as in a configuration:
            ``{"column": "q", "unit": "turn/4096", "sign": -1}``; and what else there is to say.
        """
        names = [str(name) for name in frame.columns]
        columns = [frame.iloc[:, i].to_numpy(copy=True) for i in range(len(names))]
        table = Table("recording", names, columns.__getitem__)
        return cls(_checked(Columns, keys, units, side), table=table)

    @classmethod
    def from_file(
        cls, path: str | Path, *, units: Units = None, side: Side = None, **keys: Any
    ) -> Recording:
        """Take a file, or all that match a pattern, whose format goes by the suffix.

        It is opened when a model reads it.

        Parameters
        ----------
        path
            A file; ``*``, ``?`` and ``**`` are wildcards.
        units, side, **keys
            As in :meth:`from_dataframe`, and ``format``, ``delimiter``, ``decimal``,
            ``skip_rows``, ``table`` and ``where``.
        """
        return cls(_checked(Source, keys | {"file": str(path)}, units, side))

    def saved(self, path: Path) -> Recording:
        """Write the columns used of a table in memory as CSV, and return that file's recording."""
        import pandas as pd

        if self.table is None:
            raise ValueError("the recording is in files already")
        names = self._header.items()
        frame = pd.DataFrame({name: self.table.values(column) for column, name in names})
        frame.to_csv(path, index=False)
        return type(self)(self.filed(glob.escape(path.name)), path.parent)

    def filed(self, file: str) -> Source:
        """Give the keys of the recording once :meth:`saved` has made it a file of that name."""
        keys = self.source.model_dump(exclude_unset=True, exclude_none=True)
        for channel in (keys, *(keys[key] for key in self.source.channels)):
            named = ("column", "times", "valid")
            channel |= {k: self._header[channel[k]] for k in named if k in channel}
        if "others" in keys:
            keys["others"] = tuple(self._header[column] for column in keys["others"])
        return Source(file=file, **keys)

    def __repr__(self) -> str:
        keys = self.source.model_dump(mode="json", exclude_unset=True, exclude_none=True)
        return "\n".join(f"{key}: {value}" for key, value in keys.items())

    @property
    def _header(self) -> dict[str | int, str]:
        return {c: c if isinstance(c, str) else f"column {c}" for c in self.source.columns}


def _checked(kind: type[_Keys], keys: Mapping[str, Any], units: Units, side: Side) -> _Keys:
    """Check keys as those of a ``[[recordings]]`` table."""
    document = {key: value for key, value in keys.items() if value is not None}
    motor = ("torque_constant", "resistance")
    constants = {"current": motor, "voltage": motor, "target": (*motor, "kp", "kd", "limit")}
    for key in (key for key in CHANNELS if key in document):
        column = document[key]
        channel = dict(column) if isinstance(column, Mapping) else {"column": column}
        if "value" not in channel:
            channel.setdefault("unit", (units or {}).get(key, SI))
        if side is not None and key in ("position", "velocity", "target"):
            channel.setdefault("side", side)
        for constant in constants.get(key, ()):
            if keys.get(constant) is not None:
                channel[constant] = keys[constant]
                document.pop(constant, None)
        document[key] = channel
    whose = f"recording {keys['name']!r}" if keys.get("name") else "recording"
    for key in units or {}:
        if key not in document or key not in CHANNELS:
            known = [name for name in CHANNELS if name in document]
            raise BadInput(f"{whose}: units.{key}", "no such channel is given", nearest(key, known))
    try:
        return kind.model_validate(document)
    except ValidationError as error:
        raise configuration_error(f"{whose}: ", whose, error, document, kind) from None
