"""The ``[estimation]`` and ``[references]`` tables of a configuration."""

from __future__ import annotations

from pydantic import Field

from bayesfric.base.options import Options


class Estimation(Options):
    """How point estimates are made."""

    starts: int = Field(8, ge=1, le=1000, description="random starts beside the derived ones")
    seed: int = Field(1, ge=0, lt=2**63, description="of the random starts")
    output_error: bool = Field(
        False,
        description="whether 'fit' makes the output-error estimate beside the posterior, as with "
        "--output-error; it simulates, and may take many times as long as the posterior",
    )
    max_seconds: float = Field(
        60.0,
        gt=0,
        le=1e9,
        description="CPU time that the output-error estimate may take, s; what it has by then is "
        "marked as not converged, and is another one on another machine. An output-error "
        "likelihood starts from that estimate, and allows it all it needs",
    )
    segment: float | None = Field(
        None,
        gt=0,
        le=1e5,
        description="s after which the output-error simulation starts anew; chosen if left out",
    )
    substeps: int | None = Field(
        None, ge=1, le=64, description="integration steps a sample; chosen if left out"
    )


class Reference(Options):
    """A value from elsewhere to compare results with; it enters no fit."""

    value: float = Field(
        allow_inf_nan=False,
        description="in SI units, as results are shown",
    )
    sd: float | None = Field(
        None,
        gt=0,
        allow_inf_nan=False,
        description="its standard deviation, if it is known",
    )
    source: str = Field("reference", description="where it is from, such as CAD")
