"""``bayesfric simulate``, ``check`` and ``init``, and what all commands have in common."""

import json
import re
import tomllib
from importlib.resources import files

import numpy as np
import pytest
import typer

from bayesfric.base.errors import BadInput
from bayesfric.commands import cli
from bayesfric.commands.simulate import simulate
from bayesfric.fit.conclusion import may_be_simulated
from bayesfric.mechanism.joint import PRESETS
from bayesfric.problem.config import parse_config, read_config

from .bench import CONFIG, has

pytestmark = pytest.mark.usefixtures("nothing_explained")

EXAMPLES = files("bayesfric") / "examples"
# Table 3 of the 2005 IFAC paper; mu_1 = 1/alpha_1 - 1 and mu_2 = 1 - 1/alpha_2, eq. (6)
TABLE_3 = {
    "motor.inertia": (3.56e-4, "kg m²"),
    "motor.viscous": (4.0e-3, "N m s"),
    "motor.coulomb_positive": (0.087, "N m"),
    "motor.coulomb_negative": (0.091, "N m"),
    "gearbox.load_drive": (1 / 0.7432 - 1, ""),
    "gearbox.load_back": (1 - 1 / 1.408, ""),
    "joint.viscous": (3.12, "N m s"),
    "joint.coulomb_positive": (5.03, "N m"),
    "joint.coulomb_negative": (5.15, "N m"),
    "load.inertia": (0.206, "kg m²"),
    "load.first_moment": (0.42, "kg m"),
}
COMMANDS = sorted(typer.main.get_command(cli.app).commands)

SIMULATION = CONFIG + "\n[simulation]\nduration = 1.0\nrate = 500\nseed = 4\n"


# -- simulate


def simulated(bench, name, *arguments):
    ended = bench.run("simulate", "c.toml", "-o", f"{name}.csv", *arguments)
    assert ended.code == 0, ended
    return tuple((bench.folder / f"{name}{end}").read_bytes() for end in (".csv", ".truth.json"))


@pytest.mark.slow
def test_a_simulated_recording_says_so(bench):
    bench.config(SIMULATION)
    told = bench.told("simulate", "c.toml", "-o", "a.csv")
    assert simulated(bench, "b") == simulated(bench, "a")
    assert simulated(bench, "other", "--seed", "5") != simulated(bench, "a")
    truth = json.loads((bench.folder / "a.truth.json").read_text())
    assert told == truth
    assert truth["simulated"] is True
    assert truth["simulation"]["seed"] == 4
    assert truth["parameters"] == {
        "motor.inertia": {"value": 0.01, "unit": "kg m²"},
        "motor.viscous": {"value": 0.05, "unit": "N m s"},
        "motor.coulomb": {"value": 0.2, "unit": "N m"},
        "offset": {"value": 0.02, "unit": "N m"},
    }
    text = (bench.folder / "a.csv").read_text().split("\n")
    assert text[0] == "time,position,torque"
    values = np.loadtxt(text[1:-1], delimiter=",")
    np.testing.assert_allclose(values[:, 0], np.arange(500) / 500, atol=1e-9)


@pytest.mark.parametrize("stem", ["knee", "knee-loaded"])
def test_packaged_recordings_are_what_is_simulated_today(stem, tmp_path):
    simulate(read_config(EXAMPLES / f"{stem}.toml"), tmp_path / "now.csv")
    now = np.loadtxt(tmp_path / "now.csv", delimiter=",", skiprows=1)
    packaged = np.loadtxt(str(EXAMPLES / f"{stem}.csv"), delimiter=",", skiprows=1)
    assert packaged.shape == (10_000, 3)
    # the last printed digit may round the other way
    np.testing.assert_allclose(packaged, now, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("stem", "mass", "radius"), [("knee", 0, 0), ("knee-loaded", 2, 0.35)])
def test_packaged_truth_is_table_3(stem, mass, radius):
    truth = json.loads((EXAMPLES / f"{stem}.truth.json").read_text(encoding="utf-8"))
    assert truth["simulated"] is True
    found = {name: (row["value"], row["unit"]) for name, row in truth["parameters"].items()}
    assert set(found) == set(TABLE_3)
    for name, (value, unit) in TABLE_3.items():
        assert found[name][0] == pytest.approx(value, rel=1e-12), name
        assert found[name][1] == unit, name
    simulation = truth["simulation"]
    assert (simulation["added_mass"], simulation["radius"]) == (mass, radius)
    assert (simulation["duration"], simulation["rate"]) == (10, 1000)


# -- init


@pytest.mark.parametrize("preset", PRESETS)
def test_init_simulate_check_is_one_way(bench, preset):
    ended = bench.run("init", preset)
    assert (ended.code, ended.err) == (0, "")
    text = ended.out.removesuffix("\n")
    said = tomllib.loads(text)["mechanism"]
    geared = {e.name: {} for e in PRESETS[preset].chain().elements if e.ratio != 1.0}
    assert said == {"preset": preset, "terms": "auto"} | ({"elements": geared} if geared else {})
    assert len(text.splitlines()) <= 25
    (bench.folder / "c.toml").write_text(
        text.replace('file = "recording.csv"', 'file = "made.csv"'), encoding="utf-8"
    )
    assert bench.run("simulate", "c.toml", "-o", "made.csv").code == 0
    assert set(checked(bench)["priors"]) == {*PRESETS[preset].values, "noise.sigma"}


def test_a_line_without_its_mark_is_of_the_element_above_it(bench):
    text = bench.run("init", "rabbit-knee").out
    said = tomllib.loads(text.replace("# ratio", "ratio"))
    assert said["mechanism"]["elements"] == {"gearbox": {"ratio": 50}}


@pytest.mark.parametrize("option", ["load_square", "load_speed", "load_direction"])
def test_what_changes_a_load_loss_needs_one(bench, option):
    """A square of the load alone was fitted, and was in no equation, caption or export."""
    text = CONFIG.replace(
        'preset = "motor-axis"', f'preset = "servo-pendulum"\n[{{}}]\n{option} = true'
    )
    text = text.replace("{}", "mechanism.elements.gearbox")
    config = parse_config(text, bench.folder / "c.toml").tables.mechanism
    assert f"gearbox.{option}" in config.joint().names or option == "load_direction"
    bare = text.replace(f"{option} = true", f'{option} = true\nload_loss = "none"')
    with pytest.raises(BadInput, match=f"gearbox.{option}: changes load-dependent friction"):
        parse_config(bare, bench.folder / "c.toml").tables.mechanism.joint()


def test_a_table_that_changes_nothing_is_no_other_mechanism(bench):
    """A roll-out of other recordings was refused for a template's empty tables."""
    text = bench.run("init", "motor-axis").out
    told = parse_config(text, bench.folder / "c.toml").tables.mechanism
    bare = parse_config(CONFIG, bench.folder / "d.toml")
    assert told == bare.tables.mechanism.model_copy(update={"terms": "auto"})


def test_a_template_does_not_say_that_recordings_are_simulated(bench):
    (bench.folder / "c.toml").write_text(bench.run("init", "motor-axis").out, encoding="utf-8")
    config = read_config(bench.folder / "c.toml")
    assert not may_be_simulated(config, ())
    text = config.text + "\n[simulation]\namplitude = 1.0\n"
    config = parse_config(text, bench.folder / "c.toml")
    assert may_be_simulated(config, ())


def test_init_writes_what_it_prints_and_replaces_a_file_only_where_asked(bench):
    printed = bench.run("init", "motor-axis").out
    found = bench.told("init", "motor-axis", "-o", "new.toml")
    assert found["written"] == "new.toml"
    assert (bench.folder / "new.toml").read_text(encoding="utf-8") == found["text"]
    assert printed == found["text"] + "\n"
    assert bench.run("init", "motor-axis", "-o", "-").out == printed
    has(bench.refused("init", "servo-pendulum", "-o", "new.toml"), "exists already", "--force")
    assert bench.run("init", "servo-pendulum", "-o", "new.toml", "--force").code == 0
    assert (bench.folder / "new.toml").read_text(encoding="utf-8") != found["text"]
    assert bench.run("init", "servo-pendulum", "--force").code == 2


@pytest.mark.parametrize("preset", PRESETS)
def test_every_commented_line_of_init_can_be_uncommented(bench, preset):
    """Defaults stand there as TOML, so taking the '#' away gives the same configuration."""
    text = bench.run("init", preset).out
    (bench.folder / "plain.toml").write_text(text, encoding="utf-8")
    plain = read_config(bench.folder / "plain.toml").tables
    active = {"processing", "noise", "sampling", "simulation"}
    lines, table = [], ""
    for line in text.split("\n"):
        heading = re.match(r"\[+(\w+)", line)
        table = heading[1] if heading else table
        setting = re.match(r"# (\w+ = [^.]*[^.].*)", line)
        if table in active and setting and '"..."' not in line:
            lines.append(setting[1])
        else:
            lines.append(line)
    (bench.folder / "full.toml").write_text("\n".join(lines), encoding="utf-8")
    full = read_config(bench.folder / "full.toml").tables
    for name in ("processing", "sampling", "simulation"):
        assert getattr(full, name) == getattr(plain, name), name


# -- check

# 'file' stands before the other keys, so more keys can be put beside it
LOADED = CONFIG.replace('preset = "motor-axis"', 'preset = "servo-pendulum"')
LOADED = LOADED.replace('"motor.coulomb" = [0.0, 1.0]', '"load.gravity_angle" = 0.0')
LOADED = LOADED.replace(
    'file = "run.csv"', 'file = "run.csv"\nadded_mass = "250 g"\nradius = "12 cm"'
)


def checked(bench):
    return bench.told("check", "c.toml")


# -- all commands


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_json(bench, command):
    ended = bench.run(command, "--help")
    assert ended.code == 0
    assert "--json" in ended.out
    assert f"Usage: bayesfric {command}" in ended.out
    assert command in bench.run("--help").out
