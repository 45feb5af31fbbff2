"""What a point estimate is, whichever method made it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EstimatedValue:
    """One estimated number.

    Attributes
    ----------
    name, unit, symbol, meaning
        As for parameters; the symbol is LaTeX without dollar signs.
    value, sd
        Estimate and standard deviation.
    """

    name: str
    unit: str
    symbol: str
    meaning: str
    value: float
    sd: float


@dataclass(frozen=True)
class Estimate:
    """A point estimate.

    Attributes
    ----------
    method
        ``least-squares``, ``input-error`` or ``output-error``.
    values
        In a fixed order.
    residual_rms
        Root mean square of measured minus modelled, in the torque's unit.
    n_outputs
        Number of samples used after decimation.
    assumption
        What the standard deviations take for granted, one sentence.
    """

    method: str
    values: tuple[EstimatedValue, ...]
    residual_rms: float
    n_outputs: int
    assumption: str

    def __getitem__(self, name: str) -> EstimatedValue:
        for value in self.values:
            if value.name == name:
                return value
        raise KeyError(name)
