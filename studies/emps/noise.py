"""Compare EMPS estimates by band, decimation and noise model (MEASURED recording).

``python studies/emps/noise.py`` prints the table of README.md: generalised least squares, which
for this linear model equals the posterior's median.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayesfric.estimates.autoregression import burg, follows, ljung_box, whitened
from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.fit.model import Model
from bayesfric.problem.config import parse_config

CONFIG = Path(__file__).resolve().parent / "emps-white.toml"
CHOICES = ((10, 100), (20, 100), (25, 100), (40, 100), (40, 25), (100, 100))
ORDERS = (0, 1, 2, 3)


def main() -> None:
    """Print a row for each band, decimation and order."""
    print("| decimation | low-pass (Hz) | noise | M (kg) | Fv (N s/m) | Fc (N) | offset (N) | p |")
    print("|---|---|---|---|---|---|---|---|")
    text = CONFIG.read_text(encoding="utf-8")
    for decimate, lowpass in CHOICES:
        configuration = text.replace("decimate = 10", f"decimate = {decimate}")
        configuration = configuration.replace('"100 Hz"', f'"{lowpass} Hz"')
        problem = Model.from_config(parse_config(configuration, CONFIG))
        (signals,) = problem.observations
        regressors = TotalsProjection(problem.chain, problem.observations).regressors
        runs = follows(signals)
        for order in ORDERS:
            x, y = regressors, signals.measured
            for _ in range(20):
                estimate = np.linalg.lstsq(x, y, rcond=None)[0]
                coefficients = burg([signals.measured - regressors @ estimate], [runs], order)
                x = whitened(regressors.T, coefficients, runs).T
                y = whitened(signals.measured, coefficients, runs)
            residual = y - x @ estimate
            sd = np.sqrt(np.diag(np.linalg.inv(x.T @ x)) * np.mean(residual**2))
            p = ljung_box([residual], [runs], 10 + order, order)
            cells = " | ".join(f"{a:.2f} ± {b:.2f}" for a, b in zip(estimate, sd, strict=True))
            print(f"| {decimate} | {lowpass} | AR({order}) | {cells} | {p:.1g} |")


if __name__ == "__main__":
    main()
