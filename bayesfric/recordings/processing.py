"""The ``[processing]`` table: how a recording is filtered, differentiated and decimated."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator

from bayesfric.base.errors import Unfit
from bayesfric.base.options import Options
from bayesfric.recordings import units
from bayesfric.recordings.units import Hertz, HertzOrOff, Seconds


class Processing(Options):
    """How a recording is filtered, differentiated and decimated."""

    lowpass: HertzOrOff | None = Field(
        None,
        description="Cut-off of the zero-phase Butterworth low-pass, in Hz; if left out three "
        "times the band (six where samples at reversals are left out), at most a fifth of the "
        "sampling rate; a tenth of it where decimate is given; 'off' or 0 for none.",
    )
    order: int = Field(4, ge=1, le=12, description="Order of the Butterworth filter.")
    decimate: int | None = Field(
        None,
        ge=1,
        description="Keep one output in this many samples; if left out what the band, or else "
        "the low-pass, takes.",
    )
    band: Hertz | None = Field(
        None,
        description="Cut-off in Hz of the filter that torque and model pass alike. If left out "
        "a tenth above half the decimated rate, where white noise comes out white; and without "
        "low-pass and decimate that rate is as high as the position resolves the acceleration "
        "and the torque has power, at most a tenth of the sampling rate.",
    )
    differentiation: Literal["exact", "central"] = Field(
        "exact",
        description="'exact': its gain is right within 1e-4 in all that the low-pass lets pass; "
        "'central': differences of the two neighbours, whose gain falls with frequency, as in "
        "published analyses.",
    )
    dead_zone: float | str | None = Field(
        None,
        description="Joint speed below which a sample is not used, in SI units or text such as "
        "'1 deg/s'; 1 % of the 99th percentile of the speed if left out; 0 for none.",
    )
    rest: bool = Field(
        False,
        description="true: samples at rest, where the position as read does not change, say that "
        "the torque lies within static friction to either side; false: they are left out as all "
        "below the dead zone.",
    )
    trim: Seconds | None = Field(
        None,
        description="Cut from both ends of every segment after differentiation, in seconds; the "
        "longer of 10 samples and one period of the low-pass if left out.",
    )

    @property
    def chooses_band(self) -> bool:
        """Whether the band is chosen by the recording, none of its filters being given."""
        return self.lowpass is None and self.decimate is None and self.band is None

    @field_validator("dead_zone")
    @classmethod
    def _speed(cls, value: float | str | None) -> float | str | None:
        # kept as text: whether rad/s or m/s is meant is settled by the mechanism
        number = (
            units.quantity(value, "angular_speed", "speed") if isinstance(value, str) else value
        )
        if number is not None and not 0 <= number < float("inf"):
            raise Unfit("a speed of 0 or more", f"got {value}")
        return value
