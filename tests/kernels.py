"""The kernels of a fresh clone: two workers side by side would each compile all of them."""

import numpy as np

from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.mechanism.forward import simulate, simulate_segments
from bayesfric.mechanism.presets import PRESETS

KNEE = PRESETS["rabbit-knee"]


def compile_simulation():
    """Compile what moves a joint."""
    chain, torque = KNEE.chain(), np.linspace(0.0, 0.5, 8)
    values = chain.vector(KNEE.values)
    simulate(chain, values, torque, 1e-3, substeps=2)
    simulate_segments(chain, values[None], torque, 1e-3, [[0, 8]], [0.0], [0.0])


def compile_likelihood(make_observation):
    """Compile what evaluates the torque's likelihood, sample by sample and by moments."""
    chain = KNEE.chain()
    likelihood = TorqueLikelihood(chain, [make_observation(chain, KNEE.values, n=200)])
    draws = chain.vector(KNEE.values) * np.linspace(0.99, 1.01, 300)[:, None]
    scales = np.full((300, 1, 1), 0.01)
    for form in (likelihood, likelihood.prepared(draws)):
        form.log_density(draws[:1], scales[:1])
        form.log_density(draws, scales)
