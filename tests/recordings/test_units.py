"""Units: known conversions, and what is refused."""

from typing import get_args

import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.recordings import units
from tests.conftest import brought

# what a text says in units of SI
KNOWN = {
    "angle": {"rad": 1.0, "deg": np.pi / 180, "°": np.pi / 180, "turn/4096": 2 * np.pi / 4096,
              "rev": 2 * np.pi, "DEG": np.pi / 180},
    "angular_speed": {"rpm": np.pi / 30, "RPM": np.pi / 30, "r/min": np.pi / 30,
                      "rev/min": np.pi / 30, "deg/s": np.pi / 180,
                      "0.229 rpm": 0.229 * np.pi / 30},
    "length": {"mm": 1e-3},
    "speed": {"mm/s": 1e-3},
    "time": {"ms": 1e-3, "µs": 1e-6, "us": 1e-6, "min": 60.0,
             "2 s": 2.0, "10**3 ms": 1.0, "1/50 s": 0.02, "3**2 s": 9.0},
    "torque": {"N m": 1.0, "N*m": 1.0, "Nm": 1.0, "N-m": 1.0, "N·m": 1.0, "mNm": 1e-3,
               "mN m": 1e-3, "kNm": 1e3, "9.84e-5 N m": 9.84e-5, "9.84e-5Nm": 9.84e-5,
               "9.84 mNm/100": 9.84e-5, "kgf cm": 0.0980665, "kg-cm": 0.0980665,
               "kgf.cm": 0.0980665, "N.m": 1.0, "mN.m": 1e-3, "2 Ncm": 0.02,
               "oz-in": 0.00706155181422604,
               "10 oz in": 0.0706155181422604, "lb-ft": 1.3558179483314004,
               "in-lbf": 0.1129848290276167},
    "force": {"N": 1.0},
    "current": {"Amps": 1.0, "mA": 1e-3, "2.69 mA": 2.69e-3},
    "voltage": {"V/885": 1 / 885},
    "resistance": {"3.4 ohm": 3.4, "3.4 Ohm": 3.4, "3.4 V/A": 3.4},
    "frequency": {"100 Hz": 100.0, "1 kHz": 1000.0},
    "mass": {"2 kg": 2.0},
    "torque_constant": {"0.32 N m/A": 0.32, "0.32 Nm/A": 0.32, "32 mNm/A": 0.032,
                        "2.5 oz-in/A": 2.5 * 0.00706155181422604, "3.2 Ncm/A": 0.032,
                        "0.32 N.m/A": 0.32,
                        "0.32 V s/rad": 0.32, "0.1 V/rpm": 0.1 * 30 / np.pi},
    "force_constant": {"35 N/A": 35.0},
}  # fmt: skip
REFUSED = {
    "angle": ("1/4096", "count", "m", "degC"),
    "angular_speed": ("1/s", "Hz"),
    "frequency": ("rpm", "rad/s", "3 kg", "100"),
    "torque": ("%", "N m/rad", "N"),
    "force": ("N m",),
    "torque_constant": ("rpm/V",),
    "time": ("bananas", "", "s s", "1e999 s"),
}  # fmt: skip


@pytest.mark.parametrize("kind", get_args(units.Kind))
def test_what_si_units_are_made_of_is_what_pint_says(kind):
    # with a number in front it is pint that reads
    assert units.quantity(f"1 {units.si(kind)}", kind) == 1.0


@pytest.mark.parametrize("kind", KNOWN)
def test_known(kind):
    for text, value in KNOWN[kind].items():
        assert units.scale([text], kind) == pytest.approx(value, rel=1e-12), text


@pytest.mark.parametrize("kind", REFUSED)
def test_refused(kind):
    for text in REFUSED[kind]:
        with pytest.raises(BadInput, match=r"^my key: .*like '"):
            units.scale([text], kind, "my key")


@pytest.mark.parametrize("text", ["0 V", "-1 V"])
def test_a_unit_is_positive(text):
    with pytest.raises(BadInput, match=r"not positive.*sign = -1"):
        units.scale([text], "voltage", "my key")


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


def test_heavy_libraries_are_loaded_only_when_needed():
    assert brought("bayesfric.recordings", "pint", "pandas", "pyarrow", "scipy.io") == "[]"
