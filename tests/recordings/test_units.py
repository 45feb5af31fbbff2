"""Units: known conversions, and what is refused."""

from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesfric.errors import BadInput
from bayesfric.recordings import units
from tests.conftest import brought

KNOWN = [
    ("rad", "angle", 1.0),
    ("deg", "angle", np.pi / 180),
    ("°", "angle", np.pi / 180),
    ("turn/4096", "angle", 2 * np.pi / 4096),
    ("rev", "angle", 2 * np.pi),
    ("rpm", "angular_speed", np.pi / 30),
    ("rev/min", "angular_speed", np.pi / 30),
    ("deg/s", "angular_speed", np.pi / 180),
    ("0.229 rpm", "angular_speed", 0.229 * np.pi / 30),
    ("mm", "length", 1e-3),
    ("mm/s", "speed", 1e-3),
    ("ms", "time", 1e-3),
    ("µs", "time", 1e-6),
    ("us", "time", 1e-6),
    ("min", "time", 60.0),
    ("N m", "torque", 1.0),
    ("N*m", "torque", 1.0),
    ("Nm", "torque", 1.0),
    ("N-m", "torque", 1.0),
    ("N·m", "torque", 1.0),
    ("mNm", "torque", 1e-3),
    ("mN m", "torque", 1e-3),
    ("kNm", "torque", 1e3),
    ("9.84e-5 N m", "torque", 9.84e-5),
    ("9.84e-5Nm", "torque", 9.84e-5),
    ("9.84 mNm/100", "torque", 9.84e-5),
    ("kgf cm", "torque", 0.0980665),
    ("N", "force", 1.0),
    ("mA", "current", 1e-3),
    ("2.69 mA", "current", 2.69e-3),
    ("V/885", "voltage", 1 / 885),
    ("3.4 ohm", "resistance", 3.4),
    ("3.4 Ohm", "resistance", 3.4),
    ("3.4 V/A", "resistance", 3.4),
    ("100 Hz", "frequency", 100.0),
    ("1 kHz", "frequency", 1000.0),
    ("2 kg", "mass", 2.0),
    ("0.32 N m/A", "torque_constant", 0.32),
    ("0.32 Nm/A", "torque_constant", 0.32),
    ("32 mNm/A", "torque_constant", 0.032),
    ("0.32 V s/rad", "torque_constant", 0.32),
    ("0.1 V/rpm", "torque_constant", 0.1 * 30 / np.pi),
    ("35 N/A", "force_constant", 35.0),
]


@pytest.mark.parametrize("kind", get_args(units.Kind))
def test_what_si_units_are_made_of_is_what_pint_says(kind):
    # with a number in front it is pint that reads
    assert units.quantity(f"1 {units.si(kind)}", kind) == 1.0


@pytest.mark.parametrize(("text", "kind", "value"), KNOWN)
def test_known(text, kind, value):
    assert units.scale([text], kind) == pytest.approx(value, rel=1e-12)
    assert 2.0 * units.scale([text], kind, "x") == pytest.approx(2 * value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("1/4096", "angle"),
        ("count", "angle"),
        ("m", "angle"),
        ("1/s", "angular_speed"),
        ("Hz", "angular_speed"),
        ("rpm", "frequency"),
        ("rad/s", "frequency"),
        ("%", "torque"),
        ("N m/rad", "torque"),
        ("N", "torque"),
        ("N m", "force"),
        ("rpm/V", "torque_constant"),
        ("3 kg", "frequency"),
        ("100", "frequency"),
        ("bananas", "time"),
        ("", "time"),
        ("s s", "time"),
        ("9**9**9**9 s", "time"),
        ("2**99999999 s", "time"),
        ("__import__('os')", "time"),
        ("s" * 500, "time"),
        ("1e999 s", "time"),
        ("degC", "angle"),
    ],
)
def test_refused(text, kind):
    with pytest.raises(BadInput) as caught:
        units.scale([text], kind, "my key")
    assert str(caught.value).startswith("my key: ")
    assert "like '" in str(caught.value)


@pytest.mark.parametrize("text", ["0 V", "-1 V"])
def test_a_unit_is_positive(text):
    with pytest.raises(BadInput, match=r"not positive.*sign = -1"):
        units.scale([text], "voltage", "my key")


def test_an_angle_without_its_unit_is_asked_for():
    with pytest.raises(BadInput, match="write 'turn/4096'"):
        units.scale(["1/4096"], "angle", "position")


@pytest.mark.parametrize(("text", "kind"), [("mm", "angle"), ("m/s", "angular_speed")])
def test_what_slides_is_told_its_key(text, kind):
    with pytest.raises(BadInput, match='motion = "linear"'):
        units.scale([text], kind, "my key")


def test_product_of_units():
    assert units.scale(["V", "35.15 N/V"], "force", "x") == pytest.approx(35.15)
    assert units.scale(["%", "9.84 mN m"], "torque", "x") == pytest.approx(9.84e-5)
    assert units.scale(["count", "2 N m/count"], "torque", "x") == pytest.approx(2)
    with pytest.raises(BadInput, match="torque"):
        units.scale(["V", "35.15 N/V"], "torque", "x")


# the first unit read pays for setting pint up
@settings(deadline=None)
@given(st.text(max_size=30), st.sampled_from(["angle", "torque", "time", "frequency"]))
def test_any_text_is_read_or_refused(text, kind):
    try:
        value = units.scale([text], kind)
    except BadInput:
        return
    assert value > 0


# the first unit read pays for setting pint up
@settings(deadline=None)
@given(st.floats(1e-9, 1e9), st.sampled_from(["rad", "deg", "turn"]))
def test_a_number_in_front_is_a_factor(number, unit):
    one = units.scale([unit], "angle")
    assert units.scale([f"{number!r} {unit}"], "angle") == pytest.approx(number * one, rel=1e-12)


def test_heavy_libraries_are_loaded_only_when_needed():
    assert brought("bayesfric.recordings", "pint", "pandas", "pyarrow", "scipy.io") == "[]"
