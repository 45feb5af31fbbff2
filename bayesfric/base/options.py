"""What every table of a configuration is made of."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Options(BaseModel):
    """Options that refuse keys they do not know."""

    model_config = ConfigDict(frozen=True, extra="forbid")
