"""What is left when the model is subtracted: noise of unknown scale."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.inference.prior.priors import Prior

Array = NDArray[np.float64]
NoiseScale = Literal["shared", "per-recording"]

# LaTeX symbols of the scales a likelihood may have.
_SYMBOLS = {
    "sigma": r"\sigma",
    "dof": r"\nu",
    "torque": r"\sigma_\Gamma",
    "position": r"\sigma_q",
    **{f"pacf_{k}": rf"\phi_{{{k}{k}}}" for k in range(1, 10)},
}


# Largest partial autocorrelation that the package takes for noise by itself. What remembers more
# in a band that the motion fills is no noise but something the model lacks: a memory beyond
# would take all that is slow for noise, the motion's own effects among it.
MEMORY = 0.95


def support(quantity: str) -> tuple[float, float]:
    """Give the lowest and highest value a scale may have."""
    if quantity.startswith("pacf_"):
        return -1.0, 1.0
    # below one degree of freedom not even the middle of a Student-t is worth an average
    return (1.0 if quantity == "dof" else 0.0), math.inf


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise with scales shared by all recordings, or some for each.

    Attributes
    ----------
    names
        Parameter names: ``noise.sigma``, or ``noise.sigma.<recording>``; the quantities
        of the first recording first.
    symbols
        LaTeX symbols without dollar signs.
    quantities
        Quantity of each name, as the likelihood calls them.
    priors
        One each.
    places
        ``(n_recordings, quantities)`` which name each recording's scales are.
    """

    names: tuple[str, ...]
    symbols: tuple[str, ...]
    quantities: tuple[str, ...]
    priors: tuple[Prior, ...]
    places: NDArray[np.int64]

    def scales(self, parameters: Array) -> Array:
        """Noise scales of every recording.

        Parameters
        ----------
        parameters
            ``(n, len(names))``

        Returns
        -------
        ndarray
            ``(n, n_recordings, quantities)``
        """
        return parameters[:, self.places]

    def fold(self, information: Array) -> Array:
        """Information of every recording's scales to that of the parameters.

        Parameters
        ----------
        information
            ``(n_recordings, quantities, quantities)``

        Returns
        -------
        ndarray
            ``(len(names), len(names))``
        """
        out = np.zeros((len(self.names), len(self.names)))
        for own, one in zip(self.places, information, strict=True):
            out[np.ix_(own, own)] += one
        return out


def noise_model(
    recordings: Sequence[str],
    quantities: Sequence[str],
    priors: Mapping[str, Prior],
    scale: NoiseScale,
) -> Noise:
    """Set up the noise of the named recordings.

    Parameters
    ----------
    recordings
        Their names.
    quantities
        Scales that the likelihood has, such as ``sigma``.
    priors
        Of every scale, by ``noise.<quantity>``.
    scale
        ``shared`` by all recordings or some ``per-recording``. How noise is shaped, its
        memory or its tails, is shared in any case: it comes from one bench.
    """
    own = scale == "per-recording" and len(recordings) > 1
    names: list[str] = []
    symbols, kinds, given = [], [], []
    places = np.zeros((len(recordings), len(quantities)), dtype=np.int64)
    for i, recording in enumerate(recordings):
        for j, quantity in enumerate(quantities):
            apart = own and not (quantity == "dof" or quantity.startswith("pacf_"))
            name = f"noise.{quantity}.{recording}" if apart else f"noise.{quantity}"
            if name not in names:
                names.append(name)
                symbols.append(
                    _numbered(_SYMBOLS[quantity], i + 1) if apart else _SYMBOLS[quantity]
                )
                kinds.append(quantity)
                given.append(priors[f"noise.{quantity}"])
            places[i, j] = names.index(name)
    return Noise(tuple(names), tuple(symbols), tuple(kinds), tuple(given), places)


def _numbered(symbol: str, number: int) -> str:
    """Add a recording's number; a second subscript would not typeset, so it joins the first."""
    base, _, subscript = symbol.partition("_")
    return f"{base}_{{{subscript},{number}}}" if subscript else f"{symbol}_{{{number}}}"
