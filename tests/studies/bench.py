"""Committed results of studies, and their scripts."""

import importlib
import json
import sys

import numpy as np
import pytest

from tests.conftest import REPOSITORY

STUDIES = REPOSITORY / "studies"


def committed(path):
    return json.loads((STUDIES / path).read_text(encoding="utf-8"))


def results(path):
    """Return a fixture of a study's committed result."""
    return pytest.fixture(scope="module")(lambda: committed(path))


def scripts(name, folders):
    """Return a fixture of a script that imports others from these folders."""

    @pytest.fixture(scope="module")
    def script():
        added = [str(STUDIES / folder) for folder in folders]
        sys.path[:0] = added
        try:
            return importlib.import_module(name)
        finally:
            for path in added:
                sys.path.remove(path)

    return script


def medians_agree(first, second, sd, draws=1000):
    """Whether medians of so many independent draws each are within five standard errors."""
    return abs(first - second) < 5.0 * sd * np.sqrt(np.pi / 2.0 * 2.0 / draws)
