"""What is published says one thing everywhere: version, dependencies, citation."""

import re
import tomllib
from importlib.metadata import metadata

import bayesfric
from tests.conftest import REPOSITORY

PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# What conda calls otherwise.
CONDA = {"matplotlib": "matplotlib-base"}


def test_one_version():
    assert bayesfric.__version__ == PROJECT["version"] == metadata("bayesfric")["Version"]
    citation = (REPOSITORY / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.*)$", citation, re.M)[1] == PROJECT["version"]
    recipe = (REPOSITORY / ".ci" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    assert re.search(r'^  version: "(.*)"$', recipe, re.M)[1] == PROJECT["version"]


def test_conda_asks_for_what_pip_asks_for():
    recipe = (REPOSITORY / ".ci" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    run = re.search(r"^  run:\n((?:    - .*\n)+)", recipe, re.M)[1]
    asked = {}
    for one in PROJECT["dependencies"]:
        name, bound = one.split(">=")
        asked[CONDA.get(name, name)] = f">={bound}"
    assert dict(line.split()[1:] for line in run.splitlines()) == {
        "python": PROJECT["requires-python"], **asked,
    }  # fmt: skip
