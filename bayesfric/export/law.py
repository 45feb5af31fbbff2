"""The whole law of a joint as statements of C or Python: the inverse model, written out.

From the load to the motor each element adds what the compiled kernels add: see
:class:`bayesfric.mechanism.element.Element`. What is zero is not written.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from bayesfric.errors import BadInput
from bayesfric.export.at_joint import Array
from bayesfric.export.carried import left_out
from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint

Language = Literal["python", "double", "float", "fixed"]


@dataclass(frozen=True)
class Words:
    """How a language writes sums and products; ``functions`` are names other than C's."""

    number: Callable[[float], str]
    functions: Mapping[str, str]

    def call(self, name: str, *arguments: str) -> str:
        """Write a call."""
        return f"{self.functions.get(name, name)}({', '.join(arguments)})"

    def add(self, *terms: str) -> str:
        """Write a sum."""
        return " + ".join(terms)

    def times(self, *factors: str) -> str:
        """Write a product of variables."""
        return " * ".join(f"({x})" if " + " in x else x for x in factors)

    def scaled(self, constant: float, x: str) -> str:
        """Write a constant times a variable."""
        return self.times(self.number(constant), x)

    def either(self, sign: str, positive: str, negative: str) -> str:
        """Write a choice by the sign of a variable."""
        return self.call("pick", f"{sign} > 0", positive, negative)

    def negative(self, x: str) -> str:
        """Write the negative of a product."""
        return f"-{x}"


class _Fixed(Words):
    """Numbers of 32 bits before and 32 behind the point; constants of 31 bits and a power of 2."""

    def add(self, *terms: str) -> str:
        whole = terms[0]
        for term in terms[1:]:
            whole = f"fx_add({whole}, {term})"
        return whole

    def times(self, *factors: str) -> str:
        whole = factors[0]
        for factor in factors[1:]:
            whole = f"fx_mul({whole}, {factor})"
        return whole

    def scaled(self, constant: float, x: str) -> str:
        if constant == 0.0:
            return self.number(0.0)
        mantissa, power = math.frexp(constant)
        return f"fx_scale({x}, INT32_C({round(mantissa * 2**30)}), {30 - power})"


def _q32(x: float) -> str:
    return f"INT64_C({round(x * 2**32)})"


_C = ("fabs", "exp", "pow", "sin", "cos")
_WORDS: Mapping[str, Words] = {
    "double": Words(repr, {}),
    "float": Words(lambda x: f"{x!r}f", {"pick": "pick_f", **{x: f"{x}f" for x in _C}}),
    "python": Words(
        repr, {"fabs": "abs", **{name: f"math.{name}" for name in ("exp", "pow", "sin", "cos")}}
    ),
    "fixed": _Fixed(_q32, {name: f"fx_{name}" for name in (*_C, "pick")}),
}


@dataclass(frozen=True)
class Statement:
    """One assignment, or a remark where it has no name."""

    name: str
    value: str


@dataclass(frozen=True)
class Law:
    """Statements that work out ``torque`` and ``ideal`` from ``q``, ``v``, ``a`` and ``s``.

    ``ideal`` is the torque without losses and cogging: inertia, gravity, springs and the offset,
    which alone is ``offset``. ``s`` is the direction, a number from -1 to 1, and ``d`` its sign.
    """

    statements: tuple[Statement, ...]
    offset: str = "0.0"  # as it is measured, in the language's own words

    @property
    def names(self) -> tuple[str, ...]:
        """What is assigned, each once."""
        return tuple(dict.fromkeys(one.name for one in self.statements if one.name))

    @property
    def words(self) -> frozenset[str]:
        """Every word of it, to know which functions it needs."""
        return frozenset(re.findall(r"\w+", " ".join(one.value for one in self.statements)))


class _Writer:
    """Writes a joint out at one parameter vector."""

    def __init__(self, chain: Joint, vector: Array, words: Words) -> None:
        self.chain, self.vector, self.words = chain, vector, words
        self.tables = chain.tables(vector[None])
        self.out: list[Statement] = []
        self.risen = False  # whether the element's losses rise at low speed

    def put(self, name: str, value: str) -> None:
        self.out.append(Statement(name, value))

    def grow(self, name: str, *terms: str) -> None:
        if terms:
            self.put(name, self.words.add(name, *terms))

    def load(self) -> None:
        w, load = self.words, self.tables.load[0].tolist()
        angle, inertia = load[kernels.GRAVITY_ANGLE], load[kernels.LOAD_INERTIA]
        weight = load[kernels.GRAVITY] * load[kernels.FIRST_MOMENT]
        self.put("", "load")
        parts = [w.scaled(inertia, "a")] if inertia else []
        if weight:
            place = w.add("q", w.number(angle)) if angle else "q"
            parts.append(w.scaled(weight, w.call("sin", place)))
        self.put("torque", w.add(*parts) if parts else w.number(0.0))
        self.put("ideal", "torque")
        self.put("x", "q")
        self.put("w", "v")
        self.carried(len(self.chain.elements))

    def element(self, k: int) -> None:
        w, element = self.words, self.chain.elements[k]
        at = dict(zip(kernels.ELEMENT_SLOTS, self.tables.elements[0, k].tolist(), strict=True))
        reach = self.chain.reaches[element.name]
        self.put("", element.name)
        self.put("x", w.scaled(reach, "q"))
        self.put("w", w.scaled(reach, "v"))
        if at["ratio"] != 1.0:
            for name in ("torque", "ideal"):
                self.put(name, w.scaled(1.0 / at["ratio"], name))
        self.rise(at)
        self.loss(at)
        terms = [w.scaled(at["inertia"] * reach, "a")] if at["inertia"] else []
        self.grow("ideal", *terms)
        terms.append(w.times("s", "loss"))
        if at["viscous"]:
            terms.append(w.scaled(at["viscous"], "w"))
        if at["quadratic"]:
            terms.append(w.scaled(at["quadratic"], w.times("w", w.call("fabs", "w"))))
        self.grow("torque", *terms)
        self.carried(k)

    def rise(self, at: Mapping[str, float]) -> None:
        """Work out the rises at low speed, if there are any."""
        w = self.words
        self.risen = bool(at["stribeck_ratio"] or at["stribeck_load_ratio"])
        if not self.risen:
            return
        if at["stribeck_velocity"] > 0.0:
            self.put("u", w.scaled(1.0 / at["stribeck_velocity"], w.call("fabs", "w")))
            square = at["stribeck_exponent"] == 2.0
            exponent = w.number(at["stribeck_exponent"])
            self.put("u", w.times("u", "u") if square else w.call("pow", "u", exponent))
            self.put("share", w.call("exp", "-u"))
        else:
            self.put("share", w.number(0.0))
        for name in ("", "load_"):
            grown = w.scaled(at[f"stribeck_{name}ratio"], "share")
            self.put(f"{name}rise", w.add(w.number(1.0), grown))

    def raised(self, constant: float, rise: str) -> str:
        """Write a constant times a rise, where there is one."""
        return self.words.scaled(constant, rise) if self.risen else self.words.number(constant)

    def loss(self, at: Mapping[str, float]) -> None:
        w = self.words
        sides = [self.raised(at[f"coulomb_{side}"], "rise") for side in ("positive", "negative")]
        self.put("loss", sides[0] if sides[0] == sides[1] else w.either("d", *sides))
        first = kernels.ELEMENT_SLOTS.index("load_drive")
        loaded = [at[x] for x in kernels.ELEMENT_SLOTS[first:] if x != "load_square"]
        if any(loaded):
            for side in ("drive", "back"):
                apart = at[f"load_{side}_difference"]
                self.put(side, self.raised(at[f"load_{side}"], "load_rise"))
                if apart:
                    self.grow(side, w.times(self.raised(apart, "load_rise"), "d"))
                if at["load_speed"]:
                    self.grow(side, w.scaled(at["load_speed"], w.call("fabs", "w")))
            self.put("p", w.times("torque", "d"))
            driving, driven = w.times("drive", "p"), w.negative(w.times("back", "p"))
            self.grow("loss", w.either("p", driving, driven))
        if at["load_square"]:
            self.grow("loss", w.scaled(at["load_square"], w.times("torque", "torque")))

    def carried(self, place: int) -> None:
        """Write the terms of an element, or the load, that have no slot in the kernels."""
        w = self.words
        for term in self.chain.carried:
            if term.place != place or left_out(term.row):
                continue
            value, name = float(self.vector[term.index]), term.row.name
            kind, _, cycles = name.rpartition("_")
            if name in ("spring", "spring_cubic"):
                power = ("x",) if name == "spring" else ("x", "x", "x")
                self.grow("torque", w.scaled(value, w.times(*power)))
                self.grow("ideal", w.scaled(value, w.times(*power)))
            elif name in ("viscous_positive", "viscous_negative"):
                speeds = (
                    ("w", w.number(0.0)) if name == "viscous_positive" else (w.number(0.0), "w")
                )
                self.grow("torque", w.scaled(value, w.either("w", *speeds)))
            elif name == "power":
                exponent = w.number(float(self.vector[term.shape]))
                grown = w.call("pow", w.call("fabs", "w"), exponent)
                self.grow("torque", w.scaled(value, w.times("s", grown)))
            elif kind in ("cogging_sin", "cogging_cos"):
                wave = w.call(kind[-3:], w.scaled(float(cycles), "x"))
                self.grow("torque", w.scaled(value, wave))
            elif kind in ("periodic_friction_sin", "periodic_friction_cos"):
                wave = w.call(kind[-3:], w.scaled(float(cycles), "x"))
                self.grow("torque", w.scaled(value, w.times("s", wave)))

    def measured(self) -> None:
        w, load = self.words, self.tables.load[0].tolist()
        self.put("", "as measured")
        if load[kernels.OFFSET]:
            for name in ("torque", "ideal"):
                self.grow(name, w.number(load[kernels.OFFSET]))
        if load[kernels.GAIN] != 1.0:
            for name in ("torque", "ideal"):
                self.put(name, w.scaled(1.0 / load[kernels.GAIN], name))


# Terms without a slot in the kernels that are written out, without their number of cycles.
_CARRIED = frozenset(
    (
        "spring", "spring_cubic", "viscous_positive", "viscous_negative", "power", "cogging_sin",
        "cogging_cos", "periodic_friction_sin", "periodic_friction_cos",
    )
)  # fmt: skip


def unwritten(chain: Joint) -> str | None:
    """Name a term of a joint that cannot be written out; ``None`` where there is none."""
    for term in chain.carried:
        known = {term.row.name, term.row.name.rpartition("_")[0]} & _CARRIED
        if not known and not left_out(term.row):
            return chain.names[term.index]
    return None


def law(chain: Joint, vector: Array, language: Language) -> Law:
    """Write a joint out at one parameter vector ``(d,)``.

    Raises
    ------
    BadInput
        If it has a term of one's own, a function that is not known here.
    """
    if (name := unwritten(chain)) is not None:
        what = "is a term of one's own, whose formula the export does not know"
        raise BadInput(name, what, "export another format, or leave the term out")
    writer = _Writer(chain, vector, _WORDS[language])
    writer.load()
    for k in range(len(chain.elements) - 1, -1, -1):
        writer.element(k)
    writer.measured()
    load = writer.tables.load[0].tolist()
    offset = load[kernels.OFFSET] / load[kernels.GAIN]
    return Law(tuple(_used(writer.out)), writer.words.number(offset))


def _used(statements: list[Statement]) -> list[Statement]:
    """Leave out assignments that nothing reads: compilers warn of them."""
    read, kept = {"torque", "ideal"}, []
    for one in reversed(statements):
        if not one.name:
            kept.append(one)
        elif one.name in read:
            read.discard(one.name)
            read |= set(re.findall(r"[a-z_]\w*", one.value))
            kept.append(one)
    return kept[::-1]
