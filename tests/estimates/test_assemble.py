"""When the scale between gearbox and leg is open, units, and losses that are collinear."""

import math

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.estimates.assemble import (
    collinear_losses,
    open_directions,
    open_scalings,
    units_of,
)
from bayesfric.estimates.point_estimate import Estimate, EstimatedValue, Knowledge
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import PRESETS
from bayesfric.recordings.measurement import Inputs
from tests.axis import recording_of

KNEE, SERVO = PRESETS["rabbit-knee"], PRESETS["servo-pendulum"]
CHAIN = KNEE.chain()


@pytest.fixture
def loaded(make_observation):
    """Recordings of the knee with known masses."""

    def make(*masses):
        load = [{"added_mass": m, "radius": 0.35 if m else 0.0} for m in masses]
        return [make_observation(CHAIN, KNEE.values, amplitude=2.0, **given) for given in load]

    return make


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
def test_what_fixes_the_scale(loaded, fixed, priors, masses, is_open):
    observations = loaded(*masses)
    assert bool(open_scalings(CHAIN, Knowledge(fixed, {}, priors), observations)) is is_open


def test_with_one_mass_in_all_load_and_mass_scale_as_one(loaded):
    (o,) = loaded(2.0)
    (scaling,) = open_scalings(CHAIN, Knowledge(), [o])
    values = CHAIN.vector(KNEE.values)
    vectors = scaling.scaled(values, np.linspace(*scaling.bounds(values), 9))
    torque = inverse_torque(CHAIN, vectors, o.q, o.qd, o.qdd, inputs=Inputs(2.0, 0.35))
    np.testing.assert_allclose(torque, np.tile(torque[0], (9, 1)), atol=1e-12)
    # neither the leg nor a loss gets negative on the way
    assert vectors.min() >= -1e-12
    direction = open_directions(CHAIN, Knowledge(), [o], values)
    np.testing.assert_allclose(direction[0], scaling.tangent(values))


def test_a_unit_of_a_parameter_is_itself_and_of_a_load_loss_one_over_alpha():
    """Eq. (6): 1/alpha_1 is 1 + mu_1, and 1/alpha_2 is 1 - mu_2, whichever its sign."""
    v = KNEE.values | {"joint.viscous": -3.0, "gearbox.load_back": 1.4}
    expected = {name: abs(value) for name, value in v.items()}
    expected |= {"gearbox.load_drive": 1.0 + v["gearbox.load_drive"], "gearbox.load_back": 0.4}
    for names in (CHAIN.names, ("motor.inertia", "gearbox.load_drive")):
        units = units_of(CHAIN, names, CHAIN.vector(v))
        np.testing.assert_allclose(units, [expected[name] for name in names])
    servo = SERVO.chain()  # one mu of both power flows has no alpha
    values = servo.vector(SERVO.values)
    np.testing.assert_allclose(units_of(servo, servo.names, values), np.abs(values))


TWO = bf.Joint(
    [
        bf.Element("motor", coulomb="symmetric", viscous=True, load_loss="one"),
        bf.Element("gearbox", load_loss="one"),
    ],
    load=bf.Load(inertia=True, first_moment=True, gravity_angle=True),
)
BOTH = ("motor.load", "gearbox.load")


@pytest.mark.parametrize(
    ("motor", "gearbox", "known", "collinear"),
    [
        # measured, UR10e: 0.008 with an sd of 0.062, and 0 on a limit, which has none
        ((0.008, 0.062), (0.0, math.nan), (), BOTH),
        ((0.1, math.inf), (0.1, math.inf), (), BOTH),
        ((0.1, 0.3), (0.1, 0.3), (), BOTH),
        ((0.1, 0.3), (0.1, 0.3), ("motor.load",), ()),
        ((0.1, 0.02), (0.2, 0.02), (), ()),
    ],
)
def test_losses_are_collinear_where_none_is_identified(motor, gearbox, known, collinear):
    values = [
        EstimatedValue(name, "", "", "", *pair, kind="parameter")
        for name, pair in zip(BOTH, (motor, gearbox), strict=True)
    ]
    estimate = Estimate("input-error", tuple(values), 0.1, 100, "")
    assert collinear_losses(TWO, estimate, known) == collinear
    assert collinear_losses(SERVO.chain(), estimate, known) == ()


def test_collinear_losses_are_refused_before_anything_is_sampled():
    """In series, with nothing between them, they are one number."""
    options = {"rate": 200, "duration": 10, "excitation": "multisine", "torque_noise": 0.01}
    frame = bf.simulate(SERVO.chain(), {"gearbox.load": 0.2}, encoder_side="joint", **options)
    with pytest.raises(BadInput, match=r"motor.load, gearbox.load") as refused:
        bf.Model(TWO, recording_of(frame)).fit()
    assert 'load_loss = "none"' in refused.value.hint
