"""The ``[pooling]`` table of a configuration."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from bayesfric.options import Options


class PoolingOptions(Options):
    """Parameters that may differ between recordings, for ``bayesfric pool``."""

    vary: dict[str, Literal["recording"]] = Field(
        default_factory=dict,
        examples=[{"motor.viscous": "recording", "offset": "recording"}],
        description='which, by name: { "motor.viscous" = "recording" }; all others are shared',
    )
