"""After SIGKILL the next command clears what is left, and comes to the same bytes.

``python -m tests.commands.test_killed FOLDER KILLS`` kills every command that often.
"""

import json
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest

from tests.commands.bench import simulated
from tests.commands.test_fit import CONFIG
from tests.fleet.made import write_fleet

FEW = CONFIG.replace("min_ess = 500", "min_ess = 1e6\nmax_steps = 100\nwalkers = 10")
POOLED = FEW.replace("[self_check]", '[pooling]\nvary = { offset = "recording" }\n[self_check]')
COMMANDS = {
    "fit": ("fit", "few.toml", "-o", "run"),
    "pool": ("pool", "pooled.toml", "--json"),
    "fleet": ("fleet", "fleet.toml", "-o", "all", "--workers", "1"),
    "report": ("report", "done", "--paper"),
}


def started(folder, *words):
    quiet = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "cwd": folder}
    return subprocess.Popen([sys.executable, "-m", "bayesfric", *words], **quiet)


def ended(process):
    out, err = process.communicate(timeout=600)
    assert process.returncode in (0, 3), err
    return out


def made(folder):
    """Inputs of all commands, and a finished run."""
    simulated(folder / "few.toml", FEW)
    simulated(folder / "pooled.toml", POOLED, "other", seed=2)
    text = POOLED.replace('file = "small.csv"', 'file = ["small.csv", "other.csv"]')
    (folder / "pooled.toml").write_text(text)
    write_fleet(folder, good=2)
    return folder


def prepared(where, folder):
    """Copy the inputs: nothing of one trial is there in the next."""
    shutil.copytree(where, folder)
    return folder


def held(folder):
    """What a command made, without times; the names of what is left beside it."""
    files, left = {}, []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if any(part.startswith(".") or part.endswith(".partial") for part in Path(name).parts):
            left.append(name)
        elif path.suffix == ".nc":
            with h5py.File(path) as file:
                files[name] = {key: np.array(x).tobytes() for key, x in file["posterior"].items()}
        elif path.name == "summary.json":
            told = json.loads(path.read_text())
            told["sampler"]["seconds"] = told["self_check"] = told["source"] = None
            files[name] = told
        elif path.suffix == ".parquet":  # complaints name the folder
            files[name] = pd.read_parquet(path).drop(columns="error").to_json()
        elif path.is_file() and path.suffix in (".csv", ".tex", ".toml"):
            files[name] = path.read_bytes()
    return files, left


def told(out):
    """What a pool printed, without times."""
    try:
        return {k: v for k, v in json.loads(out).items() if "seconds" not in k}
    except ValueError:
        return None


def gone_on(folder, name):
    """Give the same command again, as its user would."""
    words = list(COMMANDS[name])
    if name == "fit" and (folder / ".run.checkpoint").exists():
        words += ["--resume"] * bool([*(folder / ".run.checkpoint").glob("*.steps")])
    if name == "fleet" and (folder / "all" / "fleet.toml").is_file():
        words.append("--resume")
    return ended(started(folder, *words))


def killed(where, at, name, kills, rng):
    """Kill a command at random moments; how many of them were before its end."""
    whole = prepared(where, at / f"{name}-whole")
    began = time.monotonic()
    printed = told(ended(started(whole, *COMMANDS[name])))
    lasted = time.monotonic() - began
    expected, left = held(whole)
    assert left == []
    early = 0
    for k in range(kills):
        folder = prepared(where, at / f"{name}-{k}")
        process = started(folder, *COMMANDS[name])
        time.sleep(rng.uniform(0.1, 0.8) * lasted)
        process.kill()
        process.communicate()
        early += process.returncode == -9
        if name == "fit" and (folder / "run").exists() and not [*folder.glob(".run.*")]:
            continue  # it had ended
        assert told(gone_on(folder, name)) == printed
        found, left = held(folder)
        assert left == [], (name, k)
        # what was written and not yet marked as such is kept aside
        found = {key: x for key, x in found.items() if not key.startswith("run.old")}
        assert found.keys() == expected.keys(), (name, k)
        for key, value in expected.items():
            assert found[key] == value, (name, k, key)
        shutil.rmtree(folder)
    return early


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = made(tmp_path_factory.mktemp("inputs"))
    ended(started(folder, "fit", "few.toml", "-o", "done"))
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_killed_three_times(inputs, tmp_path, name):
    killed(inputs, tmp_path, name, 3, random.Random(name))


if __name__ == "__main__":
    place, count = Path(sys.argv[1]), int(sys.argv[2])
    ready = place / "inputs"
    ready.mkdir(parents=True)
    made(ready)
    ended(started(ready, "fit", "few.toml", "-o", "done"))
    for command in sys.argv[3:] or COMMANDS:
        print(command, killed(ready, place, command, count, random.Random(command)), flush=True)
