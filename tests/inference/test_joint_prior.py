"""All priors at once are the product of each, inside the supports and at their edges."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bayesfric.inference.prior.priors import JointPrior, read_prior

INF = float("inf")
TEXTS = [
    {"distribution": "norm", "loc": 0.3, "scale": 0.7},
    {"distribution": "halfnorm", "scale": 0.4},
    {"distribution": "halfnorm", "loc": 0.1, "scale": 0.4},
    {"distribution": "lognorm", "s": 0.8, "scale": 0.2},
    {"distribution": "lognorm", "s": 0.3, "loc": 0.05, "scale": 2.0},
    {"distribution": "loguniform", "a": 1e-3, "b": 10.0},
    {"distribution": "loguniform", "a": 1e-3, "b": 10.0, "loc": 0.2, "scale": 2.0},
    [0.1, 2.5],
    {"distribution": "gamma", "a": 2.0, "scale": 0.5},
    {"distribution": "truncnorm", "a": -0.5, "b": 3.0, "loc": 0.4, "scale": 0.3},
]
PRIORS = [read_prior(f"p{i}", text, lower=0.0, upper=INF) for i, text in enumerate(TEXTS)]


@given(
    st.lists(st.integers(0, len(PRIORS) - 1), min_size=1, max_size=12),
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.1, 1.0, 10.0]),
)
def test_it_is_the_product_of_each(chosen, seed, size):
    priors = [PRIORS[i] for i in chosen]
    rng = np.random.default_rng(seed)
    x = size * rng.standard_normal((7, len(priors))) ** 2
    x[3] = np.stack([p.draw(1, rng) for p in priors], axis=1)
    x[4, 0] = -0.1
    x[5] = [p.lower for p in priors]
    x[6, -1] = math.nan
    one_by_one = sum(p.log_density(x[:, j]) for j, p in enumerate(priors))
    np.testing.assert_allclose(
        JointPrior(priors).log_density(x), one_by_one, rtol=1e-12, atol=1e-10
    )
