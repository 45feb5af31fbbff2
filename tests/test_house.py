"""The plan of the package: no files import each other in a circle, and a room what lies below it.

A room is a folder, with those inside it. An import counts wherever it stands: in a function and
for types alone, too.
"""

import ast
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter

import pytest

from tests.conftest import REPOSITORY

HOUSE = REPOSITORY / "bayesfric"
# From the ground up: each imports only what stands on floors below its own.
FLOORS = (
    ("base", "results", "examples"),
    ("recordings",),
    ("mechanism",),
    ("estimates",),
    ("inference",),
    ("identifiability", "population", "diagnostics"),
    ("problem", "report"),
    ("fit",),
    ("export", "rollouts", "fleet", "arm", "plot"),
    ("commands", "bayesfric"),
    ("__main__",),
)
PLACES = [place for floor in FLOORS for place in floor]
TOP = "the files outside the rooms"


def modules_of(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "imports are written from bayesfric on"
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                yield name if name in FILES else node.module


FILES = {
    ".".join(path.relative_to(REPOSITORY).with_suffix("").parts).removesuffix(".__init__"): path
    for path in HOUSE.rglob("*.py")
}


@cache  # takes a second, which every process that collects tests would spend
def imports():
    return {
        name: set(modules_of(ast.parse(path.read_text(encoding="utf-8")))) & FILES.keys()
        for name, path in FILES.items()
    }


def place(name: str) -> str:
    """Return the room of a file, or its own name if it is in none."""
    return name.split(".")[1] if "." in name else name


def room(name: str) -> str:
    return place(name) if (HOUSE / place(name)).is_dir() else TOP


ROOMS = sorted({room(name) for name in FILES})


@pytest.mark.parametrize("name", ROOMS)
def test_no_circle_is_inside_a_room(name):
    files = {file for file in FILES if room(file) == name}
    try:
        TopologicalSorter({file: imports()[file] & files for file in files}).prepare()
    except CycleError as error:
        pytest.fail(" imported by ".join(error.args[1]))


def test_every_place_stands_on_a_floor():
    assert sorted(PLACES) == sorted({place(name) for name in FILES})


@pytest.mark.parametrize("name", PLACES)
def test_a_place_imports_only_what_lies_below_it(name):
    height = next(k for k, floor in enumerate(FLOORS) if name in floor)
    below = {name}.union(*FLOORS[:height])
    above = [
        f"{file} imports {other}"
        for file in FILES
        if place(file) == name
        for other in imports()[file]
        if place(other) not in below
    ]
    assert not above
