"""Which parameters a joint has from motor to load, and how the compiled kernels read them.

A :class:`Chain` names its parameters (``element.quantity``), orders them, and lays parameter
vectors (:class:`Tables`) and motions (:class:`bayesfric.mechanism.kernels.Samples`) out as arrays.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from bayesfric.base.errors import nearest
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.kernels import ELEMENT_SLOTS, LOAD_SLOTS, Samples
from bayesfric.mechanism.own_term import PUSH, CarriedTerm, Term, along
from bayesfric.mechanism.parameter import Parameter, parameter
from bayesfric.mechanism.quantities import LATE_TARGET, QUANTITIES, SHAPES, Motion
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Inputs

# Owners of parameters that no element may be called.
_RESERVED = ("load", "drive", "target", "total")


class Tables(NamedTuple):
    """Parameter vectors laid out for the compiled kernels."""

    elements: Array  # (n, n_elements, n_slots) of ELEMENT_SLOTS, elements from motor to load
    load: Array  # (n, n_slots) of LOAD_SLOTS
    # (n, n_carried, 2) of the terms without a slot, see Chain.carried_terms: coefficient, and value
    # of the parameter that shapes the term (0 where none does)
    carried: Array


@dataclass(frozen=True)
class Chain:
    """Motor to load, any number of elements (section 2.2 of the paper).

    A torque goes from the load to the motor element by element: with ``N_k`` the ratio of element
    ``k``, its input moves ``N_k`` times as fast as its output and takes ``1/N_k`` of the torque
    there, plus its own inertia and losses (:class:`bayesfric.mechanism.element.Element`). The
    measured torque is ``(torque at the motor + offset) / gain``.
    """

    elements: Sequence[Element]  # from the motor to the load; names differ
    load: Load = field(default_factory=Load)  # what the last element moves
    offset: bool = False  # whether the measured motor torque holds an unknown constant
    own_offsets: tuple[str, ...] = ()  # recordings with separate offsets, offset.<recording>
    gain: bool = False  # whether true over computed motor torque is unknown (drive.gain)
    delay: bool | None = None  # whether the position's delay is unknown (drive.delay)
    by_target: bool = False  # torque from a position target, whose delay it is (target.delay)
    made_from: str = ""  # name of the preset
    terms: tuple[Term, ...] = ()  # custom terms; see with_term

    def __post_init__(self) -> None:
        object.__setattr__(self, "elements", tuple(self.elements))
        names = [element.name for element in self.elements]
        if not names:
            raise ValueError("a chain needs at least one element")
        if len(set(names)) < len(names) or {*_RESERVED, ""} & set(names):
            raise ValueError(
                "element names must differ and must not be empty or one of " + ", ".join(_RESERVED)
            )
        for element in self.elements:
            if not (np.isfinite(element.ratio) and element.ratio > 0):
                raise ValueError(f"{element.name}.ratio must be a positive number")
        owners = [*names, self.load.name]
        for term in self.terms:
            if term.owner not in owners:
                hint = nearest(term.owner, owners)
                raise ValueError(f"{term.name}: there is no element {term.owner!r}; {hint}")
        _ = self._layout  # refuses unknown quantities

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters, motor first, then load, offsets, ``drive.gain`` and the delay."""
        # the paper writes mu_1, mu_2 of its only gearbox without a subscript
        several = sum(element.load_loss != "none" for element in self.elements) > 1
        parameters: list[Parameter] = []
        bearers: list[Element | Load] = [*self.elements, self.load]
        held = Counter(q.name for bearer in bearers for q in bearer.quantities)
        for bearer in bearers:
            subscript = bearer.subscript or bearer.name
            custom = tuple(term.row for term in self.terms if term.owner == bearer.name)
            for q in (*bearer.quantities, *custom):
                mark = "" if q.role == "loss" and not several else subscript
                alone = held[q.name] == 1
                parameters.append(parameter(bearer.name, q, bearer.motion, mark, alone=alone))
        offset = parameter("", QUANTITIES["offset"], self.motor_motion, "")
        if self.offset and not self.own_offsets:
            parameters.append(offset)
        for number, recording in enumerate(self.own_offsets, start=1):
            symbol = rf"\Gamma_{{0,{number}}}"
            parameters.append(replace(offset, name=f"offset.{recording}", symbol=symbol))
        if self.gain:
            parameters.append(parameter("drive", QUANTITIES["gain"], self.motor_motion, ""))
        if self.delay:
            row = LATE_TARGET if self.by_target else QUANTITIES["delay"]
            late = parameter("drive", row, self.motor_motion, "")
            parameters.append(replace(late, name="target.delay") if self.by_target else late)
        return tuple(parameters)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Parameter names in the order of :attr:`parameters`."""
        return tuple(p.name for p in self.parameters)

    @cached_property
    def offset_names(self) -> tuple[str, ...]:
        """Names of the constants in the measured torque: one for all, or one per recording."""
        return tuple(p.name for p in self.parameters if p.quantity == "offset")

    @cached_property
    def delay_name(self) -> str:
        """Name of the delay of position or target; empty where the joint has none."""
        return next((p.name for p in self.parameters if p.quantity == "delay"), "")

    def delays(self, values: Array) -> Array:
        """Return the delay ``(n,)`` of parameter vectors ``(n, n_parameters)``, s; 0 without."""
        name = self.delay_name
        return values[:, self.names.index(name)] if name else np.zeros(len(values))

    @property
    def motor_motion(self) -> Motion:
        """Whether the motor turns or slides, which sets the unit of its torque (N m or N)."""
        return self.elements[0].motion

    @cached_property
    def ratio(self) -> float:
        """Motor speed over joint speed, ``N`` of eq. (6): the product of all ratios."""
        return float(np.prod([element.ratio for element in self.elements]))

    @cached_property
    def reaches(self) -> dict[str, float]:
        """Speed over the joint's, of every element's input and of ``load``; by owner's name.

        What the whole chain has, by its empty name and ``drive``, is at the motor.
        """
        reaches, reach = {"load": 1.0}, 1.0
        for element in reversed(self.elements):
            reach *= element.ratio
            reaches[element.name] = reach
        return {**reaches, "": self.ratio, "drive": self.ratio}

    @cached_property
    def carried(self) -> tuple[CarriedTerm, ...]:
        """Terms that the kernels do not write out, in the order of :attr:`parameters`.

        They are those of the table without slots (such as viscous friction by direction,
        temperature, warming up, a power of speed, springs, cogging, delay) and :attr:`terms`.
        """
        places = {e.name: k for k, e in enumerate(self.elements)}
        places |= {"load": len(self.elements), "drive": len(self.elements) + 1}
        return tuple(
            CarriedTerm(
                i,
                places[p.owner],
                self.reaches[p.owner],
                p.row,
                self.names.index(f"{p.owner}.{p.row.shape}") if p.row.shape else -1,
            )
            for i, p in enumerate(self.parameters)
            if p.owner in places and p.row.role == "own" and not slots_of(p)
        )

    def carried_terms(self, inputs: Inputs | None) -> tuple[CarriedTerm, ...]:
        """Return :attr:`carried`, followed by the load torque of a recording that has one."""
        if inputs is None or inputs.load_torque is None:
            return self.carried
        return (*self.carried, CarriedTerm(-1, len(self.elements), 1.0, PUSH))

    @property
    def unseen_inertia(self) -> tuple[str, ...]:
        """Names of the inertias where all are before load-dependent friction; else empty.

        An element's inertia is before its friction.
        """
        lossy = [k for k, e in enumerate(self.elements) if e.load_loss != "none"]
        if not lossy or self.load.has("inertia"):
            return ()
        held = [k for k, e in enumerate(self.elements) if e.has("inertia")]
        if any(k > lossy[-1] for k in held):
            return ()
        return tuple(f"{self.elements[k].name}.inertia" for k in held)

    def with_term(self, term: Term) -> Self:
        """Add a custom term to an element or the load, replacing one of the same name."""
        others = tuple(other for other in self.terms if other.name != term.name)
        return replace(self, terms=(*others, term))

    def vector(self, values: Mapping[str, ArrayLike]) -> Array:
        """Put named numbers, or draws ``(n,)``, in the order of :attr:`names`: ``(n, d)``."""
        # draws of a posterior also hold those of the noise
        unknown = {name for name in values if not name.startswith("noise.")} - set(self.names)
        missing = set(self.names) - set(values)
        if unknown or missing:
            raise KeyError(f"unknown: {sorted(unknown)}, missing: {sorted(missing)}")
        return np.array([values[name] for name in self.names], dtype=np.float64).T

    def tables(self, values: Array, inputs: Inputs | None = None) -> Tables:
        """Lay parameter vectors ``(n, d)`` out for the kernels, with a recording's offset."""
        defaults, sources, targets = self._layout
        flat = np.tile(defaults.astype(values.dtype), (values.shape[0], 1))
        flat[:, targets] = values[:, sources]
        if inputs is not None and inputs.recording in self.own_offsets:
            column = self.names.index(f"offset.{inputs.recording}")
            flat[:, LOAD_SLOTS.index("offset") - len(LOAD_SLOTS)] = values[:, column]
        split = len(self.elements) * len(ELEMENT_SLOTS)
        elements = flat[:, :split].reshape(-1, len(self.elements), len(ELEMENT_SLOTS))
        terms = self.carried_terms(inputs)
        carried = np.zeros((len(values), len(terms), 2), values.dtype)
        for k, term in enumerate(terms):
            carried[:, k, 0] = values[:, term.index] if term.index >= 0 else 1.0
            if term.shape >= 0:
                carried[:, k, 1] = values[:, term.shape]
        return Tables(
            np.ascontiguousarray(elements), np.ascontiguousarray(flat[:, split:]), carried
        )

    def samples(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        inputs: Inputs,
        time: Array | None = None,
    ) -> Samples:
        """Lay a motion ``(N,)`` of the joint out for the kernels; terms of time are NaN without."""
        position, speed, acceleration = (
            np.ascontiguousarray(x, dtype=np.float64) for x in (q, qd, qdd)
        )
        stamps = np.full(speed.size, np.nan) if time is None else time
        terms = self.carried_terms(inputs)
        # the kernels compute columns that a parameter shapes
        columns = [
            along(c.row, c.reach, position, speed, stamps, inputs)
            if c.shape < 0
            else np.zeros_like(speed)
            for c in terms
        ]
        return Samples(
            *inputs.load(self.load.motion),
            np.sin(position),
            np.cos(position),
            speed,
            acceleration,
            position,
            np.ascontiguousarray(stamps, dtype=np.float64),
            np.stack(columns) if columns else np.empty((0, speed.size)),
            np.array([c.place for c in terms], dtype=np.int64),
            np.array([c.reach for c in terms], dtype=np.float64),
            np.array([c.address if c.shape >= 0 else 0 for c in terms], dtype=np.int64),
        )

    @cached_property
    def _layout(self) -> tuple[Array, Sequence[int], Sequence[int]]:
        """Default values ``(n_slots,)`` of all slots, and pairs of parameter and slot index.

        :meth:`tables` puts in a recording's separate offset.
        """
        slots = [f"{e.name}.{slot}" for e in self.elements for slot in ELEMENT_SLOTS]
        slots += [f"load.{slot}" for slot in LOAD_SLOTS]
        where = {slot: i for i, slot in enumerate(slots)}
        defaults = np.zeros(len(slots))
        for element in self.elements:
            defaults[where[f"{element.name}.ratio"]] = element.ratio
            for slot in ELEMENT_SLOTS:
                if slot in QUANTITIES:
                    defaults[where[f"{element.name}.{slot}"]] = QUANTITIES[slot].default
        defaults[where["load.gravity"]] = self.load.gravity
        defaults[where["load.gain"]] = 1.0

        sources: list[int] = []
        targets: list[int] = []
        for source, p in enumerate(self.parameters):
            if p.quantity == "offset" and self.own_offsets:
                continue  # depends on the recording
            for slot in slots_of(p):
                sources.append(source)
                targets.append(where[f"{_bearer(p)}.{slot}"])
        return defaults, sources, targets


def _bearer(p: Parameter) -> str:
    return "load" if p.owner in ("", "drive") else p.owner


def slots_of(p: Parameter) -> tuple[str, ...]:
    """List the kernel slots that a parameter fills; none for a term with a column."""
    known = LOAD_SLOTS if _bearer(p) == "load" else ELEMENT_SLOTS
    slots = (p.quantity,) if p.row.slots is None else p.row.slots
    if slots and set(slots) <= set(known):
        return slots
    if p.quantity in SHAPES:
        return ()
    if p.row.role != "own" or (p.row.column is None and not p.row.signal):
        raise KeyError(f"{p.name}: neither the kernels nor a column know {p.quantity!r}")
    return ()
