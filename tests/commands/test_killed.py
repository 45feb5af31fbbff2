"""After SIGKILL the next command clears what is left, and comes to the same numbers."""

import random
import shutil
import subprocess
import sys
import time

import numpy as np
import pytest

from tests.commands.bench import simulated
from tests.commands.test_fit import CONFIG, draws

FEW = CONFIG.replace("min_ess = 500", "min_ess = 1e6\nmax_steps = 100\nwalkers = 10")
COMMAND = [sys.executable, "-m", "bayesfric", "fit", "few.toml", "-o", "run"]


def started(folder, *more):
    return subprocess.Popen([*COMMAND, *more], cwd=folder, stderr=subprocess.PIPE)


def ended(process):
    _, err = process.communicate(timeout=600)
    assert process.returncode in (0, 3), err


def left(folder):
    """Names of what was left beside a run."""
    paths = (path.relative_to(folder).as_posix() for path in folder.rglob("*"))
    return [name for name in paths if name[0] == "." or name.endswith(".partial")]


@pytest.mark.slow
def test_killed_three_times(tmp_path):
    simulated(tmp_path / "few.toml", FEW)
    began = time.monotonic()
    ended(started(tmp_path))
    lasted = time.monotonic() - began
    expected, rng = draws(tmp_path / "run"), random.Random("fit")
    assert left(tmp_path) == []
    for _ in range(3):
        shutil.rmtree(tmp_path / "run")
        process = started(tmp_path)
        time.sleep(rng.uniform(0.1, 0.8) * lasted)
        process.kill()
        process.communicate()
        if not (tmp_path / "run").exists():
            kept = [*tmp_path.glob(".run.checkpoint/*.json")]
            ended(started(tmp_path, *(["--resume"] if kept else [])))
        found = draws(tmp_path / "run")
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name], values, err_msg=name)
        assert left(tmp_path) == []
