"""What else explains the torque of MEASURED recordings? Needs ``../shared/data``.

``python studies/diagnostics/real.py`` asks the configurations of the other studies, and prints what
is found, in the order of the ranking; ``--auto`` puts in what it finds and fits, as
``terms = "auto"`` does.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator

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


def found(name: str) -> Iterator[str]:
    """Give a line for each finding."""
    missing = Model.from_config(STUDIES / name).explain()
    if not missing.findings:
        yield f"| {name} | {missing.reason or 'nothing'} {'| ' * 7}{missing.cpu_seconds:.1f} |"
    for one in missing.findings:
        moves = ", ".join(f"{n} {one.moves[n]:+.1f}" for n in one.parameters[:3])
        what = f"{one.kind} {one.shape}{'' if one.physical else ' (wrong sign)'}"
        yield (
            f"| {name} | {what} | {one.statistic:.1f} | {one.p:.2f} | {one.share:.1%} "
            f"| `{one.hint}` | {moves} | {', '.join(one.rivals[:4])} "
            f"| {missing.cpu_seconds:.1f} |"
        )


def fitted(name: str) -> Iterator[str]:
    """Give the line of a fit with what is put in."""
    model = Model.from_config(STUDIES / name)
    begun = time.process_time()
    better, taken, left = model.completed()
    spent = time.process_time() - begun
    rms = [one.estimates(["input-error"])[0].residual_rms for one in (model, better)]
    summary = better.fit().summary
    yield (
        f"| {name} | {', '.join(f'`{one.hint}`' for one in taken)} | {rms[0]:.4g} | {rms[1]:.4g} "
        f"| {', '.join(f'{one.kind} {one.shape}' for one in left.findings)} | {spent:.0f} "
        f"| {summary.sampler.status} | {', '.join(doubt.kind for doubt in summary.doubts)} |"
    )


def main() -> None:
    """Print a line a finding, or a fit."""
    auto = "--auto" in sys.argv
    heads = (
        "recording | put in | rms before | rms after | left | CPU s | status | doubts"
        if auto
        else "recording | finding | z | p | share | hint | moves (sds) | rivals | CPU s"
    )
    print(f"| {heads} |\n|{'---|' * (heads.count('|') + 1)}")
    for name in [one for one in sys.argv[1:] if one != "--auto"] or CONFIGURATIONS:
        for line in (fitted if auto else found)(name):
            print(line, flush=True)


if __name__ == "__main__":
    main()
