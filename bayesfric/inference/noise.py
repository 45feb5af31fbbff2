"""What is left when the model is subtracted: noise of unknown scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.inference.priors import Prior

NoiseScale = Literal["shared", "per-recording"]


@dataclass(frozen=True)
class WhiteNoise:
    """Independent Gaussian residuals with one scale, or one for each recording.

    Attributes
    ----------
    names
        Parameter names: ``noise.sigma``, or ``noise.sigma.<recording>``.
    symbols
        LaTeX symbols without dollar signs.
    priors
        One each.
    n_recordings
        Number of recordings the scales serve.
    """

    names: tuple[str, ...]
    symbols: tuple[str, ...]
    priors: tuple[Prior, ...]
    n_recordings: int

    def scales(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """Noise scale of every recording.

        Parameters
        ----------
        parameters
            ``(n, len(names))``

        Returns
        -------
        ndarray
            ``(n, n_recordings)``
        """
        return np.broadcast_to(parameters, (parameters.shape[0], self.n_recordings))

    def counts(self, outputs: NDArray[np.int64]) -> NDArray[np.int64]:
        """Count the outputs that each scale is estimated from.

        ``outputs`` ``(n_recordings,)`` counts those of each recording.
        """
        return outputs if len(self.names) > 1 else outputs.sum(keepdims=True)


def white_noise(recordings: Sequence[str], prior: Prior, scale: NoiseScale) -> WhiteNoise:
    """Set up white noise for the named recordings.

    Parameters
    ----------
    recordings
        Their names.
    prior
        Of every scale.
    scale
        ``shared`` by all recordings or one ``per-recording``.
    """
    if scale == "shared" or len(recordings) == 1:
        return WhiteNoise(("noise.sigma",), (r"\sigma",), (prior,), len(recordings))
    return WhiteNoise(
        tuple(f"noise.sigma.{name}" for name in recordings),
        tuple(rf"\sigma_{{{i + 1}}}" for i in range(len(recordings))),
        (prior,) * len(recordings),
        len(recordings),
    )
