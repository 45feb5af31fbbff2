"""Simulate and sample the experiments that ``identify --advise`` ranks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.fit.model import Model
from bayesfric.inference.fitting import fit
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.experiment import Simulation, measure
from bayesfric.mechanism.joint import PRESETS
from bayesfric.problem.config import Config, parse_config, read_config

# The error of an sd is then 2 %; a posterior that mixes slowly ends ``tentative``.
ESS, MOST_STEPS = 2000.0, 2000
# Number of first ranks that are sampled, and stride of the others.
FIRST, STRIDE = 10, 10
RECORDING = """
[[recordings]]
file = "{file}"
name = "added"
time = {{ column = "time", unit = "s" }}
position = {{ column = "position", unit = "rad", side = "motor" }}
torque = {{ column = "torque", unit = "N m" }}
"""
MASS = 'added_mass = "{mass} kg"\nradius = "{radius} m"\n'


def experiments(path: Path, name: str, folder: Path) -> dict[str, Any]:
    """Rank the next recordings for one quantity, then simulate and sample each with the first."""
    config = read_config(path)
    problem = Model.from_config(config)
    advice = problem.advise(name)
    truth = PRESETS["rabbit-knee"].values
    bench = Simulation(encoder_counts=8192, encoder_side="motor", torque_noise=0.02)
    rows = []
    for number, candidate in enumerate(advice.candidates, start=1):
        if number > FIRST and number % STRIDE:
            continue
        load = candidate.inputs
        settings = {"rate": 1.0 / candidate.period, "lag": candidate.lag}
        settings |= {"added_mass": load.added_mass, "radius": load.radius}
        columns = measure(
            problem.chain,
            problem.chain.vector(truth),
            candidate.command,
            bench.model_copy(update=settings),
            np.random.default_rng(100 + number),
            q0=candidate.q0,
            qd0=candidate.qd0,
        )[0]
        file = folder / f"{number}.csv"
        np.savetxt(
            file,
            np.stack(list(columns.values()), axis=1),
            delimiter=",",
            header=",".join(columns),
            comments="",
            fmt="%.10g",
        )
        sd, status = _sampled(config, file, load, name)
        rows.append(
            {
                "rank": number,
                "form": candidate.form,
                "amplitude": candidate.amplitude,
                "added_mass": load.added_mass,
                "radius": load.radius,
                "predicted": candidate.after.sd,
                "sampled": sd,
                "status": status,
                "back_driven": candidate.load_drives,
            }
        )
        print(
            f"  {number:2d} {rows[-1]['form']} predicted {candidate.after.sd:.5f} sampled {sd:.5f}"
        )
    best = min(row["sampled"] for row in rows)
    return {
        "quantity": name,
        "ranked": len(advice.candidates),
        "candidates": rows,
        "chosen_over_best": rows[0]["sampled"] / best,
    }


def _sampled(config: Config, file: Path, load: Any, name: str) -> tuple[float, str]:
    """Sample the first recording together with a new one; return the quantity's sd."""
    added = RECORDING.format(file=file.as_posix())
    if load.added_mass:
        added += MASS.format(mass=load.added_mass, radius=load.radius)
    text = config.text.replace("\n[sampling]", added + "\n[sampling]")
    problem = Model.from_config(parse_config(text, config.path))
    settings = problem.config.tables.sampling.model_copy(
        update={"min_ess": ESS, "max_steps": MOST_STEPS}
    )
    estimates = problem.estimates(("least-squares", "input-error"))
    result = fit(problem.target(dict(estimates[-1].point)), settings, estimates=estimates)
    values = {q.name: q.values for q in derive(result.chain, result.chain_draws(), 1.0)}
    return float(values[name].std()), result.posterior.diagnostics.status
