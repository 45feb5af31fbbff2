"""What a long recording costs: CPU seconds, memory, bytes. SIMULATED.

``python studies/benchmark/long.py [--samples 10000 100000]`` makes the demo's recording so
long, fits it in a process of its own, and prints CPU seconds over those of importing the libraries,
the most memory, and the size of ``posterior.nc``. Writes ``long.json``.
"""

from __future__ import annotations

import argparse
import json
import resource
import tempfile
from pathlib import Path

from commands import BAYESFRIC, IMPORTS, timed

HERE = Path(__file__).resolve().parent
SOURCE = HERE.parents[1]


def main() -> None:
    """Make them longer and longer, so that the most memory is always the last one's."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, nargs="*", default=[10_000, 100_000])
    asked = parser.parse_args()
    from bayesfric.commands.fit import demo_config

    result = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        timed(["-c", IMPORTS], SOURCE, folder)  # fills the disk's cache
        base = timed(["-c", IMPORTS], SOURCE, folder)[2]
        for samples in sorted(asked.samples):
            text = demo_config().text.replace("duration = 10.0", f"duration = {samples / 1e3}")
            (folder / "knee.toml").write_text(text, encoding="utf-8")
            timed([*BAYESFRIC, "simulate", "knee.toml", "-o", "knee.csv"], SOURCE, folder)
            run = str(samples)
            cpu = timed([*BAYESFRIC, "fit", "knee.toml", "-o", run], SOURCE, folder)[2]
            most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0
            size = (folder / run / "posterior.nc").stat().st_size / 1e6
            row = {"samples": samples, "cpu": cpu, "over_imports": cpu / base}
            result.append(row | {"memory_mb": most, "posterior_mb": size})
            print(
                f"{samples:>10,} {cpu:6.1f} s = {cpu / base:5.1f} ×  {most:6.0f} MB  "
                f"posterior.nc {size:5.1f} MB",
                flush=True,
            )
    (HERE / "long.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
