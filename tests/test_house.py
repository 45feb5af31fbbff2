"""The plan of the package: no files import each other in a circle, and a room what lies below it.

A room is a folder, with those inside it. An import counts wherever it stands: in a function and
for types alone, too.
"""

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter

import pytest

from tests.conftest import REPOSITORY

HOUSE = REPOSITORY / "bayesfric"
# From the ground up: files beside the rooms that any room may import, then the rooms themselves.
FLOORS = (
    ("configuration_errors", "errors", "notebook", "progress", "robust", "templates", "threads"),
    ("results",),
    ("recordings",),
    ("mechanism",),
    ("estimates",),
    ("inference",),
    ("identifiability",),
    ("diagnostics",),
)
TOP = "the files beside the rooms"
CIRCLES = {
    name: pytest.mark.xfail(strict=True, raises=pytest.fail.Exception, reason=reason)
    for name, reason in (
        ("report", "a summary words itself by terminal and page, which are made of summaries"),
        (TOP, "a Model makes what whole_fit and result make of a Model"),
    )
}


def modules_of(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (one.name for one in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "imports are written from bayesfric on"
            for one in node.names:
                whole = f"{node.module}.{one.name}"
                yield whole if whole in FILES else node.module


FILES = {
    ".".join(path.relative_to(REPOSITORY).with_suffix("").parts).removesuffix(".__init__"): path
    for path in HOUSE.rglob("*.py")
}
IMPORTS = {
    name: set(modules_of(ast.parse(path.read_text(encoding="utf-8")))) & FILES.keys()
    for name, path in FILES.items()
}


def place(name: str) -> str:
    """Give the room that a file is in, or its own name where it stands beside them."""
    return name.split(".")[1] if "." in name else name


def room(name: str) -> str:
    return place(name) if (HOUSE / place(name)).is_dir() else TOP


ROOMS = sorted({room(name) for name in FILES})


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=CIRCLES[one]) if one in CIRCLES else one for one in ROOMS]
)
def test_no_circle_is_inside_a_room(name):
    inside = {one for one in FILES if room(one) == name}
    try:
        TopologicalSorter({one: IMPORTS[one] & inside for one in inside}).prepare()
    except CycleError as error:
        pytest.fail(" imported by ".join(error.args[1]))


@pytest.mark.parametrize("floor", range(len(FLOORS)), ids=map(" ".join, FLOORS))
def test_a_room_imports_only_what_lies_below_it(floor):
    below = {one for floors in FLOORS[: floor + 1] for one in floors}
    above = [
        f"{one} imports {other}"
        for one in FILES
        if place(one) in FLOORS[floor]
        for other in IMPORTS[one]
        if place(other) not in below
    ]
    assert not above
