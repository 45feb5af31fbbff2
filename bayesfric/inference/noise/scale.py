"""The numbers that noise is described by, and which of them each recording has.

A bench gives every recording noise of one kind, but maybe not of one size: standard deviations can
be shared or be each recording's own, what shapes the noise is always shared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.sizes import Scales
from bayesfric.inference.prior.priors import Prior, PriorText, read_prior
from bayesfric.recordings.arrays import Array

NoiseScale = Literal["shared", "per-recording"]


@dataclass(frozen=True)
class Scale:
    """One number that noise is described by."""

    name: str  # Behind noise. in the parameter's name
    symbol: str  # LaTeX without dollar signs
    meaning: str  # One line for people, worded for what turns
    # Gives the default prior, as a configuration would say it, for the sizes of what was measured
    prior: Callable[[Scales], PriorText]
    # Support
    lower: float = 0.0
    upper: float = np.inf
    # What it is measured like: torque, position, or nothing
    unit: Literal["torque", "position", ""] = "torque"
    # Whether all recordings have the same in any case, as with what correlates the noise
    shared: bool = False
    # Whether the residuals of an estimate say if the noise has it, and how much
    chosen: bool = False

    def read_prior(self, texts: Mapping[str, PriorText], sizes: Scales) -> Prior:
        """Take the prior that a configuration gives, or the default."""
        name = f"noise.{self.name}"
        text, default = (texts[name], False) if name in texts else (self.prior(sizes), True)
        return read_prior(name, text, lower=self.lower, upper=self.upper, default=default)


def up_to(size: float, least: float | None = None) -> PriorText:
    """Spread a prior evenly in the logarithm up to a size."""
    top = float(f"{size:.0e}")
    bottom = 1e-6 * top if least is None else float(f"{least:.0e}")
    return {"distribution": "loguniform", "a": bottom, "b": top}


class NoiseDescription:
    """What any noise model tells of itself."""

    def __init__(
        self, scales: Sequence[Scale], description: str, *, accounts_for_correlation: bool
    ) -> None:
        self.scales, self.description = tuple(scales), description
        self.accounts_for_correlation = accounts_for_correlation
        self.quantities = tuple(scale.name for scale in scales)


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise with scales shared by all recordings, or some for each."""

    # Of the sampled scales, noise.sigma or noise.sigma.<recording>; those of the first recording
    # first
    names: tuple[str, ...]
    # Of each of them: LaTeX, the name of its :class:`Scale`, and prior
    symbols: tuple[str, ...]
    quantities: tuple[str, ...]
    priors: tuple[Prior, ...]
    places: NDArray[np.int64]  # (R, Q) which of the names each recording's scales are

    def scales(self, parameters: Array) -> Array:
        """Scales of every recording, ``(n, len(names))`` to ``(n, R, Q)``."""
        return parameters[:, self.places]

    def fold(self, information: Array) -> Array:
        """Add up information on a scale that several recordings share.

        Shapes: ``information`` (R, Q, Q), returns (len(names), len(names)).
        """
        out = np.zeros((len(self.names), len(self.names)))
        for own, one in zip(self.places, information, strict=True):
            out[np.ix_(own, own)] += one
        return out


def noise_of(
    recordings: Sequence[str],
    scales: Sequence[Scale],
    priors: Mapping[str, Prior],
    scale: NoiseScale,
) -> Noise:
    """Set up the noise of named recordings."""
    own = scale == "per-recording" and len(recordings) > 1
    found: dict[str, tuple[str, str, Prior]] = {}
    places = np.zeros((len(recordings), len(scales)), dtype=np.int64)
    for i, recording in enumerate(recordings):
        for j, one in enumerate(scales):
            name, symbol = f"noise.{one.name}", one.symbol
            prior = priors[name]
            if own and not one.shared:
                name, symbol = f"{name}.{recording}", _numbered(symbol, i + 1)
            found.setdefault(name, (symbol, one.name, prior))
            places[i, j] = list(found).index(name)
    symbols, quantities, given = zip(*found.values(), strict=True)
    return Noise(tuple(found), symbols, quantities, given, places)


def _numbered(symbol: str, number: int) -> str:
    """Add a recording's number; a second subscript would not typeset, so it joins the first."""
    base, _, subscript = symbol.partition("_")
    return f"{base}_{{{subscript},{number}}}" if subscript else f"{symbol}_{{{number}}}"
