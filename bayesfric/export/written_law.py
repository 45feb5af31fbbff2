"""The whole law of a joint as statements of C or Python: the inverse model, written out.

From the load to the motor each element adds what the compiled kernels add: see
:class:`bayesfric.mechanism.element.Element`. What is zero is not written.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from bayesfric.errors import BadInput
from bayesfric.export.carried import left_out
from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array

Language = Literal["python", "double", "float"]


@dataclass(frozen=True)
class Law:
    """Statements ``(name, value)`` that work out ``torque`` and ``ideal``; a remark has no name.

    They start from ``q``, ``v``, ``a``, the direction ``s`` from -1 to 1 and its sign ``d``.
    ``ideal`` is the torque without losses and cogging: inertia, gravity, springs and the offset,
    which alone is ``offset``, as it is measured.
    """

    statements: tuple[tuple[str, str], ...]
    offset: str

    @property
    def names(self) -> tuple[str, ...]:
        """What is assigned, each once."""
        return tuple(dict.fromkeys(name for name, _ in self.statements if name))


class _Writer:
    """Writes a joint out at one parameter vector."""

    def __init__(self, chain: Joint, vector: Array, language: Language) -> None:
        self.chain, self.vector, self.language = chain, vector, language
        self.tables = chain.tables(vector[None])
        self.out: list[tuple[str, str]] = []
        self.risen = False  # whether the element's losses rise at low speed

    def number(self, x: float) -> str:
        return f"{x!r}f" if self.language == "float" else repr(x)

    def call(self, name: str, *arguments: str) -> str:
        """Call a function by its name in C."""
        if self.language == "python":
            name = "abs" if name == "fabs" else f"math.{name}"
        return f"{name}{'f' * (self.language == 'float')}({', '.join(arguments)})"

    def times(self, *factors: str) -> str:
        return " * ".join(f"({x})" if " + " in x else x for x in factors)

    def scaled(self, constant: float, x: str) -> str:
        return self.times(self.number(constant), x)

    def either(self, sign: str, positive: str, negative: str) -> str:
        """Choose by the sign of a variable."""
        if self.language == "python":
            return f"({positive} if {sign} > 0 else {negative})"
        return f"({sign} > 0 ? {positive} : {negative})"

    def put(self, name: str, *terms: str) -> None:
        self.out.append((name, " + ".join(terms)))

    def grow(self, name: str, *terms: str) -> None:
        if terms:
            self.put(name, name, *terms)

    def load(self) -> None:
        load = self.tables.load[0].tolist()
        angle, inertia = load[kernels.GRAVITY_ANGLE], load[kernels.LOAD_INERTIA]
        weight = load[kernels.GRAVITY] * load[kernels.FIRST_MOMENT]
        self.put("", "load")
        parts = [self.scaled(inertia, "a")] if inertia else []
        if weight:
            place = f"q + {self.number(angle)}" if angle else "q"
            parts.append(self.scaled(weight, self.call("sin", place)))
        self.put("torque", *(parts or [self.number(0.0)]))
        self.put("ideal", "torque")
        self.put("x", "q")
        self.put("w", "v")
        self.carried(len(self.chain.elements))

    def element(self, k: int) -> None:
        element = self.chain.elements[k]
        at = dict(zip(kernels.ELEMENT_SLOTS, self.tables.elements[0, k].tolist(), strict=True))
        reach = self.chain.reaches[element.name]
        self.put("", element.name)
        self.put("x", self.scaled(reach, "q"))
        self.put("w", self.scaled(reach, "v"))
        if at["ratio"] != 1.0:
            for name in ("torque", "ideal"):
                self.put(name, self.scaled(1.0 / at["ratio"], name))
        self.rise(at)
        self.loss(at)
        terms = [self.scaled(at["inertia"] * reach, "a")] if at["inertia"] else []
        self.grow("ideal", *terms)
        terms.append("s * loss")
        if at["viscous"]:
            terms.append(self.scaled(at["viscous"], "w"))
        if at["quadratic"]:
            terms.append(self.scaled(at["quadratic"], f"w * {self.call('fabs', 'w')}"))
        self.grow("torque", *terms)
        self.carried(k)

    def rise(self, at: Mapping[str, float]) -> None:
        """Work out the rises at low speed, if there are any."""
        self.risen = bool(at["stribeck_ratio"] or at["stribeck_load_ratio"])
        if not self.risen:
            return
        if at["stribeck_velocity"] > 0.0:
            self.put("u", self.scaled(1.0 / at["stribeck_velocity"], self.call("fabs", "w")))
            square = at["stribeck_exponent"] == 2.0
            exponent = self.number(at["stribeck_exponent"])
            self.put("u", "u * u" if square else self.call("pow", "u", exponent))
            self.put("share", self.call("exp", "-u"))
        else:
            self.put("share", self.number(0.0))
        for name in ("", "load_"):
            grown = self.scaled(at[f"stribeck_{name}ratio"], "share")
            self.put(f"{name}rise", self.number(1.0), grown)

    def raised(self, constant: float, rise: str) -> str:
        """Write a constant times a rise, where there is one."""
        return self.scaled(constant, rise) if self.risen else self.number(constant)

    def loss(self, at: Mapping[str, float]) -> None:
        sides = [self.raised(at[f"coulomb_{side}"], "rise") for side in ("positive", "negative")]
        self.put("loss", sides[0] if sides[0] == sides[1] else self.either("d", *sides))
        first = kernels.ELEMENT_SLOTS.index("load_drive")
        if any(at[x] for x in kernels.ELEMENT_SLOTS[first:] if x != "load_square"):
            for side in ("drive", "back"):
                self.put(side, self.raised(at[f"load_{side}"], "load_rise"))
                if apart := at[f"load_{side}_difference"]:
                    self.grow(side, self.times(self.raised(apart, "load_rise"), "d"))
                if at["load_speed"]:
                    self.grow(side, self.scaled(at["load_speed"], self.call("fabs", "w")))
            self.put("p", "torque * d")
            self.grow("loss", self.either("p", "drive * p", "-back * p"))
        if at["load_square"]:
            self.grow("loss", self.scaled(at["load_square"], "torque * torque"))

    def carried(self, place: int) -> None:
        """Write the terms of an element, or the load, that have no slot in the kernels."""
        zero = self.number(0.0)
        for term in self.chain.carried:
            if term.place != place or left_out(term.row):
                continue
            value, name = float(self.vector[term.index]), term.row.name
            kind, _, cycles = name.rpartition("_")
            if kind in _WAVES:
                what = self.call(kind[-3:], self.scaled(float(cycles), "x"))
            elif name == "power":
                exponent = self.number(float(self.vector[term.shape]))
                what = self.call("pow", self.call("fabs", "w"), exponent)
            elif kind == "viscous":
                what = self.either("w", *(("w", zero) if cycles == "positive" else (zero, "w")))
            else:
                what = "x" if name == "spring" else "x * x * x"
                self.grow("ideal", self.scaled(value, what))
            if name == "power" or kind.startswith("periodic"):
                what = f"s * {what}"
            self.grow("torque", self.scaled(value, what))

    def measured(self) -> None:
        load = self.tables.load[0].tolist()
        self.put("", "as measured")
        for name in ("torque", "ideal"):
            if load[kernels.OFFSET]:
                self.grow(name, self.number(load[kernels.OFFSET]))
            if load[kernels.GAIN] != 1.0:
                self.put(name, self.scaled(1.0 / load[kernels.GAIN], name))


# Terms without a slot in the kernels that are written out; of waves without the number of cycles.
_WAVES = {f"{kind}_{wave}" for kind in ("cogging", "periodic_friction") for wave in ("sin", "cos")}
_CARRIED = {"spring", "spring_cubic", "viscous_positive", "viscous_negative", "power", *_WAVES}


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
    writer = _Writer(chain, vector, language)
    writer.load()
    for k in range(len(chain.elements) - 1, -1, -1):
        writer.element(k)
    writer.measured()
    load = writer.tables.load[0].tolist()
    return Law(_used(writer.out), writer.number(load[kernels.OFFSET] / load[kernels.GAIN]))


def _used(statements: list[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    """Leave out assignments that nothing reads: compilers warn of them."""
    read, kept = {"torque", "ideal"}, []
    for name, value in reversed(statements):
        if name and name not in read:
            continue
        if name:
            read.discard(name)
            read |= set(re.findall(r"[a-z_]\w*", value))
        kept.append((name, value))
    return tuple(reversed(kept))
