"""Load losses one behind the other that a recording does not tell apart are refused."""

import math

import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.estimates.assemble import collinear_losses
from bayesfric.estimates.point_estimate import Estimate, EstimatedValue

TWO = bf.Joint(
    [
        bf.Element("motor", coulomb="symmetric", viscous=True, load_loss="one"),
        bf.Element("gearbox", load_loss="one"),
    ],
    load=bf.Load(inertia=True, first_moment=True, gravity_angle=True),
)


def estimate(motor, gearbox):
    """Give an estimate by pairs of value and sd."""
    pairs = {"motor.load": motor, "gearbox.load": gearbox}
    values = tuple(
        EstimatedValue(name, "", "", "", *pair, kind="parameter") for name, pair in pairs.items()
    )
    return Estimate("input-error", values, 0.1, 100, "")


def test_losses_of_which_none_is_told_are_alike():
    both = ("motor.load", "gearbox.load")
    # measured, UR10e: 0.008 with an sd of 0.062, and 0 on a limit, which has none
    assert collinear_losses(TWO, estimate((0.008, 0.062), (0.0, math.nan)), ()) == both
    assert collinear_losses(TWO, estimate((0.1, math.inf), (0.1, math.inf)), ()) == both
    assert collinear_losses(TWO, estimate((0.1, 0.3), (0.1, 0.3)), ()) == both


def test_losses_that_are_told_or_known_are_not():
    assert collinear_losses(TWO, estimate((0.1, 0.02), (0.2, 0.02)), ()) == ()
    assert collinear_losses(TWO, estimate((0.1, 0.3), (0.1, 0.3)), ("motor.load",)) == ()
    one = bf.Joint.preset("servo-pendulum")
    assert collinear_losses(one, estimate((0.0, math.nan), (0.0, math.nan)), ()) == ()


def test_they_are_refused_before_anything_is_sampled():
    """In order, one behind the other and nothing between, they are one."""
    options = {"rate": 200, "duration": 10, "excitation": "multisine", "torque_noise": 0.01}
    made = bf.simulate(
        bf.Joint.preset("servo-pendulum"), {"gearbox.load": 0.2}, encoder_side="joint", **options
    )
    one = bf.Recording.from_dataframe(made, time="time", position="position", torque="torque")
    with pytest.raises(BadInput, match=r"motor.load, gearbox.load") as refused:
        bf.Model(TWO, one).fit()
    assert 'load_loss = "none"' in refused.value.hint
