"""The ``[advice]`` table of a configuration: within what limits the next experiment may be.

It is read by ``bayesfric identify --advise`` alone; what is left out is settled from the
recordings, see :func:`bayesfric.identifiability.next_recording.limits_of`.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator

from bayesfric.base.errors import Unfit
from bayesfric.base.options import Options
from bayesfric.recordings.units import Kilograms, Metres

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class Mass(Options):
    """A known mass on hand, and where on the load it can be bolted."""

    mass: Kilograms = Field(gt=0, description="kg, or text such as '2 kg'")
    radius: Metres = Field(0.0, description="m, or text such as '35 cm'; of a turning load")


class AdviceOptions(Options):
    """What ``bayesfric identify --advise`` may propose."""

    torque_limit: Positive | None = Field(
        None,
        description="largest motor torque to command, N m or N; the largest of the recordings, "
        "filtered, if left out",
    )
    speed_limit: Positive | None = Field(
        None,
        description="fastest that the joint may become, rad/s or m/s; 1.2 times the fastest of "
        "what is used of the recordings if left out",
    )
    angle_limits: tuple[Finite, Finite] | None = Field(
        None,
        description="[low, high] that the joint must stay between, rad or m; if left out, what was "
        "recorded, or none where a free joint went through a whole turn",
    )
    duration: Positive | None = Field(
        None,
        le=600,
        description="s of a proposed recording; if left out that of the longest stretch of the "
        "recordings without a gap that is compared, at most 30",
    )
    masses: tuple[Mass, ...] | None = Field(
        None,
        description="known masses on hand besides those of the recordings; [] for none; if left "
        "out and the recordings have none, one about as heavy as the load, up to 5 kg",
    )
    lag: float = Field(
        0.005,
        ge=0,
        le=10,
        allow_inf_nan=False,
        description="time constant of the current loop, s",
    )

    @field_validator("angle_limits")
    @classmethod
    def _rising(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and not value[0] < value[1]:
            raise Unfit("two angles, the smaller one first", f"got [{value[0]:g}, {value[1]:g}]")
        return value
