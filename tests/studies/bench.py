"""Committed results of studies, and their scripts."""

import importlib
import json
import sys

import pytest

from tests.conftest import REPOSITORY

STUDIES = REPOSITORY / "studies"


def committed(path):
    return json.loads((STUDIES / path).read_text(encoding="utf-8"))


def results(path):
    """Give a fixture of what a study's committed result says."""

    @pytest.fixture(scope="module")
    def result():
        return committed(path)

    return result


def scripts(*names, folders):
    """Give a fixture of scripts that import each other from their folders: one, or a list."""

    @pytest.fixture(scope="module")
    def study():
        added = [str(STUDIES / folder) for folder in folders]
        sys.path[:0] = added
        try:
            found = [importlib.import_module(name) for name in names]
        finally:
            for path in added:
                sys.path.remove(path)
        return found[0] if len(names) == 1 else found

    return study
