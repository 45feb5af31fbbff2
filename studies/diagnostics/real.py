"""Test what else explains the torque of MEASURED recordings. Needs ``../shared/data``.

``python studies/diagnostics/real.py`` tests the configurations of the other studies and prints
findings by rank; ``--auto`` adds them and fits, as ``terms = "auto"`` does.
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


def findings_of(name: str) -> Iterator[str]:
    """Yield a line for each finding."""
    missing = Model.from_config(STUDIES / name).explain()
    if not missing.findings:
        yield f"| {name} | {missing.reason or 'nothing'} {'| ' * 7}{missing.cpu_seconds:.1f} |"
    for finding in missing.findings:
        moves = ", ".join(f"{n} {finding.moves[n]:+.1f}" for n in finding.parameters[:3])
        effect = f"{finding.kind} {finding.shape}{'' if finding.physical else ' (wrong sign)'}"
        yield (
            f"| {name} | {effect} "
            f"| {finding.statistic:.1f} | {finding.p:.2f} | {finding.share:.1%} "
            f"| `{finding.hint}` | {moves} | {', '.join(finding.rivals[:4])} "
            f"| {missing.cpu_seconds:.1f} |"
        )


def fitted(name: str) -> Iterator[str]:
    """Yield the line of a fit with the findings added."""
    model = Model.from_config(STUDIES / name)
    start = time.process_time()
    extended, added, explanation = model.completed()
    seconds = time.process_time() - start
    rms = [m.estimates(["input-error"])[0].residual_rms for m in (model, extended)]
    summary = extended.fit().summary
    yield (
        f"| {name} | {', '.join(f'`{finding.hint}`' for finding in added)} "
        f"| {rms[0]:.4g} | {rms[1]:.4g} "
        f"| {', '.join(f'{f.kind} {f.shape}' for f in explanation.findings)} | {seconds:.0f} "
        f"| {summary.sampler.status} | {', '.join(doubt.kind for doubt in summary.doubts)} |"
    )


def main() -> None:
    """Print a line for each finding, or for each fit."""
    auto = "--auto" in sys.argv
    heads = (
        "recording | added | rms before | rms after | remaining | CPU s | status | doubts"
        if auto
        else "recording | finding | z | p | share | hint | moves (sds) | rivals | CPU s"
    )
    print(f"| {heads} |\n|{'---|' * (heads.count('|') + 1)}")
    for name in [argument for argument in sys.argv[1:] if argument != "--auto"] or CONFIGURATIONS:
        for line in (fitted if auto else findings_of)(name):
            print(line, flush=True)


if __name__ == "__main__":
    main()
