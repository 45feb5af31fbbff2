"""What is left when the model is subtracted: noise of unknown scale."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.inference.priors import Prior

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


def support(quantity: str) -> tuple[float, float]:
    """Give the lowest and highest value a scale may have."""
    if quantity.startswith("pacf_"):
        return -1.0, 1.0
    # below one degree of freedom not even the middle of a Student-t is worth an average
    return (1.0 if quantity == "dof" else 0.0), math.inf


@dataclass(frozen=True)
class Noise:
    """Gaussian noise with scales shared by all recordings, or some for each.

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
    n_recordings
        Number of recordings the scales serve.
    """

    names: tuple[str, ...]
    symbols: tuple[str, ...]
    quantities: tuple[str, ...]
    priors: tuple[Prior, ...]
    n_recordings: int

    @property
    def _each(self) -> int:
        """Scales of one recording."""
        return len(set(self.quantities))

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
        n = parameters.shape[0]
        split = parameters.reshape(n, -1, self._each)
        return np.broadcast_to(split, (n, self.n_recordings, self._each))

    def fold(self, information: Array) -> Array:
        """Information of every recording's scales to that of the parameters.

        Parameters
        ----------
        information
            ``(n_recordings, quantities, quantities)`` of the logarithms.

        Returns
        -------
        ndarray
            ``(len(names), len(names))``
        """
        if len(self.names) == self._each:
            return np.asarray(information.sum(axis=0))
        out = np.zeros((len(self.names), len(self.names)))
        for r in range(self.n_recordings):
            own = slice(r * self._each, (r + 1) * self._each)
            out[own, own] = information[r]
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
        ``shared`` by all recordings or some ``per-recording``.
    """
    own = scale == "per-recording" and len(recordings) > 1
    names, symbols, kinds, given = [], [], [], []
    for i, recording in enumerate(recordings if own else recordings[:1]):
        for quantity in quantities:
            symbol = _SYMBOLS[quantity]
            if own:
                # a second subscript would not typeset: it joins the first
                symbol = (
                    f"{symbol.partition('_')[0]}_{{{symbol.partition('_')[2]},{i + 1}}}"
                    if "_" in symbol
                    else f"{symbol}_{{{i + 1}}}"
                )
            names.append(f"noise.{quantity}.{recording}" if own else f"noise.{quantity}")
            symbols.append(symbol)
            kinds.append(quantity)
            given.append(priors[f"noise.{quantity}"])
    return Noise(tuple(names), tuple(symbols), tuple(kinds), tuple(given), len(recordings))
