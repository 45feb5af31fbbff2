"""What band, decimation and noise model do to the EMPS estimates (MEASURED recording).

``python studies/emps/noise.py`` prints the table of README.md: generalised least squares, which for
this linear model is where the posterior's middle lies.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.fit.model import Model
from bayesfric.inference.likelihood.autoregression import burg, ljung_box, whitened
from bayesfric.inference.moments.residual_moments import follows
from bayesfric.problem.config import parse_config

CONFIG = Path(__file__).resolve().parent / "emps-white.toml"
CHOICES = ((10, 100), (20, 100), (25, 100), (40, 100), (40, 25), (100, 100))
ORDERS = (0, 1, 2, 3)


def main() -> None:
    print("| decimation | low-pass (Hz) | noise | M (kg) | Fv (N s/m) | Fc (N) | offset (N) | p |")
    print("|---|---|---|---|---|---|---|---|")
    text = CONFIG.read_text(encoding="utf-8")
    for decimate, lowpass in CHOICES:
        changed = text.replace("decimate = 10", f"decimate = {decimate}")
        changed = changed.replace('"100 Hz"', f'"{lowpass} Hz"')
        problem = Model.from_config(parse_config(changed, CONFIG))
        (o,) = problem.observations
        regressors = TotalsProjection(problem.chain, problem.observations).regressors
        runs = follows(o)
        for order in ORDERS:
            x, y = regressors, o.measured
            for _ in range(20):
                found = np.linalg.lstsq(x, y, rcond=None)[0]
                memory = burg([o.measured - regressors @ found], [runs], order)
                x = whitened(regressors.T, memory, runs).T
                y = whitened(o.measured, memory, runs)
            left = y - x @ found
            sd = np.sqrt(np.diag(np.linalg.inv(x.T @ x)) * np.mean(left**2))
            p = ljung_box([left], [runs], 10 + order, order)
            cells = " | ".join(f"{a:.2f} ± {b:.2f}" for a, b in zip(found, sd, strict=True))
            print(f"| {decimate} | {lowpass} | AR({order}) | {cells} | {p:.1g} |")


if __name__ == "__main__":
    main()
