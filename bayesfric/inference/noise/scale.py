"""The scales of noise, and which of them each recording has.

Standard deviations are shared or separate for each recording; autocorrelation is always shared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.least_squares import TypicalSizes
from bayesfric.inference.prior.priors import Prior, PriorText, read_prior
from bayesfric.recordings.arrays import Array

NoiseScale = Literal["shared", "per-recording"]


@dataclass(frozen=True)
class Scale:
    """One parameter of the noise."""

    name: str  # parameter ``noise.<name>``
    symbol: str
    meaning: str  # one line, for rotary joints
    # default prior, for the sizes of the measurements
    prior: Callable[[TypicalSizes], PriorText]
    # Support
    lower: float = 0.0
    upper: float = np.inf
    # of a torque, a position, or none
    unit: Literal["torque", "position", ""] = "torque"
    # whether all recordings share it in any case
    shared: bool = False
    # whether the residuals of an estimate determine if it is used
    chosen: bool = False

    def read_prior(self, texts: Mapping[str, PriorText], sizes: TypicalSizes) -> Prior:
        """Read the configured prior, or use the default."""
        name = f"noise.{self.name}"
        text, default = (texts[name], False) if name in texts else (self.prior(sizes), True)
        return read_prior(name, text, lower=self.lower, upper=self.upper, default=default)


def up_to(size: float, least: float | None = None) -> PriorText:
    """Return a log-uniform prior up to a size."""
    top = float(f"{size:.0e}")
    bottom = 1e-6 * top if least is None else float(f"{least:.0e}")
    return {"distribution": "loguniform", "a": bottom, "b": top}


class NoiseDescription:
    """TypicalSizes and a description of a noise model."""

    def __init__(
        self, scales: Sequence[Scale], description: str, *, accounts_for_correlation: bool
    ) -> None:
        self.scales, self.description = tuple(scales), description
        self.accounts_for_correlation = accounts_for_correlation
        self.quantities = tuple(scale.name for scale in scales)


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise scales, shared by all recordings or some for each."""

    # noise.sigma or noise.sigma.<recording>, those of the first recording first
    names: tuple[str, ...]
    # LaTeX, name of the :class:`Scale`, and prior of each
    symbols: tuple[str, ...]
    quantities: tuple[str, ...]
    priors: tuple[Prior, ...]
    places: NDArray[np.int64]  # (R, Q) index of each recording's scales among the names

    def scales(self, parameters: Array) -> Array:
        """Return every recording's scales ``(n, R, Q)`` of parameters ``(n, len(names))``."""
        return parameters[:, self.places]

    def fold(self, information: Array) -> Array:
        """Sum information ``(R, Q, Q)`` over recordings that share a scale."""
        out = np.zeros((len(self.names), len(self.names)))
        for places, block in zip(self.places, information, strict=True):
            out[np.ix_(places, places)] += block
        return out


def noise_of(
    recordings: Sequence[str],
    scales: Sequence[Scale],
    priors: Mapping[str, Prior],
    scale: NoiseScale,
) -> Noise:
    """Set up the noise of named recordings."""
    separate = scale == "per-recording" and len(recordings) > 1
    sampled: dict[str, tuple[str, str, Prior]] = {}
    places = np.zeros((len(recordings), len(scales)), dtype=np.int64)
    for i, recording in enumerate(recordings):
        for j, quantity in enumerate(scales):
            name, symbol = f"noise.{quantity.name}", quantity.symbol
            prior = priors[name]
            if separate and not quantity.shared:
                name, symbol = f"{name}.{recording}", _numbered(symbol, i + 1)
            sampled.setdefault(name, (symbol, quantity.name, prior))
            places[i, j] = list(sampled).index(name)
    symbols, quantities, sampled_priors = zip(*sampled.values(), strict=True)
    return Noise(tuple(sampled), symbols, quantities, sampled_priors, places)


def _numbered(symbol: str, number: int) -> str:
    """Add a recording's number to the subscript of a symbol."""
    base, _, subscript = symbol.partition("_")
    return f"{base}_{{{subscript},{number}}}" if subscript else f"{symbol}_{{{number}}}"
