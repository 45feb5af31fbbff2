"""What is left when the model is subtracted, and every number that it is described by.

Torque residuals are white or autoregressive; where positions are explained, both position and
torque samples are noisy. ``SCALES`` holds every such number by name, as it stands behind
``noise.`` in a configuration's priors.
"""

from bayesfric.inference.noise import autoregressive, position
from bayesfric.inference.noise.scale import Scale

SCALES: dict[str, Scale] = {
    scale.name: scale for scale in (*autoregressive.SCALES, *position.SCALES)
}
