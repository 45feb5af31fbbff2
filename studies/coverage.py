"""Run all coverage studies, one after the other.

``python studies/coverage.py`` takes hours of two cores; each study writes its result to its folder
and prints the table of its README. ``--only whole_path pooled`` runs some, ``--list`` none.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
# Scripts and their options.
STUDIES: dict[str, list[str]] = {
    "calibration/calibrate.py": [],
    "calibration/whole_path.py": [],
    "calibration/motion.py": [],
    "identified/identified.py": [],
    "motion_only/motion_only.py": [],
    "closed_loop/closed_loop.py": [],
    "rabbit_knee/monte_carlo.py": [],
    "replication/replication.py": [],
    "replication/lacking.py": ["--recordings", "4"],
    "replication/pooled.py": [],
    "replication/fleets.py": [],
    "rollouts/rollouts.py": [],
    "xl330/next_run.py": [],
}


def main() -> None:
    """Run the studies; stop at the first failure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=[Path(script).stem for script in STUDIES])
    parser.add_argument("--list", action="store_true")
    options = parser.parse_args()
    if unknown := set(options.only) - {Path(script).stem for script in STUDIES}:
        parser.error(f"no study {', '.join(sorted(unknown))}; --list names them")
    for script, words in STUDIES.items():
        if Path(script).stem not in options.only:
            continue
        print(f"# {script} {' '.join(words)}", flush=True)
        if not options.list:
            began = time.monotonic()
            subprocess.run([sys.executable, FOLDER / script, *words], check=True)
            print(f"{(time.monotonic() - began) / 60.0:.0f} minutes", flush=True)


if __name__ == "__main__":
    main()
