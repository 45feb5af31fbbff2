"""Friction laws of both motions of the UR10 by least squares: the second one is computed.

``python studies/ur10-arm/law.py`` writes ``law.json``: by joint and motion, Coulomb friction that
rises as tanh of speed over a width (0: a step), viscous friction, armature, offset, and the rms
residual, with bodies of the URDF and their uncertainty; and the held-out rms on the other motion.
"""

import json
import tempfile
from pathlib import Path

import numpy as np
from run import DATA, FOLDER, LOG, validation_log

import bayesfric as bf
from bayesfric.arm.departures import bodies_torques

WIDTHS = (0.0, 0.03, 0.1, 0.2, 0.3)  # rad/s


def columns(signals, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Filter the torques of bodies, deviations and a unit of each number; with the outputs."""
    step = np.tanh(signals.qd / width) if width else np.sign(signals.qd)
    numbers = step, signals.qd, signals.qdd, np.ones_like(signals.q)
    rows = np.vstack([bodies_torques(signals), *numbers])
    return signals.filter.apply(rows).T, signals.measured


def law(observation, held_out, width: float, armature: bool) -> dict[str, float]:
    """Least squares with standard normal deviations; without an armature if it is to be zero."""
    x, y = columns(observation, width)
    count = x.shape[1] - 4
    precision = np.r_[1e8, np.ones(count - 1), np.zeros(4)]  # the URDF's own torque has factor one
    precision[-2] = 0.0 if armature else 1e8
    target, sd = np.eye(x.shape[1])[0], 1.0
    for _ in range(5):
        information = x.T @ x / sd**2 + np.diag(precision)
        values = np.linalg.solve(information, x.T @ y / sd**2 + precision * target)
        sd = float(np.std(y - x @ values))
    other, measured = columns(held_out, width)
    rms = float(np.sqrt(np.mean((measured - other @ values) ** 2)))
    names = "Coulomb", "viscous", "armature", "offset"
    return {n: round(v, 3) for n, v in zip(names, values[count:].tolist(), strict=True)} | {
        "width": width, "residual": round(sd, 4), "held out": round(rms, 3),
    }  # fmt: skip


def main() -> None:
    """Write the steps, the best smooth laws, and the steps without an armature."""
    result: dict = {}
    with tempfile.TemporaryDirectory() as folder:
        computed = Path(folder) / "validation.csv"
        validation_log(computed)
        for motion, logs in (("first", (LOG, computed)), ("second", (computed, LOG))):
            _, models, _ = bf.Arm(DATA / "ur10.urdf").prepared([logs[0]], logs[1])
            for name, model in models.items():
                pair = model.observations[0], model.held_out[0].observation
                laws = [law(*pair, width, armature=True) for width in WIDTHS]
                result.setdefault(name, {})[motion] = {
                    "step": laws[0],
                    "smooth": min(laws, key=lambda x: x["residual"]),
                    "no armature": law(*pair, 0.0, armature=False),
                }
    (FOLDER / "law.json").write_text(f"{json.dumps(result, indent=1)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
