"""The whole law of a joint as statements of C or Python: the inverse model, written out.

From the load to the motor each element adds what the compiled kernels add: see
:class:`bayesfric.mechanism.element.Element`. What is zero is not written.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from bayesfric.errors import BadInput
from bayesfric.export.at_joint import Array
from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.own_term import CarriedTerm

Language = Literal["python", "double", "float"]


@dataclass(frozen=True)
class _Words:
    """How a language writes numbers and functions."""

    number: Callable[[float], str]
    functions: Mapping[str, str]

    def call(self, name: str, *arguments: str) -> str:
        """Write a call."""
        return f"{self.functions.get(name, name)}({', '.join(arguments)})"


_C = ("fabs", "exp", "pow", "sin", "cos")
_WORDS: Mapping[str, _Words] = {
    "double": _Words(repr, {}),
    "float": _Words(lambda x: f"{x!r}f", {name: f"{name}f" for name in _C}),
    "python": _Words(
        repr, {"fabs": "abs", **{name: f"math.{name}" for name in ("exp", "pow", "sin", "cos")}}
    ),
}


@dataclass(frozen=True)
class Statement:
    """One assignment, or a remark where it has no name."""

    name: str
    value: str


@dataclass(frozen=True)
class Law:
    """Statements that work out ``torque`` and ``ideal`` from ``q``, ``v``, ``a`` and ``s``.

    ``ideal`` is the torque without losses, cogging and offset: inertia, gravity and springs. ``s``
    is the direction, a number from -1 to 1, and ``d`` its sign.
    """

    statements: tuple[Statement, ...]
    names: tuple[str, ...]  # of what is assigned, each once

    @property
    def assignments(self) -> tuple[Statement, ...]:
        """Statements without remarks."""
        return tuple(one for one in self.statements if one.name)


# Terms that the kernels do not write out, ``x`` and ``w`` position and speed of their element;
# those that a temperature or the time multiplies are left out: at 20 degC, as a recording begins.
_OMITTED = ("temperature", "warming", "delay")


def omitted(term: CarriedTerm) -> bool:
    """Whether a term is none at 20 degC as a recording begins."""
    return any(word in term.row.name for word in _OMITTED)


def law(chain: Joint, vector: Array, language: Language) -> Law:
    """Write a joint out at one parameter vector ``(d,)``.

    Raises
    ------
    BadInput
        If it has a term of one's own, a function that is not known here.
    """
    words, tables = _WORDS[language], chain.tables(vector[None])
    n, call = words.number, words.call
    out: list[Statement] = []

    def put(name: str, value: str) -> None:
        out.append(Statement(name, value))

    load = tables.load[0].tolist()
    angle, weight = (
        load[kernels.GRAVITY_ANGLE],
        load[kernels.GRAVITY] * load[kernels.FIRST_MOMENT],
    )
    put("", "load")
    parts = [f"{n(load[kernels.LOAD_INERTIA])} * a"] if load[kernels.LOAD_INERTIA] else []
    if weight:
        parts.append(f"{n(weight)} * {call('sin', f'q + {n(angle)}' if angle else 'q')}")
    put("torque", " + ".join(parts) or n(0.0))
    put("ideal", "torque")
    put("x", "q")
    put("w", "v")
    for text, conserved in _carried(chain, vector, len(chain.elements), words):
        put("torque", f"torque + {text}")
        if conserved:
            put("ideal", f"ideal + {text}")
    for k in range(len(chain.elements) - 1, -1, -1):
        _element(chain, vector, k, tables.elements[0, k].tolist(), words, put)
    put("", "as measured")
    offset, gain = load[kernels.OFFSET], load[kernels.GAIN]
    if offset:
        put("torque", f"torque + {n(offset)}")
    if gain != 1.0:
        put("torque", f"torque / {n(gain)}")
        put("ideal", f"ideal / {n(gain)}")
    names = tuple(dict.fromkeys(one.name for one in out if one.name))
    return Law(tuple(out), names)


def _element(
    chain: Joint,
    vector: Array,
    k: int,
    row: Sequence[float],
    words: _Words,
    put: Callable[[str, str], None],
) -> None:
    n, call = words.number, words.call
    at = dict(zip(kernels.ELEMENT_SLOTS, row, strict=True))
    element = chain.elements[k]
    reach = chain.reaches[element.name]
    put("", element.name)
    put("x", f"{n(reach)} * q")
    put("w", f"{n(reach)} * v")
    if at["ratio"] != 1.0:
        put("torque", f"torque / {n(at['ratio'])}")
        put("ideal", f"ideal / {n(at['ratio'])}")
    rise, load_rise = "", ""
    if at["stribeck_ratio"] or at["stribeck_load_ratio"]:
        width, exponent = at["stribeck_velocity"], at["stribeck_exponent"]
        ratio = f"{call('fabs', 'w')} / {n(width)}"
        power = "u * u" if exponent == 2.0 else call("pow", "u", n(exponent))
        if width > 0.0:
            put("u", ratio)
            put("share", call("exp", f"-({power})"))
        else:
            put("share", n(0.0))
        rise = f" * ({n(1.0)} + {n(at['stribeck_ratio'])} * share)"
        load_rise = f" * ({n(1.0)} + {n(at['stribeck_load_ratio'])} * share)"
    put("loss", _either("d", at["coulomb_positive"], at["coulomb_negative"], words) + rise)
    if kernels_loaded(at):
        grown = f" + {n(at['load_speed'])} * {call('fabs', 'w')}" if at["load_speed"] else ""
        for side in ("drive", "back"):
            mu, apart = at[f"load_{side}"], at[f"load_{side}_difference"]
            whole = f"({n(mu)} + d * {n(apart)})" if apart else n(mu)
            put(side, whole + load_rise + grown)
        put("p", "torque * d")
        put("loss", f"loss + {call('pick', f'p > {n(0.0)}', 'drive * p', '-back * p')}")
    if at["load_square"]:
        put("loss", f"loss + {n(at['load_square'])} * torque * torque")
    viscous, quadratic = at["viscous"], at["quadratic"]
    speed = n(viscous) + (f" + {n(quadratic)} * {call('fabs', 'w')}" if quadratic else "")
    inertia = f"{n(at['inertia'] * reach)} * a"
    added = [f"{inertia}"] if at["inertia"] else []
    added += ["s * loss"] + ([f"w * ({speed})"] if viscous or quadratic else [])
    put("torque", " + ".join(["torque", *added]))
    if at["inertia"]:
        put("ideal", f"ideal + {inertia}")
    for text, _ in _carried(chain, vector, k, words):
        put("torque", f"torque + {text}")


def kernels_loaded(at: Mapping[str, float]) -> bool:
    """Whether an element loses in proportion to what it transmits."""
    first = kernels.ELEMENT_SLOTS.index("load_drive")
    return any(at[slot] for slot in kernels.ELEMENT_SLOTS[first:] if slot != "load_square")


def _either(sign: str, positive: float, negative: float, words: _Words) -> str:
    n = words.number
    if positive == negative:
        return n(positive)
    return words.call("pick", f"{sign} > {n(0.0)}", n(positive), n(negative))


def _carried(chain: Joint, vector: Array, place: int, words: _Words) -> list[tuple[str, bool]]:
    """Write the terms of an element, or the load, without a slot; and which conserve energy."""
    n, call = words.number, words.call
    found = []
    for term in chain.carried:
        if term.place != place or omitted(term):
            continue
        value, name = n(float(vector[term.index])), term.row.name
        kind, _, cycles = name.rpartition("_")
        if name == "spring":
            found.append((f"{value} * x", True))
        elif name == "spring_cubic":
            found.append((f"{value} * x * x * x", True))
        elif name == "power":
            power = call("pow", call("fabs", "w"), n(float(vector[term.shape])))
            found.append((f"{value} * s * {power}", False))
        elif kind in ("cogging_sin", "cogging_cos"):
            wave = call(kind[-3:], f"{n(float(cycles))} * x")
            found.append((f"{value} * {wave}", False))
        elif kind in ("periodic_friction_sin", "periodic_friction_cos"):
            wave = call(kind[-3:], f"{n(float(cycles))} * x")
            found.append((f"{value} * s * {wave}", False))
        else:
            parameter = chain.names[term.index]
            what = "is a term of one's own, whose formula the export does not know"
            raise BadInput(parameter, what, "export another format, or leave the term out")
    return found
