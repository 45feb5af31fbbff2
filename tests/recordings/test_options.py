"""What a source and a processing may say."""

import pytest
from pydantic import ValidationError

from bayesfric.recordings import Channel, Current, Position, Processing, Source, Torque, Voltage

from .samples import source

TORQUE = Torque(column="tau", unit="N m")
CURRENT = Current(column="i", unit="A", torque_constant="0.3 N m/A")


def test_quantities_with_units():
    used = source(start="500 ms", stop=8, added_mass="2 kg", radius="35 cm", exclude=[["1 s", 2]])
    assert (used.start, used.stop) == (0.5, 8.0)
    assert (used.added_mass, used.radius) == pytest.approx((2.0, 0.35))
    assert used.exclude == ((1.0, 2.0),)
    assert source(time=None, rate="1 kHz").rate == 1000.0
    processing = Processing(lowpass="0.1 kHz", band="20 Hz", trim="100 ms", dead_zone="1 deg/s")
    assert (processing.lowpass, processing.band, processing.trim) == (100.0, 20.0, 0.1)
    assert Processing(lowpass="off").lowpass == 0.0


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("lowpass", "3 kg", "expected a frequency like '100 Hz', got '3 kg'"),
        ("lowpass", "-3 Hz", "greater than or equal to 0"),
        ("lowpass", float("nan"), ""),
        ("lowpass", True, "expected a number"),
        ("band", 0, "greater than 0"),
        ("decimate", 0, "greater than or equal to 1"),
        ("order", 0, "greater than or equal to 1"),
        ("dead_zone", "1 Hz", "expected an angular speed"),
        ("dead_zone", -1.0, "0 or more"),
        ("trim", "1 Hz", "expected a time"),
        ("resample", "often", "expected a time"),
        ("resample", "0 s", "expected 'auto'"),
        ("gap", 1, "greater than 1"),
        ("lowpas", 3, "Extra inputs"),
    ],
)
def test_bad_processing(key, value, message):
    with pytest.raises(ValidationError) as caught:
        Processing(**{key: value})
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rate": "1 kHz"}, "exactly one of 'time'"),
        ({"time": None}, "exactly one of 'time'"),
        ({"torque": None}, "got none"),
        ({"current": CURRENT}, "got 'torque' and 'current'"),
        ({"start": 3, "stop": 2}, "must lie after"),
        ({"exclude": [[3, 2]]}, "must end after"),
        ({"exclude": [[3]]}, "exclude"),
        ({"delimiter": ",", "decimal": ","}, "both"),
        ({"delimiter": "::"}, "delimiter"),
        ({"file": []}, "names no file"),
        ({"file": ""}, "names no file"),
        ({"added_mass": "2 m"}, "expected a mass like '2 kg', got '2 m'"),
        ({"added_mass": -1}, "greater than or equal to 0"),
        ({"skip_rows": -1}, "greater than or equal to 0"),
        ({"format": "xls"}, "format"),
        ({"time": None, "rate": "5 ms"}, "expected a frequency"),
        ({"position": {"column": 0, "unit": "rad"}}, "numbered from 1"),
        ({"position": {"column": "q", "unit": "rad", "side": "left"}}, "side"),
        ({"motion": "rotary"}, "Extra inputs"),
    ],
)
def test_bad_source(changes, message):
    with pytest.raises(ValidationError) as caught:
        source(**changes)
    assert message in str(caught.value)


def test_bad_constants():
    with pytest.raises(ValidationError, match="torque constant like"):
        Current(column="i", unit="A", torque_constant="3 rpm/V")
    with pytest.raises(ValidationError, match="resistance like"):
        Voltage(column="u", unit="V", torque_constant="1 N m/A", resistance="3 N")


@pytest.mark.parametrize("model", [Channel, Position, Torque, Voltage, Source, Processing])
def test_every_field_is_described(model):
    assert all(field.description for field in model.model_fields.values())
