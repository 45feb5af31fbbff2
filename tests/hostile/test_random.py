"""Thousands of bad inputs, none of which may end in anything but 0 or one line and 2."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bayesfric.errors import BadInput
from bayesfric.problem.config import parse_config
from tests.hostile.cases import case
from tests.hostile.good import LONG_CONFIG, config, content
from tests.hostile.rule import broken_rule, check
from tests.hostile.worker import warm_up

SEED = 20261121


SUFFIXES = ("csv", "tsv", "json", "npz", "mat", "parquet", "jsonl", "h5", "mcap", "bag", "db3")


@pytest.mark.parametrize("form", [*SUFFIXES, "7.3.mat", "packed.mcap"])
def test_good_inputs_are_good(tmp_path, form):
    """What is damaged below was fine before."""
    (tmp_path / f"run.{form}").write_bytes(content(form))
    (tmp_path / "c.toml").write_text(config(f"run.{form}"))
    assert check(tmp_path / "c.toml").code == 0, form
    parse_config(LONG_CONFIG, Path("c.toml"))


def test_cases_are_the_same_again():
    for index in range(200):
        first, second = case(SEED, index), case(SEED, index)
        assert (first.config, first.name) == (second.config, second.name)
        # files of zip, Parquet and MAT hold the time they were made
        if first.name.endswith(("csv", "json", "tsv")):
            assert first.recording == second.recording


def test_two_hundred(tmp_path):
    warm_up(tmp_path)
    broken = {}
    for index in range(200):
        made = case(SEED, index)
        problem = broken_rule(made.write(tmp_path), *made.named)
        if problem:
            broken[index] = (made.kind, problem)
    assert not broken


@pytest.mark.slow  # the first 500 of which took half a minute of the default suite
def test_twenty_thousand_in_little_memory(tmp_path):
    """In a process that may take 1 GiB beyond its imports, so that a crash is told too."""
    at = tmp_path / "at"
    done = subprocess.run(
        [sys.executable, "-m", "tests.hostile.worker", str(SEED), "0", "20000", "--at", str(at)],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"case {at.read_text()}: {done.stderr[-3000:]}"
    *broken, told = map(json.loads, done.stdout.splitlines())
    assert not broken
    assert sum(told["cases"].values()) == 20_000
    # most are refused, and enough are harmless to show that damage is no reason by itself
    assert 0.02 < told["accepted"] / 20_000 < 0.6


# -- any text as configuration, any text and number in one

_WORDS = (
    "mechanism recordings processing priors references estimation likelihood noise sampling "
    "advice simulation preset file time position torque column unit order seed walkers"
)
_TOML_KEYS = st.sampled_from(_WORDS.split()) | st.text(st.characters(codec="utf-8"), max_size=8)
_TOML_VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.sampled_from(["motor-axis", "run.csv", "rad", "N m", "s", "5 ms", "auto", "off"])
    | st.text(st.characters(codec="utf-8"), max_size=12),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(_TOML_KEYS, inner, max_size=4),
    max_leaves=12,
)


def _toml(value):
    """Write a value as TOML; keys and text escaped as JSON does, which TOML shares."""
    match value:
        case bool():
            return str(value).lower()
        case int() | float():
            return repr(value)
        case str():
            return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
        case list():
            return f"[{', '.join(map(_toml, value))}]"
        case dict():
            pairs = (f"{_toml(str(key))} = {_toml(inner)}" for key, inner in value.items())
            return f"{{ {', '.join(pairs)} }}"
    return "0"


def _checked(text):
    try:
        found = parse_config(text, Path("c.toml"))
        with found.named():
            found.tables.mechanism.joint()
        assert isinstance(found.priors, dict)
        assert isinstance(found.references, dict)
    except BadInput as error:
        message = str(error)
        assert message.isprintable()
        assert message.startswith("c.toml")
        assert "; " in message
        assert "Input should" not in message


@settings(max_examples=60, derandomize=True, deadline=None, database=None)
@given(st.dictionaries(_TOML_KEYS, _TOML_VALUES, max_size=6))
def test_any_tables(tables):
    _checked("\n".join(f"{_toml(key)} = {_toml(value)}" for key, value in tables.items()))


@settings(max_examples=100, derandomize=True, deadline=None, database=None)
@given(st.text(st.characters(codec="utf-8"), max_size=200))
def test_any_text(text):
    _checked(text)


@settings(
    max_examples=40,
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    data=st.binary(max_size=400),
    form=st.sampled_from(SUFFIXES),
)
def test_any_bytes(tmp_path, data, form):
    (tmp_path / f"run.{form}").write_bytes(data)
    (tmp_path / "c.toml").write_text(config(f"run.{form}"))
    assert broken_rule(tmp_path / "c.toml", f"run.{form}") is None
