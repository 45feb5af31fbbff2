"""Load-dependent frictions in series that a recording does not distinguish are refused."""

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
    assert collinear_losses(TWO, estimate(motor, gearbox), known) == collinear
    single = bf.Joint.preset("servo-pendulum")
    assert collinear_losses(single, estimate(motor, gearbox), known) == ()


def test_they_are_refused_before_anything_is_sampled():
    """In series, with nothing between them, they are one number."""
    options = {"rate": 200, "duration": 10, "excitation": "multisine", "torque_noise": 0.01}
    frame = bf.simulate(
        bf.Joint.preset("servo-pendulum"), {"gearbox.load": 0.2}, encoder_side="joint", **options
    )
    recording = bf.Recording.from_dataframe(
        frame, time="time", position="position", torque="torque"
    )
    with pytest.raises(BadInput, match=r"motor.load, gearbox.load") as refused:
        bf.Model(TWO, recording).fit()
    assert 'load_loss = "none"' in refused.value.hint
