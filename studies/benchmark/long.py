"""Measure CPU time, memory and file size of fits of long SIMULATED recordings.

``python studies/benchmark/long.py [--samples 10000 100000]`` makes the demo's recording so long,
fits it in a process of its own, and prints CPU seconds over those of importing the libraries, the
power of the length with which they grew, the most memory, and the size of ``posterior.nc``. Writes
``long.json``.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from commands import BAYESFRIC, IMPORTS, timed

FOLDER = Path(__file__).resolve().parent
SOURCE = FOLDER.parents[1]


def simulate(samples: int, folder: Path) -> None:
    """Make the demo's recording so long."""
    from bayesfric.commands.fit import demo_config

    text = demo_config().text.replace("duration = 10.0", f"duration = {samples / 1e3}")
    (folder / "knee.toml").write_text(text, encoding="utf-8")
    timed([*BAYESFRIC, "simulate", "knee.toml", "-o", "knee.csv"], SOURCE, folder)


def once(samples: int, folder: Path) -> None:
    """Fit, and print time, peak memory of child processes and file size."""
    timed(["-c", IMPORTS], SOURCE, folder)  # fills the disk cache
    base = timed(["-c", IMPORTS], SOURCE, folder)[2]
    cpu = timed([*BAYESFRIC, "fit", "knee.toml", "-o", "run"], SOURCE, folder)[2]
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0
    size = (folder / "run" / "posterior.nc").stat().st_size / 1e6
    row = {"samples": samples, "cpu": cpu, "over_imports": cpu / base}
    print(json.dumps(row | {"memory_mb": peak, "posterior_mb": size}))


def main() -> None:
    """Simulate each length and fit it in a separate parent process, one after the other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, nargs="*", default=[10**k for k in range(4, 8)])
    parser.add_argument("--once", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.once:
        once(options.samples[0], Path(options.once))
        return
    result = []
    for samples in options.samples:
        with tempfile.TemporaryDirectory() as folder:
            simulate(samples, Path(folder))
            words = [sys.executable, __file__, "--once", folder, "--samples", str(samples)]
            row = json.loads(subprocess.run(words, stdout=subprocess.PIPE, check=True).stdout)
        if result:
            growth = math.log(row["cpu"] / result[-1]["cpu"])
            row["power"] = growth / math.log(samples / result[-1]["samples"])
        result.append(row)
        print(
            f"{samples:>10,} {row['cpu']:6.1f} s = {row['over_imports']:5.1f} ×  "
            f"{row['memory_mb']:6.0f} MB  posterior.nc {row['posterior_mb']:5.1f} MB  "
            f"power {row.get('power', math.nan):.2f}",
            flush=True,
        )
    (FOLDER / "long.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
