"""Mutation test: one change of the code at a time, by cosmic-ray's operators.

``pip install cosmic-ray pytest-cov``, then ``python studies/mutation/mutants.py``: lines are drawn
from the four folders of the method, each gets one change, and the tests that execute the line are
run (``--contexts`` stores which these are). A change that no test notices survives. Writes
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

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
ROOMS = {
    "mechanism": "mechanism",
    "estimates": "estimates",
    "inference": "inference",
    "diagnostics": "diagnostics",
}
# Plausible changes of arithmetic operators.
ARITHMETIC = {"Add": "Sub", "Sub": "Add", "Mul": "Div", "Div": "Mul", "Pow": "Mul", "MatMul": "Mul"}
# Keywords without effect on results.
KEYWORDS = ("strict", "description", "examples", "json_schema_extra")
# Seconds after which a test run counts as failed.
TIMEOUT = 400
# Maximum number of tests per change.
MAX_TESTS = 40
Place = tuple[str, int, int, str, int]  # file, line, column, operator, occurrence


def selected(operator: str) -> bool:
    """Whether an operator makes a plausible change outside annotations."""
    name = operator.removeprefix("core/")
    if not name.startswith("ReplaceBinaryOperator"):
        return not name.startswith(("RemoveDecorator", "VariableInserter", "VariableReplacer"))
    _, old, new = name.rsplit("_", 2)
    return ARITHMETIC.get(old) == new


def without_effect(tree: ast.AST) -> Iterator[Any]:
    """Yield nodes without effect on results: annotations, decorators, keywords of help."""
    for node in ast.walk(tree):
        yield from filter(None, (getattr(node, "annotation", None), getattr(node, "returns", None)))
        yield from getattr(node, "decorator_list", ())
        if isinstance(node, ast.arg):
            yield node
        if isinstance(node, ast.keyword) and node.arg in KEYWORDS:
            yield node
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "model_config":
            yield node


def places(path: Path) -> Iterator[Place]:
    """Yield every possible change of a file, except in nodes without effect."""
    tree, name_of_file = get_ast_from_path(path), str(path.relative_to(ROOT))
    excluded = {
        (line, column)
        for node in without_effect(ast.parse(path.read_text(encoding="utf-8")))
        for line in range(node.lineno, node.end_lineno + 1)
        for column in range(
            node.col_offset if line == node.lineno else 0,
            node.end_col_offset if line == node.end_lineno else 1000,
        )
    }
    for name in filter(selected, operator_names()):
        operator = get_operator(name)
        if operator.arguments():
            continue
        positions = (
            position for node in ast_nodes(tree) for position in operator().mutation_positions(node)
        )
        for occurrence, (start, _) in enumerate(positions):
            if start not in excluded:
                yield (name_of_file, *start, name, occurrence)


def drawn(room: str, number: int, seed: int) -> list[Place]:
    """Draw places of a folder, each with one of its changes."""
    by_place: dict[tuple[str, int, int], list[Place]] = defaultdict(list)
    for path in sorted((ROOT / "bayesfric" / room).rglob("*.py")):
        for place in places(path):
            by_place[place[:3]].append(place)
    rng = random.Random(f"{seed} {room}")
    return [rng.choice(by_place[at]) for at in rng.sample(sorted(by_place), number)]


def environment(tree: Path) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}


def contexts(path: Path, rooms: list[str]) -> CoverageData:
    """Run the folders' tests once, and store which test executes which line."""
    if not path.exists():
        tests = [f"tests/{room}" for room in dict.fromkeys(ROOMS[room] for room in rooms)]
        command = [sys.executable, "-m", "pytest", "-q", "--cov=bayesfric", "--cov-context=test"]
        variables = {**environment(ROOT), "COVERAGE_FILE": str(path)}
        subprocess.run([*command, "--cov-report=", *tests], cwd=ROOT, env=variables, check=True)
    data = CoverageData(basename=str(path))
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
    """Return the tests that execute a line, or its folder for import time and compiled code."""
    file, line = place[:2]
    room = next(tests for folder, tests in ROOMS.items() if file.startswith(f"bayesfric/{folder}/"))
    if compiled(ROOT / file, line):  # coverage does not see compiled code
        return [f"tests/{room}"]
    by_line = data.contexts_by_lineno(str(ROOT / file))
    tests_of_line = {name.partition("|")[0] for name in by_line.get(line, []) if name}
    # at most MAX_TESTS, those of the folder first
    chosen = sorted(tests_of_line)[:: -(-len(tests_of_line) // MAX_TESTS) or 1]
    return sorted(chosen, key=lambda name: not name.startswith(f"tests/{room}/")) or [
        f"tests/{room}"
    ]


def noticed(place: Place, tests: list[str], tree: Path) -> dict[str, Any]:
    """Make one change in a copy of the repository, and run the tests."""
    file, line, _, name, occurrence = place
    path = tree / file
    source = path.read_text(encoding="utf-8")
    variables, kernels = environment(tree), None
    if "njit" in source:  # Numba caches by the caller's file
        kernels = variables["NUMBA_CACHE_DIR"] = mkdtemp()
    start = time.monotonic()
    changed = mutate_code(source, get_operator(name)(), occurrence)
    path.write_text(changed, encoding="utf-8")
    try:
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
        run = subprocess.run(command, cwd=tree, env=variables, capture_output=True, timeout=TIMEOUT)
        outcome = {0: "survived", 1: "killed", 2: "killed", 4: "killed"}.get(
            run.returncode, "failed"
        )
    except subprocess.TimeoutExpired:
        outcome = "killed"
    finally:
        path.write_text(source, encoding="utf-8")
        if kernels:
            shutil.rmtree(kernels)
    texts = [text.splitlines()[line - 1].strip() for text in (source, changed)]
    return {
        "file": file,
        "line": line,
        "operator": name.removeprefix("core/"),
        "was": texts[0],
        "became": texts[1],
        "found": outcome,
        "tests": len(tests),
        "seconds": round(time.monotonic() - start, 1),
    }


def main() -> None:
    """Run all mutants and write the survivors."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--mutants", type=int, default=50, help="of every folder")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rooms", nargs="+", default=list(ROOMS), choices=ROOMS)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--contexts", type=Path, default=FOLDER / "contexts.sqlite")
    parser.add_argument("--to", type=Path, default=FOLDER / "mutants.json")
    options = parser.parse_args()
    data = contexts(options.contexts, options.rooms)
    trees: Queue[Path] = Queue()
    for _ in range(options.workers):
        tree = Path(mkdtemp()) / ROOT.name
        for name in ("bayesfric", "tests", "studies", "figures"):
            shutil.copytree(ROOT / name, tree / name)
        for name in ("pyproject.toml", "README.md"):
            shutil.copy(ROOT / name, tree)
        trees.put(tree)

    def test_place(place: Place) -> dict[str, Any]:
        tree = trees.get()
        try:
            return noticed(place, tests_of(place, data), tree)
        finally:
            trees.put(tree)

    result: dict[str, Any] = {}
    with ThreadPoolExecutor(options.workers) as pool:
        for room in options.rooms:
            mutants = list(pool.map(test_place, drawn(room, options.mutants, options.seed)))
            killed = sum(mutant["found"] == "killed" for mutant in mutants)
            result[room] = {
                "mutants": len(mutants),
                "killed": killed,
                "survivors": [mutant for mutant in mutants if mutant["found"] != "killed"],
            }
            options.to.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
            print(f"{room}: {killed} of {len(mutants)} killed", flush=True)
            for mutant in result[room]["survivors"]:
                print(
                    f"   {mutant['file']}:{mutant['line']}  {mutant['was']}  ->  {mutant['became']}"
                )


if __name__ == "__main__":
    main()
