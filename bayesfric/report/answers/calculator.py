"""The law of a fitted joint, with a few hundred draws, for a page that works out torques.

Elements pass torque on as :mod:`bayesfric.mechanism.kernels` says; what each term adds is written
down from its row in the table of quantities.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.errors import BadInput
from bayesfric.estimates.assemble import open_scalings
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.torque import load_at_outputs
from bayesfric.inference.fitting import Fit
from bayesfric.mechanism.inverse import load_reach
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import Parameter
from bayesfric.mechanism.quantities import (
    CHOICES,
    CYCLE_PHRASES,
    CYCLES,
    LOAD_CHOICES,
    SHAPES,
)
from bayesfric.opened import read_json
from bayesfric.recordings.arrays import Array
from bayesfric.report.answers.formula import Formula, Unwritten, formula_of, mentions
from bayesfric.report.summary.derived_quantities import LEVEL

FILE = "page.json"
# Of a few hundred draws; anything larger is some other file.
_LARGEST = 2_000_000
# Ends of a 90 % band of so many draws are known to a tenth of its width.
_DRAWS = 300
# Of a draw; far finer than draws differ, and a third of the bytes.
_DIGITS = 7
# Slots of the kernels that the page's script knows by name, of an element and of the whole.
ELEMENT_FORMS = frozenset(
    (
        "stribeck_ratio", "stribeck_load_ratio", "stribeck_velocity", "stribeck_exponent",
        "load_drive", "load_back", "load_drive_difference", "load_back_difference", "load_speed",
        "load_square",
    )
)  # fmt: skip
LOAD_FORMS = frozenset(("gravity_angle", "gain"))
# What may be chosen besides speed and load, where a term depends on one of these.
_INPUTS: Mapping[str, tuple[str, ...]] = {
    "position": ("position", "gravity"),
    "acceleration": ("acceleration",),
}
Calculator = dict[str, Any]  # what the page's script works with, see `written`
# What the load itself needs, as :func:`bayesfric.mechanism.inverse.load_torque` has it.
_WEIGHT = ("inertia", "first_moment")


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

    ``values`` has a column of draws for each of ``names``, or a number where it does not vary;
    ``elements`` have their ratio, their input's speed over the joint's (``reach``) and parameters
    by slot; ``terms`` are told in ``groups``. ``open_scale`` is whether the scale between load and
    load losses is open; ``begins`` whether there are terms of temperature or time, which are those
    of 20 degC and of a beginning; ``scaled`` whether ``drive.gain`` is the torque's factor. Where
    the law has a term that cannot be written down, ``missing`` names it, and nothing else is there.
    """
    try:
        law = _Law(chain)
    except Unwritten as error:
        return {"missing": str(error)}
    return {
        "missing": "",
        "level": LEVEL,
        "names": list(chain.names),
        "values": [float(x[0]) if np.ptp(x) == 0.0 else x.tolist() for x in values.T],
        "elements": law.elements,
        "gravity": chain.load.gravity,
        "load_forms": law.load_forms,
        "terms": law.terms,
        "groups": law.groups,
        "inputs": [name for name, fields in _INPUTS.items() if law.mentions(fields)],
        "lossy": any(element.load_loss != "none" for element in chain.elements),
        "open_scale": open_scale,
        "own_offsets": bool(chain.own_offsets),
        "begins": law.begins,
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
        return found if found["missing"] or found["seen"] else None
    except (BadInput, ValueError, KeyError, TypeError):
        return None


class _Law:
    """Elements, terms and groups of a joint."""

    def __init__(self, chain: Joint) -> None:
        self.chain = chain
        self.elements: list[dict[str, Any]] = [
            {"ratio": e.ratio, "reach": chain.reaches[e.name], "forms": {}} for e in chain.elements
        ]
        self.load_forms: dict[str, int] = {}
        self.terms: list[dict[str, Any]] = []
        self.groups: list[dict[str, Any]] = []
        self.begins = False
        self._keys: list[str] = []
        places = {e.name: k for k, e in enumerate(chain.elements)}
        places |= {"load": len(places), "": len(places) + 1, "drive": len(places) + 1}
        for index, p in enumerate(chain.parameters):
            self._put(index, p, places[p.owner])

    def mentions(self, fields: tuple[str, ...]) -> bool:
        """Tell whether a term depends on one of some fields of a state."""
        return any(mentions(term["formula"], fields) for term in self.terms)

    def _put(self, index: int, p: Parameter, place: int) -> None:
        row = p.row
        if row.signal:  # at 20 degC, and at rest as far as torque changes, there is none of it
            self.begins = self.begins or row.signal == "temperature"
            return
        if p.quantity == "offset" and self.chain.own_offsets:
            return  # whose it is, only the recording says
        if p.quantity in SHAPES:
            return
        if row.role != "own":
            at_element = place < len(self.elements)
            forms = self.elements[place]["forms"] if at_element else self.load_forms
            for slot in (p.quantity,) if row.slots is None else row.slots:
                if slot not in (ELEMENT_FORMS if at_element else LOAD_FORMS):
                    raise Unwritten(p.name)
                forms[slot] = index
            return
        formula: Formula = 1.0
        if p.quantity != "offset":
            assert row.column is not None
            try:
                formula = formula_of(row.column, shaped=bool(row.shape))
            except Unwritten:
                raise Unwritten(p.name) from None
        self.begins = self.begins or mentions(formula, ("time",))
        shape = self.chain.names.index(f"{p.owner}.{row.shape}") if row.shape else -1
        self.terms.append(
            {
                # of its element; the load is the number of elements, and one more what is on top
                "place": place,
                "parameter": index,
                "shape": shape,  # index of the parameter that shapes it, or -1
                "rises": row.rises,  # whether the rise at low speed multiplies it
                "group": self._group(p, loss=mentions(formula, ("speed", "direction"))),
                "formula": formula,
                # whether it is of the load torque that `seen` tells the range of
                "weight": p.owner == "load" and p.quantity in _WEIGHT,
            }
        )

    def _group(self, p: Parameter, *, loss: bool) -> int:
        """Find the group of a term, all elements together, or begin it."""
        option = p.row.option
        key = option or p.name
        if key not in self._keys:
            self._keys.append(key)
            self.groups.append({"words": _words(p), "loss": loss})
        return self._keys.index(key)


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
    """Pick the output next to a median angle and speed, hardly accelerated: there the data were."""
    middle = np.median(q), np.median(np.abs(qd)), 0.0
    apart = [
        ((x - at) / (np.ptp(x) or 1.0)) ** 2 for x, at in zip((q, qd, qdd), middle, strict=True)
    ]
    at = int(np.argmin(np.sum(apart, axis=0)))
    return [_plain(x, at) for x in (q, qd, qdd)]


def _plain(x: Array, at: int) -> float:
    """Round a number to three digits, if that is still among all of them."""
    short = float(f"{x[at]:.3g}")
    return short if x.min() <= short <= x.max() else float(x[at])


def _ends(x: Array) -> list[float]:
    return [float(x.min()), float(x.max())]
