"""Do the tests notice? One change of the code at a time, by cosmic-ray's operators.

``pip install cosmic-ray pytest-cov``, then ``python studies/mutation/mutants.py``: places are drawn
from the four rooms that hold the method, one change at each, and the tests that run the line are
asked (``--contexts`` keeps which these are). A change that no test notices survives. Writes
``mutants.json``.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Queue
from tempfile import mkdtemp
from typing import Any

from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names
from coverage import CoverageData

HERE = Path(__file__).resolve().parent
HOUSE = HERE.parents[1]
ROOMS = {
    "mechanism": "mechanism",
    "estimates": "estimates",
    "inference/likelihood": "inference",
    "diagnostics": "diagnostics",
}
# One change of a sign is as good as another: nobody writes a bit's shift for a sum.
ARITHMETIC = {"Add": "Sub", "Sub": "Add", "Mul": "Div", "Div": "Mul", "Pow": "Mul", "MatMul": "Mul"}
# What a call says for its reader only, or asserts of lengths that are equal.
IDLE = ("strict", "description", "examples", "json_schema_extra")
# Seconds after which tests that do not end have noticed.
PATIENCE = 400
# Tests that are asked at most.
MOST = 40
Place = tuple[str, int, int, str, int]  # file, line, column, operator, occurrence


def wanted(operator: str) -> bool:
    """Leave out changes that are no slip of the hand, and those of annotations' bars."""
    name = operator.removeprefix("core/")
    if not name.startswith("ReplaceBinaryOperator"):
        return not name.startswith(("RemoveDecorator", "VariableInserter", "VariableReplacer"))
    _, old, new = name.rsplit("_", 2)
    return ARITHMETIC.get(old) == new


def idle(tree: ast.AST) -> Iterator[Any]:
    """Give what changes no result: annotations, decorators, checks of lengths, what help tells."""
    for node in ast.walk(tree):
        yield from filter(None, (getattr(node, "annotation", None), getattr(node, "returns", None)))
        yield from getattr(node, "decorator_list", ())
        if isinstance(node, ast.arg):
            yield node
        if isinstance(node, ast.keyword) and node.arg in IDLE:
            yield node
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "model_config":
            yield node


def places(path: Path) -> Iterator[Place]:
    """Give every change of a file that may be made, but in what changes no result."""
    tree, shown = get_ast_from_path(path), str(path.relative_to(HOUSE))
    noted = {
        (line, column)
        for node in idle(ast.parse(path.read_text(encoding="utf-8")))
        for line in range(node.lineno, node.end_lineno + 1)
        for column in range(
            node.col_offset if line == node.lineno else 0,
            node.end_col_offset if line == node.end_lineno else 1000,
        )
    }
    for name in filter(wanted, operator_names()):
        operator = get_operator(name)
        if operator.arguments():
            continue
        found = (at for node in ast_nodes(tree) for at in operator().mutation_positions(node))
        for occurrence, (start, _) in enumerate(found):
            if start not in noted:
                yield (shown, *start, name, occurrence)


def drawn(room: str, number: int, seed: int) -> list[Place]:
    """Draw places of a room, each with one of its changes."""
    by_place: dict[tuple[str, int, int], list[Place]] = defaultdict(list)
    for path in sorted((HOUSE / "bayesfric" / room).rglob("*.py")):
        for place in places(path):
            by_place[place[:3]].append(place)
    chance = random.Random(f"{seed} {room}")
    return [chance.choice(by_place[at]) for at in chance.sample(sorted(by_place), number)]


def environment(tree: Path) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}


def contexts(to: Path, rooms: list[str]) -> CoverageData:
    """Run the rooms' tests once, and keep which of them runs which line."""
    if not to.exists():
        tests = [f"tests/{room}" for room in dict.fromkeys(ROOMS[room] for room in rooms)]
        command = [sys.executable, "-m", "pytest", "-q", "--cov=bayesfric", "--cov-context=test"]
        there = {**environment(HOUSE), "COVERAGE_FILE": str(to)}
        subprocess.run([*command, "--cov-report=", *tests], cwd=HOUSE, env=there, check=True)
    data = CoverageData(basename=str(to))
    data.read()
    return data


def compiled(path: Path, line: int) -> bool:
    """Whether a line is of a function that Numba compiles."""
    return any(
        node.lineno <= line <= (node.end_lineno or 0)
        and any("njit" in ast.unparse(mark) for mark in node.decorator_list)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef)
    )


def tests_of(place: Place, data: CoverageData) -> list[str]:
    """Give the tests that run a line, or all of its room: at import, or compiled."""
    file, line = place[:2]
    room = next(tests for folder, tests in ROOMS.items() if file.startswith(f"bayesfric/{folder}/"))
    if compiled(HOUSE / file, line):  # where no test is seen to run it
        return [f"tests/{room}"]
    by_line = data.contexts_by_lineno(str(HOUSE / file))
    found = {name.partition("|")[0] for name in by_line.get(line, []) if name}
    # every so many of them, those of the room first
    some = sorted(found)[:: -(-len(found) // MOST) or 1]
    return sorted(some, key=lambda name: not name.startswith(f"tests/{room}/")) or [f"tests/{room}"]


def noticed(place: Place, tests: list[str], tree: Path) -> dict[str, Any]:
    """Make one change in a copy of the house, and ask the tests."""
    file, line, _, name, occurrence = place
    path = tree / file
    whole = path.read_text(encoding="utf-8")
    there, kernels = environment(tree), None
    if "njit" in whole:  # what is compiled is kept by the caller's file
        kernels = there["NUMBA_CACHE_DIR"] = mkdtemp()
    begun = time.monotonic()
    changed = mutate_code(whole, get_operator(name)(), occurrence)
    path.write_text(changed, encoding="utf-8")
    try:
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
        run = subprocess.run(command, cwd=tree, env=there, capture_output=True, timeout=PATIENCE)
        found = {0: "survived", 1: "killed", 2: "killed", 4: "killed"}.get(run.returncode, "failed")
    except subprocess.TimeoutExpired:
        found = "killed"
    finally:
        path.write_text(whole, encoding="utf-8")
        if kernels:
            shutil.rmtree(kernels)
    texts = [text.splitlines()[line - 1].strip() for text in (whole, changed)]
    return {
        "file": file,
        "line": line,
        "operator": name.removeprefix("core/"),
        "was": texts[0],
        "became": texts[1],
        "found": found,
        "tests": len(tests),
        "seconds": round(time.monotonic() - begun, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--mutants", type=int, default=50, help="of every room")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rooms", nargs="+", default=list(ROOMS), choices=ROOMS)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--contexts", type=Path, default=HERE / "contexts.sqlite")
    parser.add_argument("--to", type=Path, default=HERE / "mutants.json")
    options = parser.parse_args()
    data = contexts(options.contexts, options.rooms)
    trees: Queue[Path] = Queue()
    for _ in range(options.workers):
        tree = Path(mkdtemp()) / HOUSE.name
        for name in ("bayesfric", "tests", "studies", "figures"):
            shutil.copytree(HOUSE / name, tree / name)
        for name in ("pyproject.toml", "README.md"):
            shutil.copy(HOUSE / name, tree)
        trees.put(tree)

    def one(place: Place) -> dict[str, Any]:
        tree = trees.get()
        try:
            return noticed(place, tests_of(place, data), tree)
        finally:
            trees.put(tree)

    result: dict[str, Any] = {}
    with ThreadPoolExecutor(options.workers) as pool:
        for room in options.rooms:
            found = list(pool.map(one, drawn(room, options.mutants, options.seed)))
            killed = sum(mutant["found"] == "killed" for mutant in found)
            result[room] = {
                "mutants": len(found),
                "killed": killed,
                "survivors": [mutant for mutant in found if mutant["found"] != "killed"],
            }
            options.to.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
            print(f"{room}: {killed} of {len(found)} killed", flush=True)
            for mutant in result[room]["survivors"]:
                print(
                    f"   {mutant['file']}:{mutant['line']}  {mutant['was']}  ->  {mutant['became']}"
                )


if __name__ == "__main__":
    main()
