"""The law of a fitted joint, with a few hundred draws, for a page that works out torques.

All of it is data, see :mod:`bayesfric.mechanism.law`: nothing of a run directory is run.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.base.safe_read import read_json
from bayesfric.estimates.assemble import open_scalings
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.torque import load_at_outputs
from bayesfric.inference.fitting import Fit
from bayesfric.mechanism import kernels
from bayesfric.mechanism.inverse import load_reach
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.law import (
    Formula,
    Statements,
    Traced,
    Unwritten,
    Varying,
    formula_of,
    names_in,
    of_time,
    torque_of,
)
from bayesfric.mechanism.parameter import Parameter
from bayesfric.mechanism.quantities import (
    CHOICES,
    CYCLE_PHRASES,
    CYCLES,
    LOAD_CHOICES,
)
from bayesfric.recordings.arrays import Array
from bayesfric.report.summary.derived_quantities import LEVEL

FILE = "page.json"
# Of a few hundred draws; anything larger is some other file.
_LARGEST = 2_000_000
# Ends of a 90 % band of so many draws are known to a tenth of its width.
_DRAWS = 300
# Of a draw; far finer than draws differ, and a third of the bytes.
_DIGITS = 7
_INPUTS = {"position": "q", "acceleration": "a"}
# What the page's script tells, beside the terms by number: see `_law`.
_TOLD = ("torque", "recorded", "friction", "load-loss", "outside", "weight")
Calculator = dict[str, Any]  # what the page's script works with, see `written`


def calculator(fit: Fit) -> Calculator:
    """Write a fitted joint down; where it has a term that cannot be, say which.

    Draws are those that allow for the model's error, where the recordings show any.
    """
    chain = fit.chain
    values = fit.wide.target.chain_values(fit.wide.posterior.flat(_DRAWS))
    values = np.array([[float(f"{x:.{_DIGITS}g}") for x in row] for row in values.tolist()])
    fixed = [i for i, name in enumerate(chain.names) if name not in fit.target.free]
    known = Knowledge({chain.names[i]: float(values[0, i]) for i in fixed})
    open_scale = bool(open_scalings(chain, known, fit.observations))
    seen = _seen(fit, values, open_scale=open_scale)
    return written(chain, values, seen, open_scale=open_scale)


def written(
    chain: Joint, values: Array, seen: Mapping[str, Any], *, open_scale: bool
) -> Calculator:
    """Write a joint down with vectors ``(n, n_parameters)`` of its parameters.

    ``values`` has a column of draws for each of ``names``, or a number where it does not vary.
    ``law`` are names and formulas, one after the other, of ``q``, ``v``, ``a``, ``s`` (see
    :class:`bayesfric.mechanism.law.Statements`), of the torque ``load`` from outside and of the
    parameters ``p0``, ``p1``, ...; ``groups`` tell what its terms by number are. ``open_scale``
    is whether the scale between load and load losses is open; ``begins`` whether there are terms of
    temperature or time, which are those of 20 degC and of a beginning; ``scaled`` whether
    ``drive.gain`` is the torque's factor. Where the law has a term that cannot be written down,
    ``missing`` names it, and nothing else is there.
    """
    try:
        law, groups = _law(chain, open_scale=open_scale)
    except Unwritten as error:
        return {"missing": str(error)}
    named = set().union(*(names_in(formula) for _, formula in law))
    return {
        "missing": "",
        "level": LEVEL,
        "names": list(chain.names),
        "values": [float(x[0]) if np.ptp(x) == 0.0 else x.tolist() for x in values.T],
        "law": law,
        "groups": groups,
        "inputs": [name for name, known in _INPUTS.items() if known in named],
        "lossy": any(element.load_loss != "none" for element in chain.elements),
        "open_scale": open_scale,
        "own_offsets": bool(chain.own_offsets),
        "begins": any(of_time(p.row) for p in chain.parameters),
        "scaled": chain.gain,
        "motion": chain.load.motion,
        "motor_motion": chain.motor_motion,
        "seen": dict(seen),
    }


def calculator_json(found: Calculator) -> str:
    """Write ``page.json``."""
    return json.dumps({"calculator": found}, ensure_ascii=False, allow_nan=False) + "\n"


def read_calculator(run: Path) -> Calculator | None:
    """Read what a run directory holds for its page; nothing where it holds none that is whole."""
    try:
        found = read_json(run / FILE, largest=_LARGEST)["calculator"]
        return found if found["missing"] or (found["seen"] and found["law"]) else None
    except (BadInput, ValueError, KeyError, TypeError):
        return None


def _law(
    chain: Joint, *, open_scale: bool
) -> tuple[list[tuple[str, Formula]], list[dict[str, Any]]]:
    """Write statements of all that the page tells, as the motor feels it, and groups of terms."""
    vector = np.array([Varying(f"p{k}") for k in range(len(chain.names))], dtype=object)
    load = chain.tables(vector[None]).load[0]
    made, push = Statements("push", *_TOLD), Traced("push")
    torque = made.put("whole", made.torque(chain, vector, push) + load[kernels.OFFSET])
    felt = {
        name: load_reach(chain, vector[None], open_scale=open_scale, passed=k)[0]
        for k, name in enumerate((*(e.name for e in chain.elements), "load"))
    }
    groups: dict[str, dict[str, Any]] = {}
    parts: dict[str, Any] = {}
    for p, value in zip(chain.parameters, vector, strict=True):
        if p.row.role != "own" or p.row.signal or (p.row.name == "offset" and chain.own_offsets):
            continue  # a shape; none at 20 degC and at rest; whose it is, only the recording says
        key = p.row.option or p.name
        loss = bool({"speed", "direction"} & names_in(formula_of(p.row)))
        groups.setdefault(key, {"words": _words(p), "loss": loss})
        part = value * _column(made, chain, vector, p) * felt.get(p.owner, 1.0)
        parts[key] = parts.get(key, 0.0) + part
    parts = {key: made.put("part", part) for key, part in parts.items()}
    outside = made.put("away", -push * felt["load"])
    passed = made.put("rest", torque - outside - sum(parts.values()))
    lost = sum(parts[key] for key, group in groups.items() if group["loss"])
    weight = made.weight(load, push) * felt["load"]
    answers = (torque, torque / load[kernels.GAIN], passed + lost, passed, outside, weight)
    for name, answer in (*zip(_TOLD, answers, strict=True), *enumerate(parts.values())):
        made.tell(str(name), answer)
    told = made.used(*_TOLD, *map(str, range(len(parts))))
    return [(name, formula) for name, formula in told if name], list(groups.values())


def _column(made: Statements, chain: Joint, vector: Array, p: Parameter) -> Any:
    """Torque of a term for a coefficient of one, with its rise at low speed."""
    elements, (load,), _ = chain.tables(vector[None])
    gravity = load[kernels.GRAVITY] * np.sin(Traced("q") + load[kernels.GRAVITY_ANGLE])
    at = made.at(chain.reaches[p.owner])._replace(gravity=gravity)
    shape = [vector[chain.names.index(f"{p.owner}.{p.row.shape}")]] if p.row.shape else []
    column = torque_of(p.row, at, *shape)
    if not p.row.rises:
        return column
    k = [e.name for e in chain.elements].index(p.owner)
    return column * made.kernels["rises"](elements[0, k], at.speed)[0]


def _words(p: Parameter) -> str:
    option = p.row.option
    if not option:
        return p.meaning
    if option in CYCLES:
        return CYCLE_PHRASES[option]
    return next(iter({**CHOICES, **LOAD_CHOICES}[option].values()))


def _seen(fit: Fit, values: Array, *, open_scale: bool) -> dict[str, Any]:
    """Say where the outputs were, of the joint; loads, at the motor, are the draws' median's."""
    chain, middle = fit.chain, np.median(values, axis=0)
    motion = [
        (o.q[at], o.speed, o.acceleration, load_at_outputs(chain, o, middle))
        for o in fit.observations
        for at in (o.filter.centres,)
    ]
    q, qd, qdd, load = (np.concatenate(x) for x in zip(*motion, strict=True))
    reach = float(load_reach(chain, middle[None], open_scale=open_scale)[0])
    # a joint without a load may still be asked for one
    largest = max(float(np.abs(o.measured).max()) for o in fit.observations) * chain.ratio
    return {
        "speed": _ends(qd),
        "slowest": float(np.abs(qd).min()),
        "position": _ends(q),
        "acceleration": _ends(qdd),
        "load": _ends(reach * load),
        "outside": float(np.abs(load).max()) or largest,  # load at the joint worth trying
        "typical": _typical(q, qd, qdd),
    }


def _typical(q: Array, qd: Array, qdd: Array) -> list[float]:
    """Give a median position and speed, hardly accelerated: there the data were."""
    one_way = qd[qd > 0.0] if (qd > 0.0).any() else qd
    least = min(max(float(qdd.min()), 0.0), float(qdd.max()))
    return [float(f"{x:.3g}") for x in (np.median(q), np.median(one_way), least)]


def _ends(x: Array) -> list[float]:
    return [float(x.min()), float(x.max())]
