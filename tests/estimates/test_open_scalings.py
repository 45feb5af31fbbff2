"""When the scale between gearbox and leg is open, and when something fixes it."""

import numpy as np
import pytest

from bayesfric.estimates.assemble import open_directions, open_scalings
from bayesfric.estimates.point_estimate import Knowledge
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import PRESETS
from bayesfric.recordings.measurement import Inputs

KNEE = PRESETS["rabbit-knee"]
CHAIN = KNEE.chain()


def knees(make_observation, *masses, sigma=0.01):
    return [
        make_observation(
            CHAIN,
            KNEE.values,
            sigma=sigma,
            amplitude=2.0,
            seed=i,
            added_mass=mass,
            radius=0.35 if mass else 0.0,
            name=f"run {i}",
        )
        for i, mass in enumerate(masses)
    ]


@pytest.mark.parametrize(
    ("fixed", "priors", "masses", "is_open"),
    [
        ({}, {}, (0.0,), True),
        ({"joint.viscous": 0.0}, {}, (0.0,), True),  # zero times any factor is zero
        ({"joint.viscous": 3.12}, {}, (0.0,), False),
        ({"gearbox.load_back": 0.0}, {}, (0.0,), False),  # an alpha of one is known
        # nor does one that passes nothing back: zero is its 1/alpha
        ({"gearbox.load_back": 1.0}, {}, (0.0,), True),
        ({"motor.inertia": 3e-4}, {}, (0.0,), True),
        ({}, {"load.inertia": (0.2, 0.02)}, (0.0,), False),
        ({}, {}, (0.0, 2.0), False),
        ({}, {}, (2.0, 2.0), True),  # the same mass in all might be more leg
        ({"load.inertia": 0.0}, {}, (2.0,), False),
    ],
)
def test_what_fixes_the_scale(make_observation, fixed, priors, masses, is_open):
    observations = knees(make_observation, *masses)
    assert bool(open_scalings(CHAIN, Knowledge(fixed, {}, priors), observations)) is is_open


def test_with_one_mass_in_all_load_and_mass_scale_as_one(make_observation):
    (o,) = knees(make_observation, 2.0)
    (scaling,) = open_scalings(CHAIN, Knowledge(), [o])
    values = CHAIN.vector(KNEE.values)
    low, high = scaling.bounds(values)
    vectors = scaling.scaled(values, np.linspace(low, high, 9))
    torque = inverse_torque(CHAIN, vectors, o.q, o.qd, o.qdd, inputs=Inputs(2.0, 0.35))
    np.testing.assert_allclose(torque, np.tile(torque[0], (9, 1)), atol=1e-12)
    # neither the leg nor a loss gets negative on the way
    assert vectors.min() >= -1e-12
    # the tangent is the derivative of the family
    step = 1e-6
    change = scaling.scaled(values, np.exp(step)) - scaling.scaled(values, np.exp(-step))
    np.testing.assert_allclose(scaling.tangent(values), change / (2 * step), rtol=1e-6, atol=1e-9)
    direction = open_directions(CHAIN, Knowledge(), [o], values)
    np.testing.assert_allclose(direction[0], scaling.tangent(values))
