"""Measure everything that is promised of time, memory and size, on an idle machine.

``python studies/benchmark/speed.py --runs 5 --pythons python3.11 python3.13`` installs this tree
with each interpreter in a new environment (seconds and MB go to ``install.json``), times the
commands there (``commands.py``), and then with the first one the fits (``fits.py``, with
``../shared/data``) and long recordings (``long.py``). An hour; each part writes its own file.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
SOURCE = FOLDER.parents[1]


def installed(python: str, folder: Path) -> tuple[Path, dict[str, float]]:
    """Install this tree in a new environment; return its interpreter, seconds and MB."""
    began, interpreter = time.monotonic(), folder / "bin" / "python"
    subprocess.run([python, "-m", "venv", folder], check=True)
    pip = [interpreter, "-m", "pip", "install", "--quiet"]
    subprocess.run([*pip, SOURCE], check=True)
    row = {"seconds": time.monotonic() - began, "mb": 0.0}
    files = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    row["mb"] = sum(path.stat().st_blocks for path in files) * 512 / 1e6
    subprocess.run([*pip, "arviz", "psutil"], check=True)  # of the imports that times relate to
    return interpreter, row


def main() -> None:
    """Run all parts, one after the other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--pythons", nargs="+", default=[sys.executable])
    parser.add_argument("--samples", nargs="*", default=[str(10**k) for k in range(4, 8)])
    options = parser.parse_args()
    # what pip installs has its bytecode, too
    unset = ("PYTHONPATH", "PYTHONDONTWRITEBYTECODE")
    environment = {name: value for name, value in os.environ.items() if name not in unset}
    runs = ["--runs", str(options.runs)]
    rows = {}
    with tempfile.TemporaryDirectory() as name:
        interpreters = []
        for k, python in enumerate(options.pythons):
            interpreter, row = installed(python, Path(name) / str(k))
            interpreters.append(interpreter)
            rows[python] = row
            print(f"{python}: installed in {row['seconds']:.0f} s, {row['mb']:.0f} MB", flush=True)
        (FOLDER / "install.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
        parts = [[python, FOLDER / "commands.py", *runs] for python in interpreters]
        parts += [[interpreters[0], FOLDER / "fits.py", *runs]]
        parts += [[interpreters[0], FOLDER / "long.py", "--samples", *options.samples]]
        for words in parts:
            print(words[1].name, flush=True)
            subprocess.run(words, env=environment, check=True)


if __name__ == "__main__":
    main()
