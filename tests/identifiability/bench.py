"""The simulated knee (Table 3 of the paper) and a plain axis, at their true values."""

import numpy as np

from bayesfric.inference.fitting import make_target, read_priors
from bayesfric.mechanism.joint import PRESETS

KNEE, AXIS = PRESETS["rabbit-knee"], PRESETS["motor-axis"]
CHAIN = KNEE.chain()
VALUES = CHAIN.vector(KNEE.values)
PERIOD, SIGMA = 1e-3, 0.02


def problem(*observations, texts=None, chain=CHAIN, values=KNEE.values, sigma=SIGMA):
    """Give the target, and the truth with the noise's scale."""
    target = make_target(
        chain, observations, read_priors(chain, texts or {}, observations), "shared"
    )
    return target, np.array([values[name] for name in target.free] + [sigma])
