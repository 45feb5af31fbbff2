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
from bayesfric.commands.keys import schema_of
from bayesfric.fleet.plan import FleetTables, read_plan
from bayesfric.mechanism.presets import PRESETS
from bayesfric.problem.config import Tables, parse_config
from bayesfric.recordings.units import UNIT_KEYWORD
from tests.conftest import REPOSITORY

from .bench import CONFIG

CONFIGURATIONS = sorted(
    [
        *(Path(str(files("bayesfric"))) / "examples").glob("*.toml"),
        *(REPOSITORY / "studies").rglob("*.toml"),
    ]
)
KINDS = ("configuration", "fleet")


@pytest.fixture(scope="module")
def validators():
    for kind in KINDS:
        jsonschema.Draft7Validator.check_schema(schema_of(kind))
    return {kind: jsonschema.Draft7Validator(schema_of(kind)) for kind in KINDS}


def fields(kind):
    """Every key of every model of a schema, with its place."""
    schema = schema_of(kind)
    for place, model in {"": schema, **schema["$defs"]}.items():
        for name, field in model.get("properties", {}).items():
            yield f"{place}.{name}", field


def numbers(field):
    """Whether a key takes numbers that are not whole, by itself or in a list."""
    inner = [field.get("items", {}), field.get("additionalProperties"), *field.get("anyOf", ())]
    return field.get("type") == "number" or any(
        numbers(f) for f in inner if isinstance(f, dict) and f
    )


def unit_told(field):
    inner = [field.get("items", {}), *field.get("anyOf", ())]
    return UNIT_KEYWORD in field or any(unit_told(one) for one in inner if one)


@pytest.mark.parametrize("kind", KINDS)
def test_every_key_has_a_meaning_and_every_number_a_unit_or_none(kind):
    for place, field in fields(kind):
        assert field.get("description"), f"{place}: give it a description"
        # behind a name of priors or references stands what its parameter is counted in
        if numbers(field) and "$ref" not in field:
            assert unit_told(field), f"{place}: declare in_unit(...), empty for none"


def models_in(annotation):
    """Models that an annotation names, and those that they name in turn."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
        for field in annotation.model_fields.values():
            yield from models_in(field.annotation)
    for inner in get_args(annotation):
        yield from models_in(inner)


@pytest.mark.parametrize(("model", "ending"), [(Tables, []), (FleetTables, ["fleet"])])
def test_all_keys_are_printed(bench, model, ending):
    printed = bench.run("init", *ending, "--all-keys")
    assert (printed.code, printed.err) == (0, "")
    for one in models_in(model):
        for name in one.model_fields:
            assert f"|`{name}`|" in printed.out


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
# refused by what comes after reading: the mechanism, the priors
LATER = {
    "unknown preset": ("motor-axis", "motor-axes"),
    "three numbers for a range": ("[0.0, 1.0]", "[0.0, 1.0, 2.0]"),
    "text for a prior": ("[0.0, 1.0]", '"wide"'),
}


@pytest.mark.parametrize("case", [*REFUSED, *LATER])
def test_what_is_refused_the_schema_refuses(case, validators, tmp_path):
    text = CONFIG.replace(*{**REFUSED, **LATER}[case])
    assert validators["configuration"].is_valid(tomllib.loads(CONFIG))
    assert not validators["configuration"].is_valid(tomllib.loads(text))
    if case in REFUSED:
        with pytest.raises(BadInput):
            parse_config(text, tmp_path / "c.toml")


def test_dotted_and_quoted_names_of_priors_and_references_suit(validators):
    text = CONFIG + 'motor.inertia = { distribution = "gamma", a = 2.0, scale = 0.1 }\n'
    text += 'motor.viscous = 0.1\n[references]\nmotor.inertia = { value = 1.0, source = "CAD" }\n'
    text += '"motor.viscous" = 0.1\n'
    validators["configuration"].validate(tomllib.loads(text))
    assert set(parse_config(text, REPOSITORY / "c.toml").priors) == {
        "motor.coulomb", "motor.inertia", "motor.viscous",
    }  # fmt: skip


def test_the_schema_is_written_with_the_line_that_makes_editors_use_it(bench, validators):
    ended = bench.run("init", "--schema", "-o", "mine.json")
    assert ended.code == 0
    assert "#:schema ./mine.json" in ended.out
    assert (
        json.loads((bench.folder / "mine.json").read_text()) == validators["configuration"].schema
    )
    assert json.loads(bench.run("init", "fleet", "--schema").out) == validators["fleet"].schema


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
    (source,) = parse_config(plan.template.filled(plan.units[1]), plan.path).tables.recordings
    assert source.files == ["recordings/right.csv"]
    # every example can be uncommented, but for what the glob excludes
    full = tomllib.loads(re.sub(r"^# (\w+ = .*)$", r"\1", text.replace("# table", "#"), flags=re.M))
    validators["fleet"].validate(full)
