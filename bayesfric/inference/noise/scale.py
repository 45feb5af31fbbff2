"""The numbers that noise is described by, and which of them each recording has."""

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

    name: str  # behind "noise." in the parameter's name
    symbol: str  # LaTeX without dollar signs
    meaning: str  # one line for people, worded for what turns
    prior: Callable[[Scales], PriorText]  # the default one, for the sizes of what was measured
    lower: float = 0.0
    upper: float = np.inf
    unit: Literal["torque", "position", ""] = "torque"  # what it is measured like
    # whether all recordings have the same in any case: how noise is shaped, its memory or its
    # tails, comes from one bench
    shared: bool = False
    # whether the residuals of an estimate say if the noise has it, and how much
    chosen: bool = False

    def read_prior(self, texts: Mapping[str, PriorText], sizes: Scales) -> Prior:
        """Take the prior that a configuration gives by parameter name, or the default."""
        name = f"noise.{self.name}"
        text, default = (texts[name], False) if name in texts else (self.prior(sizes), True)
        return read_prior(name, text, lower=self.lower, upper=self.upper, default=default)


def up_to(size: float, least: float | None = None) -> PriorText:
    """Spread a prior evenly in the logarithm, from a millionth or from ``least`` up to a size.

    The ends are rounded to one digit.
    """
    top = float(f"{size:.0e}")
    bottom = 1e-6 * top if least is None else float(f"{least:.0e}")
    return {"distribution": "loguniform", "a": bottom, "b": top}


class NoiseDescription:
    """What any noise tells of itself.

    Attributes
    ----------
    scales
        What it is described by.
    description
        In words, for the record.
    accounts_for_correlation
        Whether what it is noise of may be correlated.
    """

    def __init__(
        self, scales: Sequence[Scale], description: str, *, accounts_for_correlation: bool
    ) -> None:
        self.scales, self.description = tuple(scales), description
        self.accounts_for_correlation = accounts_for_correlation
        self.quantities = tuple(scale.name for scale in scales)


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise with scales shared by all recordings, or some for each."""

    # noise.sigma, or noise.sigma.<recording>; the quantities of the first recording first
    names: tuple[str, ...]
    symbols: tuple[str, ...]  # in LaTeX
    quantities: tuple[str, ...]  # Scale.name of each
    priors: tuple[Prior, ...]
    places: NDArray[np.int64]  # (n_recordings, quantities): which name each one's scales are

    def scales(self, parameters: Array) -> Array:
        """Scales of every recording: ``(n, len(names))`` to ``(n, n_recordings, quantities)``."""
        return parameters[:, self.places]

    def fold(self, information: Array) -> Array:
        """Bring information of every recording's scales, ``(R, Q, Q)``, to that of the names."""
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
    """Set up the noise of the named recordings; ``priors`` are by ``noise.<quantity>``."""
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
