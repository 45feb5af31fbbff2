"""Losses that depend on a recorded temperature: read, found again, refused where there is none."""

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.inputs import Inputs, Signal
from tests.axis import swing

JOINT = bf.Joint(
    [bf.Element("motor", inertia=True, coulomb="symmetric", viscous=True, temperature="both")],
    load=bf.Load(first_moment=True),
)
VALUES = {
    "motor.inertia": 0.05,
    "motor.coulomb": 0.2,
    "motor.viscous": 0.1,
    "motor.viscous_temperature": -0.002,
    "motor.coulomb_temperature": -0.003,
    "load.first_moment": 0.3,
}


def recorded(unit="degC", **more):
    """An exact motion and torque, with noise, of a joint that warms from 22 to 40 degC."""
    time = np.arange(8000) * 0.002
    q, qd, qdd = swing(time, ((0.4, 0.8), (1.1, 0.4), (2.7, 0.15)))
    warmth = 22.0 + 18.0 * (1.0 - np.exp(-time / 6.0))
    inputs = Inputs(temperature=Signal(time, warmth))
    torque = inverse_torque(JOINT, JOINT.vector(VALUES), q, qd, qdd, inputs=inputs, time=time)
    torque += 0.01 * np.random.default_rng(1).standard_normal(time.size)
    degrees = warmth + {"degC": 0.0, "K": 273.15}.get(unit, 0.0)
    more = {"temperature": degrees, "units": {"temperature": unit}} | more
    return bf.Recording.from_arrays(time, q, torque, **more)


@pytest.mark.parametrize("unit", ["degC", "K"])
def test_losses_per_kelvin_are_found_again(unit):
    model = bf.Model(JOINT, recorded(unit))
    (found,) = model.estimates(["input-error"])
    for name, value in VALUES.items():
        assert abs(found[name].value - value) < 4.0 * found[name].sd, name
    assert model.identification().directions == ()


def test_explain_tries_them_where_a_temperature_was_recorded():
    plain = bf.Joint(
        [bf.Element("motor", inertia=True, coulomb="symmetric", viscous=True)],
        load=bf.Load(first_moment=True),
    )
    found = bf.Model(plain, recorded()).explain()
    assert found.findings[0].hint == 'mechanism.elements.motor.temperature = "both"'


def test_a_recording_without_one_is_refused():
    with pytest.raises(BadInput, match=r"has no temperature.*temperature = "):
        bf.Model(JOINT, recorded(temperature=None, units={}))


def test_what_is_no_temperature_is_refused():
    with pytest.raises(BadInput, match="'deg' is no temperature; write 'degC' or 'K'"):
        bf.Model(JOINT, recorded("deg"))
