"""``[validation]`` as a user meets it: what is held out is predicted and changes no fit."""

import json

import numpy as np
import pytest
import xarray as xr

from .bench import JOINT, has, recorded, simulation, without_figures

pytestmark = pytest.mark.usefixtures("nothing_explained")

SIMULATION = simulation(rate=400, encoder_counts=0, torque_noise=0.01)
NAMES = ("one", "two", "three")
SHORT = "\n[sampling]\nwalkers = 32\nmax_steps = 400\nmin_ess = 200\n"
PROCESSING = '\n[processing]\nlowpass = "100 Hz"\ndecimate = 1\n'
CONFIG = JOINT + "".join(map(recorded, NAMES)) + PROCESSING + SHORT
HELD_OUT = '\n[validation]\nrecordings = ["two"]\nhold_out = 0.2\n'


@pytest.fixture
def three(bench, monkeypatch):
    for seed, name in enumerate(NAMES, start=1):
        bench.simulated(JOINT + recorded(name) + SIMULATION, name, seed)
    bench.config(CONFIG + HELD_OUT)
    without_figures(monkeypatch)
    return bench


def fitted(bench):
    ended = bench.run("fit", "c.toml", "-o", "run", "--force")
    assert ended.code in (0, 3), ended
    data = xr.load_datatree(bench.folder / "run" / "posterior.nc")
    draws = {name: data["posterior"][name].values for name in data["posterior"].data_vars}
    return bench.summary(), draws, ended.out, json.loads(data.attrs["recordings"])


def alter(bench, name, begin, size):
    """Add to the torque from a time on."""

    def pushed(table):
        table[table[:, 0] >= begin, 2] += size

    bench.altered(pushed, name)


def test_what_is_held_out_is_predicted_and_changes_no_draw(three, monkeypatch):
    summary, draws, _, hashes = fitted(three)
    record = summary["validation"]
    assert {name: p["held_out"] for name, p in record["parts"].items()} == {
        "one": "last 20 %",
        "two": "whole recording",
        "three": "last 20 %",
    }
    assert record["unit"] == "N m"
    assert set(hashes) == set(NAMES)
    assert set(summary["fit"]["recordings"]) == {"one", "three"}

    # of the second fit only numbers are looked at
    without_figures(monkeypatch)
    alter(three, "two", 0.0, 0.05)
    alter(three, "one", 2.41, 0.03)
    again, same, _, _ = fitted(three)
    assert set(same) == set(draws)
    for name, values in draws.items():
        np.testing.assert_array_equal(same[name], values)
    assert again["parameters"] == summary["parameters"]
    assert again["estimates"] == summary["estimates"]
    # what was put in, beyond a noise of 0.01 N m, and found
    for name, size in (("two", 0.05), ("one", 0.03)):
        found = again["validation"]["parts"][name]
        assert found["verdict"] == "model discrepancy"
        assert found["discrepancy"]["value"] == pytest.approx(size, rel=0.1)
    assert again["validation"]["parts"]["three"] == record["parts"]["three"]


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ('recordings = ["twoo"]', ["validation.recordings", "'twoo'", "did you mean 'two'"]),
        ('recordings = ["one", "two", "three"]', ["validation.recordings", "every recording"]),
        ("hold_out = 0.001", ["validation.hold_out", "last 0.1 %"]),
        ("hold_out = 0.999", ["validation.hold_out", "leaves nothing", "hold out less"]),
        (
            'hold_out = 0.2\n[likelihood]\nmethod = "output-error"',
            ["c.toml: validation", "not offered for the output-error likelihood"],
        ),
    ],
)
def test_bad_validation(three, text, parts):
    three.config(CONFIG + f"\n[validation]\n{text}\n")
    has(three.refused("check", "c.toml"), "c.toml: ", *parts)


def test_the_offset_of_what_is_held_out_is_no_parameter(three):
    text = CONFIG.replace("[mechanism]\n", '[mechanism]\noffset = "per-recording"\n')
    three.config(text + HELD_OUT + '\n[priors]\n"offset.two" = 0.0\n')
    has(three.refused("check", "c.toml"), "priors.offset.two", "no such parameter")
