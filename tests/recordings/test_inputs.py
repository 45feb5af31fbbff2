"""What is recorded beside the motion: a dynamometer's torque, and a temperature."""

import numpy as np
import pandas as pd
import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import PRESETS
from bayesfric.recordings.measurement import Inputs, Signal
from tests.axis import swing
from tests.recordings.samples import measured

KNEE = PRESETS["rabbit-knee"]
CHAIN = KNEE.chain()


def recorded(**more):
    """An exact motion and torque, with noise, of a knee that a second motor loads."""
    time = np.arange(8000) * 0.001
    q, qd, qdd = swing(time, ((0.4, 0.8), (1.1, 0.3), (2.7, 0.1)))
    outside = 6.0 * np.sin(2.0 * np.pi * 0.73 * time + 1.0)
    inputs = Inputs(load_torque=Signal(time, outside))
    torque = inverse_torque(CHAIN, CHAIN.vector(KNEE.values), q, qd, qdd, inputs=inputs, time=time)
    torque += 0.001 * np.random.default_rng(1).standard_normal(time.size)
    keys = {"load_torque": outside, "side": "joint"} | more
    return bf.Recording.from_arrays(time, q, torque, **keys)


def test_it_gives_leg_and_gearbox_their_scale():
    model = bf.Model(CHAIN, recorded())
    assert model.identification().directions == ()
    (estimate,) = model.estimates(["input-error"])
    for name in ("load.first_moment", "gearbox.load_drive", "gearbox.load_back", "load.inertia"):
        assert estimate[name].determined, name
        assert abs(estimate[name].value - KNEE.values[name]) < 4.0 * estimate[name].sd, name
    assert any("fixed by the known load" in note for note in estimate.notes)
    (estimate,) = bf.Model(CHAIN, recorded(load_torque=None)).estimates(["input-error"])
    assert not estimate["load.first_moment"].determined


def test_it_has_a_unit_and_a_sign():
    time = np.arange(400) * 0.01
    frame = pd.DataFrame({"t": time, "q": np.sin(4 * time), "tau": np.cos(time), "b": np.sin(time)})

    def load_torque(unit):
        keys = {"time": "t", "position": "q", "torque": "tau"}
        keys["load_torque"] = {"column": "b", "unit": unit, "sign": -1}
        return measured(bf.Recording.from_dataframe(frame, **keys)).inputs.load_torque.values

    np.testing.assert_allclose(load_torque("mN m"), -1e-3 * np.sin(time), rtol=1e-12)
    with pytest.raises(BadInput, match="unit of load_torque"):
        load_torque("rad")


# -- losses that depend on a recorded temperature

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


def warmed(unit="degC", **more):
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
    model = bf.Model(JOINT, warmed(unit))
    (found,) = model.estimates(["input-error"])
    for name, value in VALUES.items():
        assert abs(found[name].value - value) < 4.0 * found[name].sd, name
    assert model.identification().directions == ()


def test_a_recording_without_one_is_refused():
    with pytest.raises(BadInput, match=r"has no temperature.*temperature = "):
        bf.Model(JOINT, warmed(temperature=None, units={}))


def test_what_is_no_temperature_is_refused():
    with pytest.raises(BadInput, match="'deg' is no temperature; write 'degC' or 'K'"):
        bf.Model(JOINT, warmed("deg"))
