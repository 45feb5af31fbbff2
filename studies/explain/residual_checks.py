"""Size and power of the checks of residuals, on SIMULATED residuals that remember.

``python studies/explain/residual_checks.py`` prints the table of the README. Residuals are noise of
an autoregression and, for power, what a concave loss leaves when constant and viscous loss have
taken what they can of it.
"""

from __future__ import annotations

import numpy as np

from bayesfric.inference.likelihood import autoregression as ar
from bayesfric.inference.likelihood.likelihood import Outputs
from bayesfric.report.summary import residual_analysis as checks

SEED, TIMES, OUTPUTS, RATE = 2028, 1000, 1500, 50.0
LINES = (0.21, 0.47, 0.83, 1.31)  # Hz


def judged(memory: float, share: float, rng: np.random.Generator) -> tuple[bool, bool, bool]:
    """Tell of one set of residuals whether they are said to depend on speed, perhaps, or not."""
    time = np.arange(OUTPUTS) / RATE
    phases = rng.uniform(0.0, 2.0 * np.pi, len(LINES))
    speed = sum(np.cos(2.0 * np.pi * f * time + p) for f, p in zip(LINES, phases, strict=True))
    columns = np.stack([speed, np.sign(speed), np.ones(OUTPUTS)], axis=1)
    concave = -speed * np.abs(speed)
    concave -= columns @ np.linalg.lstsq(columns, concave, rcond=None)[0]
    follows = np.ones(OUTPUTS - 1, dtype=bool)
    partial = np.array([memory]) if memory else np.zeros(0)
    noise = ar.simulated(partial, follows, 1, rng)[0]
    noise *= np.sqrt((1.0 - share) / np.mean(noise**2))
    left = noise + concave * np.sqrt(share / np.mean(concave**2))
    left -= columns @ np.linalg.lstsq(columns, left, rcond=None)[0]
    segments = np.zeros(OUTPUTS, dtype=np.int64)
    outputs = Outputs("made", "torque", "N m", time, left, 1.0 / RATE, segments, follows)
    found = checks._binned(("joint speed", "v", "rad/s"), speed, (outputs,), [left], columns)
    # the figure's share and these words are of one number
    denied = found.outcome == "none" and found.explained > found.chance + checks._LARGE
    assert not denied
    return found.outcome == "depends", found.outcome == "open", found.outcome == "none"


def main() -> None:
    """Print a row for each memory and share."""
    rng = np.random.default_rng(SEED)
    print("| lag-1 correlation | share of a concave loss | depends | cannot be told | none |")
    print("|---|---|---|---|---|")
    for memory in (0.0, 0.5, 0.9, 0.97):
        for share in (0.0, 0.05, 0.2, 0.41):
            times = TIMES if share == 0.0 else TIMES // 5
            rows = np.mean([judged(memory, share, rng) for _ in range(times)], axis=0)
            cells = " | ".join(f"{100 * x:.1f} %" for x in rows)
            print(f"| {memory} | {100 * share:.0f} % | {cells} |", flush=True)


if __name__ == "__main__":
    main()
