"""What else explains the torque of MEASURED recordings? Needs ``../shared/data``.

``python studies/diagnostics/real.py`` asks the configurations of the other studies, and prints what
is found, in the order of the ranking.
"""

from __future__ import annotations

import os
import sys

if __name__ == "__main__":
    for variable in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")

from pathlib import Path

from bayesfric import Model

STUDIES = Path(__file__).resolve().parents[1]
CONFIGURATIONS = (
    "emps/emps-autoregressive.toml",
    "emps/emps-pulses.toml",
    "ur10e/ur10e-joint2-no-load-friction.toml",
    "ur10e/ur10e-joint2.toml",
    "xl330/xl330.toml",
    "dfki-pendulum/clean.toml",
)


def main() -> None:
    """Print a line a finding."""
    print("| recording | finding | z | p | share | hint | moves (sds) | rivals | CPU s |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name in sys.argv[1:] or CONFIGURATIONS:
        missing = Model.from_config(STUDIES / name).explain()
        if not missing.findings:
            print(f"| {name} | {missing.reason or 'nothing'} {'| ' * 7}{missing.cpu_seconds:.1f} |")
        for one in missing.findings:
            moves = ", ".join(f"{n} {one.moves[n]:+.1f}" for n in one.parameters[:3])
            what = f"{one.kind} {one.shape}{'' if one.physical else ' (wrong sign)'}"
            print(
                f"| {name} | {what} | {one.statistic:.1f} | {one.p:.2f} | {one.share:.1%} "
                f"| `{one.hint}` | {moves} | {', '.join(one.rivals[:4])} "
                f"| {missing.cpu_seconds:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
