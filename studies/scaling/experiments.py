"""Every experiment that ``identify --advise`` ranks, made (SIMULATED) and sampled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.fit.model import Model
from bayesfric.inference.fitting import fit
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.experiment import Simulation, measure
from bayesfric.mechanism.presets import PRESETS
from bayesfric.problem.config import Config, parse_config, read_config

# Far enough for the sd of an sd to be 2 %; a posterior that mixes slowly ends ``tentative``.
ESS, MOST_STEPS = 2000.0, 2000
# Of the ranking, the first so many are sampled, and of the rest one in so many.
FIRST, ONE_IN = 10, 10
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
    """Rank the next recordings for one quantity, then make and sample each with the present one.

    Parameters
    ----------
    path
        Configuration of the present recording, simulated from Table 3.
    name
        A derived quantity that should be known better.
    folder
        For the recordings.
    """
    config = read_config(path)
    problem = Model.from_config(config)
    found = problem.advise(name)
    truth = PRESETS["rabbit-knee"].values
    bench = Simulation(encoder_counts=8192, encoder_side="motor", torque_noise=0.02)
    rows = []
    for number, one in enumerate(found.advices, start=1):
        if number > FIRST and number % ONE_IN:
            continue
        made, bolted = one.candidate, one.candidate.inputs
        told = {"rate": 1.0 / made.period, "lag": made.lag}
        told |= {"added_mass": bolted.added_mass, "radius": bolted.radius}
        columns = measure(
            problem.chain,
            problem.chain.vector(truth),
            made.command,
            bench.model_copy(update=told),
            np.random.default_rng(100 + number),
            q0=made.q0,
            qd0=made.qd0,
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
        sd, status = _sampled(config, file, bolted, name)
        rows.append(
            {
                "rank": number,
                "form": one.candidate.form,
                "amplitude": one.candidate.amplitude,
                "added_mass": bolted.added_mass,
                "radius": bolted.radius,
                "predicted": one.after.sd,
                "sampled": sd,
                "status": status,
                "back_driven": {k: v["mean"] for k, v in one.load_drives.items()},
            }
        )
        print(f"  {number:2d} {rows[-1]['form']} predicted {one.after.sd:.5f} sampled {sd:.5f}")
    best = min(row["sampled"] for row in rows)
    return {
        "quantity": name,
        "ranked": len(found.advices),
        "candidates": rows,
        "chosen_over_best": rows[0]["sampled"] / best,
    }


def _sampled(config: Config, file: Path, bolted: Any, name: str) -> tuple[float, str]:
    """Sample the present recording together with a new one; sd of the quantity."""
    added = RECORDING.format(file=file.as_posix())
    if bolted.added_mass:
        added += MASS.format(mass=bolted.added_mass, radius=bolted.radius)
    text = config.text.replace("\n[sampling]", added + "\n[sampling]")
    problem = Model.from_config(parse_config(text, config.path))
    settings = problem.config.tables.sampling.model_copy(
        update={"min_ess": ESS, "max_steps": MOST_STEPS}
    )
    near = problem.estimates(("least-squares", "input-error"))
    result = fit(problem.target(dict(near[-1].point)), settings, estimates=near)
    values = {q.name: q.values for q in derive(result.chain, result.chain_draws(), 1.0)}
    return float(values[name].std()), result.posterior.diagnostics.status
