"""Compare BAM's models M1 to M6 on MEASURED runs of the XL330: fit twelve, predict four.

``python studies/xl330/models.py`` prints the table of README.md. Each model is fitted by the
input error to the runs of three position gains, and predicts the torque of the fourth.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from held_out import GAINS

from bayesfric import Element, Joint
from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.point_estimate import Knowledge
from bayesfric.estimates.torque import filtered_torque
from bayesfric.fit.model import Model
from bayesfric.problem.config import parse_config

PATH = Path(__file__).with_name("xl330-held-out.toml")
FRICTION = {"inertia": True, "coulomb": "symmetric", "viscous": True}
APART = {"stribeck": "apart", "stribeck_exponent": True}
# Their terms in this package (Duclusaud et al. 2024, table I).
MODELS: dict[str, dict[str, Any]] = {
    "M1: Coulomb and viscous": FRICTION,
    "M2: with Stribeck": FRICTION | {"stribeck": True, "stribeck_exponent": True},
    "M3: with load": FRICTION | {"load_loss": "one"},
    "M4: with load and Stribeck of both": FRICTION | APART | {"load_loss": "one"},
    "M5: M4, driving and back-driven apart": FRICTION | APART | {"load_loss": "two"},
    "M6: M5 with the square of the load": FRICTION
    | APART
    | {"load_loss": "two", "load_square": True},
    "M3 with cogging 6 times a turn": FRICTION | {"load_loss": "one", "cogging": (6,)},
}


def errors(options: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return mean square torque errors of the runs held out ``(16,)`` and fitted ``(4,)``."""
    held_out, fitted = [], []
    for names in GAINS.values():
        config = parse_config(PATH.read_text(encoding="utf-8"), PATH)
        recordings = tuple(f"2026-01-15_{name}" for name in names)
        validation = config.tables.validation.model_copy(update={"recordings": recordings})
        tables = config.tables.model_copy(update={"validation": validation})
        model = Model.from_config(replace(config, tables=tables))
        chain = Joint((Element("motor", **options),), model.chain.load, gain=True)
        estimation = model.config.tables.estimation
        estimate = input_error(chain, model.observations, Knowledge(), estimation)
        values = chain.vector(dict(estimate.point))[None]
        for predicted in model.held_out:
            signals = predicted.observation
            residual = signals.measured - filtered_torque(chain, signals, values)[0]
            held_out.append(float(np.mean(residual**2)))
        fitted.append(estimate.residual_rms**2)
    return np.array(held_out), np.array(fitted)


def main() -> None:
    """Print a row for each model."""
    outcomes = {name: errors(options) for name, options in MODELS.items()}
    best = min(outcomes, key=lambda name: outcomes[name][0].mean())
    print("| model | fitted | " + " | ".join(map(str, GAINS)) + " | all | worse than the best by |")
    print("|---" * (len(GAINS) + 4) + "|")
    for name, (held_out, fitted) in outcomes.items():
        gains = held_out.reshape(len(GAINS), -1).mean(axis=1)
        excess = held_out - outcomes[best][0]
        error = excess.std(ddof=1) / np.sqrt(excess.size)
        worse = "–" if name == best else f"{1e6 * excess.mean():.0f} ± {1e6 * error:.0f}"
        cells = [fitted.mean(), *gains, held_out.mean()]
        print(f"| {name} | " + " | ".join(f"{x**0.5:.4f}" for x in cells) + f" | {worse} |")


if __name__ == "__main__":
    main()
