"""What a point estimate takes from priors."""

import math

import pytest

from bayesfric.inference.fitting import read_priors
from bayesfric.inference.prior.as_knowledge import as_knowledge
from bayesfric.inference.prior.priors import read_prior
from bayesfric.mechanism.presets import PRESETS

AXIS = PRESETS["motor-axis"]


def test_fixed_ranged_and_told(make_observation):
    chain = AXIS.chain()
    o = make_observation(chain, AXIS.values)
    texts = {
        "motor.inertia": 0.01,
        "motor.viscous": [0.01, 0.2],
        "motor.coulomb": {"distribution": "norm", "loc": 0.2, "scale": 0.02},
    }
    found = as_knowledge(chain, read_priors(chain, texts, [o]))
    assert found.fixed == {"motor.inertia": 0.01}
    assert found.bounds["motor.viscous"] == (0.01, 0.2)
    # ten sds above its bound: the cut does not show
    assert found.told == {"motor.coulomb": pytest.approx((0.2, 0.02))}
    # a default prior is a guess of ours, not knowledge
    assert found.bounds["offset"] == (-math.inf, math.inf)


def test_a_cut_distribution_has_the_cut_ones_mean():
    prior = read_prior(
        "x", {"distribution": "norm", "loc": 0.0, "scale": 1.0}, lower=0.0, upper=math.inf
    )
    # a normal cut at its middle is a half-normal
    assert prior.mean() == pytest.approx(math.sqrt(2.0 / math.pi), rel=1e-3)
    assert prior.sd() == pytest.approx(math.sqrt(1.0 - 2.0 / math.pi), rel=1e-3)
    fixed = read_prior("x", 3.0, lower=0.0, upper=math.inf)
    assert (fixed.mean(), fixed.sd()) == (3.0, 0.0)
