"""``bayesfric simulate``: a recording from known parameters."""

from __future__ import annotations

import io
import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.base import __version__
from bayesfric.base.atomic_write import write_files
from bayesfric.base.errors import BadInput
from bayesfric.mechanism.experiment import Simulation, record
from bayesfric.mechanism.joint import Joint
from bayesfric.problem.config import Config


def simulate(config: Config, target: Path, *, seed: int | None = None) -> dict[str, Any]:
    """Simulate by ``[simulation]``, or its defaults, and write a CSV file.

    The true parameters are written as ``<stem>.truth.json``, and returned.
    """
    if target.suffix.lower() != ".csv":
        raise BadInput(str(target), "is not named .csv", "name the recording something.csv")
    options = config.tables.simulation or Simulation()
    if seed is not None:
        options = options.model_copy(update={"seed": seed})
    truth_file = target.with_suffix(".truth.json")
    with suppress(OSError):  # write_files reports an impossible name
        if target.is_file() and not truth_file.exists():
            problem = "exists, and without its .truth.json may be a measurement"
            raise BadInput(str(target), problem, "name another file with -o")
    with config.named():
        chain = config.tables.mechanism.joint()
        _check(options, chain)
        columns, motion, values = record(chain, options)
        if not all(np.isfinite(column).all() for column in columns.values()):
            hint = "lower amplitude or torque_noise"
            raise BadInput("simulation", "the recording overflows", hint)
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
        "bayesfric": __version__,
        "parameters": {p.name: {"value": values[p.name], "unit": p.unit} for p in chain.parameters},
        "simulation": options.model_dump(mode="json"),
        "columns": rotary if chain.motor_motion == "rotary" else linear,
        "discretisation_error": motion.step_error,
        "reversals": motion.reversals,
    }
    write_files(  # an older simulation is replaced
        {target: table.getvalue(), truth_file: json.dumps(truth, indent=1) + "\n"}, replace=True
    )
    return truth


def _check(options: Simulation, chain: Joint, most_samples: int = 10_000_000) -> None:
    """Refuse options that are impossible together; so many samples take some minutes."""
    samples = options.duration * options.rate
    if samples > most_samples:
        problem = f"makes {samples:.2g} samples at rate = {options.rate:g}"
        raise BadInput("simulation.duration", problem, f"stay below {most_samples:.0e}")
    if not options.frequencies:
        raise BadInput("simulation.frequencies", "is empty", "name at least one, in Hz")
    if options.added_mass and not options.radius and chain.load.motion == "rotary":
        raise BadInput("simulation.added_mass", "has no radius", "add radius = ... (in m)")
