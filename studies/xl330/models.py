"""BAM's models M1 to M6 on MEASURED runs of the XL330: fit twelve, predict the four of a gain.

``python studies/xl330/models.py`` prints the table of README.md. Each model is fitted by the
input error to the runs of three position gains, and predicts the torque of the fourth.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from held_out import GAINS

from bayesfric import Element, Joint
from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.torque import filtered_torque
from bayesfric.fit.model import Model
from bayesfric.problem.config import parse_config

PATH = Path(__file__).with_name("xl330-held-out.toml")
FRICTION = {"inertia": True, "coulomb": "symmetric", "viscous": True}
APART = {"stribeck": "apart", "stribeck_exponent": True}
# What they are made of in the terms of this package (Duclusaud et al. 2024, table I).
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
    """Mean square errors of torque of the sixteen runs when their gain is left out; all fitted."""
    held_out, fitted = [], []
    for names in GAINS.values():
        config = parse_config(PATH.read_text(encoding="utf-8"), PATH)
        whole = tuple(f"2026-01-15_{name}" for name in names)
        kept = config.tables.validation.model_copy(update={"recordings": whole})
        tables = config.tables.model_copy(update={"validation": kept})
        model = Model.from_config(config.model_copy(update={"tables": tables}))
        chain = Joint((Element("motor", **options),), model.chain.load, gain=True)
        options_ = model.config.tables.estimation
        found = input_error(chain, model.observations, Knowledge(), options_)
        values = chain.vector(dict(found.point))[None]
        for one in model.held_out:
            o = one.observation
            left = o.measured - filtered_torque(chain, o, values)[0]
            held_out.append(float(np.mean(left**2)))
        fitted.append(found.residual_rms**2)
    return np.array(held_out), np.array(fitted)


def main() -> None:
    """Print a row for each model."""
    found = {name: errors(options) for name, options in MODELS.items()}
    best = min(found, key=lambda name: found[name][0].mean())
    print("| model | fitted | " + " | ".join(map(str, GAINS)) + " | all | worse than the best by |")
    print("|---" * (len(GAINS) + 4) + "|")
    for name, (held_out, fitted) in found.items():
        gains = held_out.reshape(len(GAINS), -1).mean(axis=1)
        apart = held_out - found[best][0]
        error = apart.std(ddof=1) / np.sqrt(apart.size)
        worse = "–" if name == best else f"{1e6 * apart.mean():.0f} ± {1e6 * error:.0f}"
        cells = [fitted.mean(), *gains, held_out.mean()]
        print(f"| {name} | " + " | ".join(f"{x**0.5:.4f}" for x in cells) + f" | {worse} |")


if __name__ == "__main__":
    main()
