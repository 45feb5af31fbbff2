"""A dynamometer: the torque on the load is measured, and gives the gearbox its scale."""

import numpy as np
import pandas as pd
import pytest

import bayesfric as bf
from bayesfric.errors import BadInput
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.presets import PRESETS
from bayesfric.recordings.inputs import Inputs, Signal
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
    (found,) = bf.Model(CHAIN, recorded()).estimates(["input-error"])
    for name in ("load.first_moment", "gearbox.load_drive", "gearbox.load_back", "load.inertia"):
        assert found[name].determined, name
        assert abs(found[name].value - KNEE.values[name]) < 4.0 * found[name].sd, name
    assert any("fixed by the known load" in note for note in found.notes)


def test_without_it_the_scale_is_open():
    (found,) = bf.Model(CHAIN, recorded(load_torque=None)).estimates(["input-error"])
    assert not found["load.first_moment"].determined


def test_nothing_is_open_before_sampling():
    assert bf.Model(CHAIN, recorded()).identification().directions == ()


def test_what_is_no_torque_is_refused():
    with pytest.raises(BadInput, match="load_torque"):
        bf.Model(CHAIN, recorded(units={"load_torque": "rad"}))


# -- several, and on the side of the motor


def table_of(**columns):
    time = np.arange(400) * 0.01
    q = np.sin(2 * np.pi * 0.7 * time)
    given = {"t": time, "q": q, "tau": 0.3 * np.cos(time), **columns}
    return pd.DataFrame(given)


def pushed(load_torque, ratio=50.0, **columns):
    recording = bf.Recording.from_dataframe(
        table_of(**columns), time="t", position="q", torque="tau", side="joint",
        load_torque=load_torque,
    )  # fmt: skip
    return measured(recording, ratio=ratio)


A, B = np.linspace(-1.0, 2.0, 400), np.sin(np.arange(400))


def test_several_are_summed_with_their_signs_and_sides():
    found = pushed(
        [
            {"column": "a", "unit": "N m", "sign": -1},
            {"column": "b", "unit": "mN m", "side": "motor"},
        ],
        a=A,
        b=B,
    )
    np.testing.assert_allclose(found.inputs.load_torque.values, -A + 50.0 * 1e-3 * B, rtol=1e-12)
    assert [step for step in found.steps if "load torque: sum of 2" in step and "50" in step]


def test_one_in_a_list_is_one():
    listed, plain = (pushed(x, a=A) for x in ([{"column": "a"}], "a"))
    np.testing.assert_array_equal(listed.inputs.load_torque.values, plain.inputs.load_torque.values)
    np.testing.assert_array_equal(plain.inputs.load_torque.values, A)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ([], "names no channel"),
        ([{"column": "a"}, {"column": "a"}], "is taken both"),
        ([{"column": "a", "side": "gear"}], "side"),
        ([{"column": "a", "unit": "rad"}], "unit of load_torque"),
        ([{"column": "c"}], "does not exist"),
    ],
)
def test_what_cannot_be_summed_is_refused(given, says):
    with pytest.raises(BadInput, match=says):
        pushed(given, a=A)


def test_several_are_saved_with_a_run(tmp_path):
    recording = bf.Recording.from_dataframe(
        table_of(a=A, b=B), time="t", position="q", torque="tau",
        load_torque=[{"column": "a"}, {"column": 5, "side": "motor"}],
    )  # fmt: skip
    again = recording.saved(tmp_path / "one.csv")
    one, two = map(measured, (recording, again))
    np.testing.assert_array_equal(one.inputs.load_torque.values, two.inputs.load_torque.values)
