"""``init --all-keys``, ``--schema`` and ``fleet``: what may be written, and editors' schemas."""

import json
import re
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import get_args

import jsonschema
import pytest
from pydantic import BaseModel

from bayesfric.base.errors import BadInput
from bayesfric.commands.init import FLEET, configuration
from bayesfric.fleet.plan import FleetTables, read_plan
from bayesfric.mechanism.presets import PRESETS
from bayesfric.problem.config import Tables, parse_config
from tests.conftest import REPOSITORY

from .bench import CONFIG

CONFIGURATIONS = sorted(
    [
        *(Path(str(files("bayesfric"))) / "examples").glob("*.toml"),
        *(REPOSITORY / "studies").rglob("*.toml"),
    ]
)
MODELS = {"configuration": Tables, "fleet": FleetTables}


@pytest.fixture(scope="module")
def validators():
    for model in MODELS.values():
        jsonschema.Draft202012Validator.check_schema(model.model_json_schema())
    return {
        kind: jsonschema.Draft202012Validator(model.model_json_schema())
        for kind, model in MODELS.items()
    }


def models_in(annotation):
    """Models that an annotation names, and those that they name in turn."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
        for field in annotation.model_fields.values():
            yield from models_in(field.annotation)
    for inner in get_args(annotation):
        yield from models_in(inner)


@pytest.mark.parametrize(("kind", "ending"), [("configuration", []), ("fleet", ["fleet"])])
def test_every_key_is_printed_with_its_meaning(bench, kind, ending):
    printed = bench.run("init", *ending, "--all-keys")
    assert (printed.code, printed.err) == (0, "")
    text = " ".join(printed.out.split())
    for model in models_in(MODELS[kind]):
        for name, field in model.model_fields.items():
            assert field.description, f"{model.__name__}.{name}: give it a description"
            assert re.search(rf"^{name}: ", printed.out, re.M), name
            assert field.description in text


def test_type_default_and_place_of_a_key(bench):
    printed = bench.run("init", "--all-keys").out
    table = printed[printed.index("[processing]") :]
    assert "order: integer, default 4\n    Order of the Butterworth filter.\n" in table
    assert '\ndifferentiation: "exact" or "central", default "exact"\n' in table
    assert "\n[mechanism.elements.NAME]\nratio: number, default 1.0\n" in printed
    assert "\ncolumn: text or integer, required\n" in printed


@pytest.mark.parametrize("path", CONFIGURATIONS, ids=lambda path: path.stem)
def test_packaged_and_study_configurations_suit_the_schema(path, validators):
    validators["configuration"].validate(tomllib.loads(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize("preset", PRESETS)
def test_what_init_writes_suits_the_schema(bench, validators, preset):
    validators["configuration"].validate(tomllib.loads(bench.run("init", preset).out))


REFUSED = {
    "unknown table": ("[noise]", "[nois]"),
    "unknown key of a channel": ('column = "q"', 'colum = "q"'),
    "beyond its bound": ("order = 4", "order = 13"),
    "true for a number with a unit": ("order = 4", "lowpass = true"),
    "unknown word": ('"shared"', '"sharde"'),
    "half a span": ('file = "run.csv"', 'file = "run.csv"\nexclude = [[1.0]]'),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_refused_the_schema_refuses(case, validators, tmp_path):
    text = CONFIG.replace(*REFUSED[case])
    assert validators["configuration"].is_valid(tomllib.loads(CONFIG))
    assert not validators["configuration"].is_valid(tomllib.loads(text))
    with pytest.raises(BadInput):
        parse_config(text, tmp_path / "c.toml")


def test_the_schema_is_written_with_the_line_that_makes_editors_use_it(bench, validators):
    ended = bench.run("init", "--schema", "-o", "mine.json")
    assert ended.code == 0
    assert "#:schema ./mine.json" in ended.out
    assert (
        json.loads((bench.folder / "mine.json").read_text()) == validators["configuration"].schema
    )
    assert json.loads(bench.run("init", "fleet", "--schema").out) == validators["fleet"].schema


def test_names_of_priors_and_references_may_be_dotted_or_quoted(validators):
    text = CONFIG + 'motor.inertia = { distribution = "gamma", a = 2.0, scale = 0.1 }\n'
    text += 'motor.viscous = 0.1\n[references]\nmotor.inertia = { value = 1.0, source = "CAD" }\n'
    text += '"motor.viscous" = 0.1\n'
    validators["configuration"].validate(tomllib.loads(text))
    assert set(parse_config(text, REPOSITORY / "c.toml").priors) == {
        "motor.coulomb", "motor.inertia", "motor.viscous",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["rabbit-knee", "--all-keys"], "rabbit-knee: --all-keys is the same for every preset"),
        (["--schema", "--from", "run.csv"], "--from: is beside --schema; ask for one"),
        (["--schema", "--all-keys"], "--all-keys: is beside --schema; ask for one"),
    ],
)
def test_what_init_cannot_do_at_once_is_refused(bench, arguments, said):
    ended = bench.run("init", *arguments)
    assert ended.code == 2
    assert said in ended.err


def test_the_plan_of_a_fleet_works_as_it_is(bench, validators):
    assert bench.run("init", "fleet", "-o", "fleet.toml").code == 0
    text = (bench.folder / "fleet.toml").read_text(encoding="utf-8")
    assert text == configuration(FLEET)
    validators["fleet"].validate(tomllib.loads(text))
    assert not validators["fleet"].is_valid(tomllib.loads(text.replace("glob", "globe")))
    (bench.folder / "recordings").mkdir()
    table = "time,position,torque\n0,0,0\n"
    for name in ("left", "right"):
        (bench.folder / "recordings" / f"{name}.csv").write_text(table)
    plan = read_plan(bench.folder / "fleet.toml")
    assert [unit.name for unit in plan.units] == ["left", "right"]
    (source,) = parse_config(plan.configuration(plan.units[1]), plan.path).tables.recordings
    assert source.files == ["recordings/right.csv"]
    # every example can be uncommented, but for what the glob excludes
    full = tomllib.loads(re.sub(r"^# (\w+ = .*)$", r"\1", text.replace("# table", "#"), flags=re.M))
    validators["fleet"].validate(full)
