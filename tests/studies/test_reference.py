"""Pages name functions, tests and files that are there."""

import ast
import re

from tests.conftest import REPOSITORY


def test_every_equation_names_a_function_and_a_test_that_are_there():
    text = (REPOSITORY / "studies" / "reference" / "equations.md").read_text(encoding="utf-8")
    pairs = re.findall(r"`([\w/]+\.py)` `(\w+)`", text)
    assert len(pairs) == 2 * len(re.findall(r"^\| (?:\(|section)", text, re.M))
    for path, name in pairs:
        tree = ast.parse((REPOSITORY / path).read_text(encoding="utf-8"))
        assert name in {getattr(node, "name", None) for node in tree.body}, (path, name)


def test_what_contributing_names_is_there():
    text = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8")
    for path in re.findall(r"`((?:bayesfric|tests|studies)/[\w./]+)`", text):
        assert (REPOSITORY / path).exists(), path
