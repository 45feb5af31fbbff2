"""Pages name functions and files that exist; version and dependencies are the same everywhere."""

import ast
import re
import tomllib
from importlib.metadata import metadata

import bayesfric
from tests.conftest import REPOSITORY


def page(*path):
    return REPOSITORY.joinpath(*path).read_text(encoding="utf-8")


def test_every_equation_names_a_function_and_a_test_that_exist():
    text = page("studies", "reference", "equations.md")
    pairs = re.findall(r"`([\w/]+\.py)` `(\w+)`", text)
    assert len(pairs) == 2 * len(re.findall(r"^\| (?:\(|section)", text, re.M))
    for path, name in pairs:
        tree = ast.parse(page(path))
        assert name in {getattr(node, "name", None) for node in tree.body}, (path, name)


def test_files_that_contributing_names_exist():
    for path in re.findall(r"`((?:bayesfric|tests|studies)/[\w./]+)`", page("CONTRIBUTING.md")):
        assert (REPOSITORY / path).exists(), path


def test_version_and_dependencies_are_those_of_the_project():
    project = tomllib.loads(page("pyproject.toml"))["project"]
    version, recipe = project["version"], page(".ci", "conda", "recipe.yaml")
    assert bayesfric.__version__ == version == metadata("bayesfric")["Version"]
    assert re.search(r"^version: (.*)$", page("CITATION.cff"), re.M)[1] == version
    assert re.search(r'^  version: "(.*)"$', recipe, re.M)[1] == version
    run = re.search(r"^  run:\n((?:    - .*\n)+)", recipe, re.M)[1]
    bounds = dict(dependency.split(">=") for dependency in project["dependencies"])
    bounds["matplotlib-base"] = bounds.pop("matplotlib")  # conda's name
    assert dict(line.split()[1:] for line in run.splitlines()) == {
        "python": project["requires-python"],
        **{name: f">={bound}" for name, bound in bounds.items()},
    }
