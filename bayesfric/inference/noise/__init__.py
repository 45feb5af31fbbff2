"""Noise models and their scales; ``SCALES`` holds each by its name behind ``noise.`` in priors."""

from bayesfric.inference.noise import autoregressive, position
from bayesfric.inference.noise.scale import Scale

SCALES: dict[str, Scale] = {
    scale.name: scale for scale in (*autoregressive.SCALES, *position.SCALES)
}
