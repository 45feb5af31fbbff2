"""``bayesfric simulate``: a recording from known parameters, the truth beside it."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

import bayesfric
from bayesfric.config import Config
from bayesfric.errors import BadInput
from bayesfric.mechanism.experiment import Simulation, record
from bayesfric.report.files import write_beside


def simulate(config: Config, target: Path, *, seed: int | None = None) -> dict[str, Any]:
    """Simulate what ``[simulation]`` describes and write it as CSV.

    Parameters
    ----------
    config
        Its ``[mechanism]`` and ``[simulation]`` are used; without the latter, defaults.
    target
        CSV file to write; the truth goes beside it as ``<stem>.truth.json``.
    seed
        Replaces the configuration's.

    Returns
    -------
    dict
        The truth, as written.

    Raises
    ------
    BadInput
        If a value is impossible or the files cannot be written.
    """
    if target.suffix.lower() != ".csv":
        raise BadInput(str(target), "is not named .csv", "name the recording something.csv")
    options = config.tables.simulation or Simulation()
    if seed is not None:
        options = options.model_copy(update={"seed": seed})
    chain = config.tables.mechanism.chain()
    columns, motion, values = record(chain, options)
    table = io.StringIO()
    np.savetxt(
        table,
        np.stack(list(columns.values()), axis=1),
        # ten digits of time and position, six of torque: far below what is measured
        fmt=["%.10g", "%.10g", "%.6g"],
        delimiter=",",
        header=",".join(columns),
        comments="",
    )
    rotary = {"time": "s", "position": "rad", "torque": "N m"}
    linear = {"time": "s", "position": "m", "torque": "N"}
    truth: dict[str, Any] = {
        "simulated": True,
        "bayesfric": bayesfric.__version__,
        "parameters": {p.name: {"value": values[p.name], "unit": p.unit} for p in chain.parameters},
        "simulation": options.model_dump(mode="json"),
        "columns": rotary if chain.motor_motion == "rotary" else linear,
        "discretisation_error": motion.step_error,
        "reversals": motion.reversals,
    }
    write_beside(
        {
            target: table.getvalue(),
            target.with_suffix(".truth.json"): json.dumps(truth, indent=1) + "\n",
        }
    )
    return truth
