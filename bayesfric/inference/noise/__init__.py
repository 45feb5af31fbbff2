"""What is left when the model is subtracted, and every number that it is described by."""

from bayesfric.inference.noise import autoregressive, position
from bayesfric.inference.noise.scale import Scale

SCALES: dict[str, Scale] = {
    scale.name: scale for scale in (*autoregressive.SCALES, *position.SCALES)
}
