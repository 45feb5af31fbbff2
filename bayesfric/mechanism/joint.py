"""A joint: its parameters from motor to load, and how the compiled kernels read them.

A :class:`Joint` names its parameters (``element.quantity``), orders them, and lays parameter
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

from bayesfric.base.errors import BadInput, nearest
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.kernels import (
    ELEMENT_SLOTS,
    FIRST_MOMENT,
    GAIN,
    LOAD_INERTIA,
    LOAD_SLOTS,
    OFFSET,
    VISCOUS,
    Samples,
    inverse_many,
)
from bayesfric.mechanism.own_term import PUSH, CarriedTerm, Term, along
from bayesfric.mechanism.quantities import (
    LATE_TARGET,
    QUANTITIES,
    SHAPES,
    Motion,
    Parameter,
    parameter,
)
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import ACCELERATION, AT_ROOM, Inputs


class Tables(NamedTuple):
    """Parameter vectors laid out for the compiled kernels."""

    elements: Array  # (n, n_elements, n_slots) of ELEMENT_SLOTS, elements from motor to load
    load: Array  # (n, n_slots) of LOAD_SLOTS
    # (n, n_carried, 2) of the terms without a slot, see Joint.carried_terms: coefficient, and value
    # of the parameter that shapes the term (0 where none does)
    carried: Array


@dataclass(frozen=True)
class Joint:
    """Motor to load, any number of elements (section 2.2 of the paper).

    A torque goes from the load to the motor element by element: with ``N_k`` the ratio of element
    ``k``, its input moves ``N_k`` times as fast as its output and takes ``1/N_k`` of the torque
    there, plus its own inertia and losses (:class:`bayesfric.Element`). The measured torque is
    ``(torque at the motor + offset) / gain``.

    Examples
    --------
    >>> joint = bayesfric.Joint.preset("rabbit-knee")
    >>> recording = bayesfric.simulate(joint, duration=10.0, seed=2)
    """

    elements: Sequence[Element]  # from the motor to the load; names differ
    load: Load = field(default_factory=Load)  # what the last element moves
    offset: bool = False  # whether the measured motor torque holds an unknown constant
    own_offsets: tuple[str, ...] = ()  # recordings with separate offsets, offset.<recording>
    gain: bool = False  # whether true over computed motor torque is unknown (drive.gain)
    # the gain that the law's torque was read with, where the drive's kp is unknown (drive.kp)
    kp: float | None = None
    kd: bool = False  # whether its gain for the speed is unknown (drive.kd)
    delay: bool | None = None  # whether the position's delay is unknown (drive.delay)
    by_target: bool = False  # torque from a position target, whose delay it is (target.delay)
    smoothness: bool = False  # whether a target's passage between samples is (target.smoothness)
    # whether torques of the load by further columns have columns of their inertia, too
    own_inertia: bool = False
    made_from: str = ""  # name of the preset
    terms: tuple[Term, ...] = ()  # custom terms; see with_term

    def __post_init__(self) -> None:
        object.__setattr__(self, "elements", tuple(self.elements))
        names = [element.name for element in self.elements]
        if not names:
            raise ValueError("a chain needs at least one element")
        reserved = ("load", "drive", "target", "total")  # owners of other parameters
        if len(set(names)) < len(names) or {*reserved, ""} & set(names):
            raise ValueError(
                "element names must differ and must not be empty or one of " + ", ".join(reserved)
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

    @staticmethod
    def preset(name: str) -> Joint:
        """Make the joint of that name, such as ``rabbit-knee``.

        Parameters
        ----------
        name
            Of :data:`PRESETS`.

        Raises
        ------
        BadInput
            If there is none.
        """
        if name not in PRESETS:
            raise BadInput("preset", f"there is no preset {name!r}", nearest(name, PRESETS))
        return PRESETS[name].chain()

    def __repr__(self) -> str:
        return "\n".join(f"{p.name} ({p.unit or '1'}): {p.meaning}" for p in self.parameters)

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
        motion = self.motor_motion
        offset = parameter("", QUANTITIES["offset"], motion, "")
        if self.own_offsets:
            parameters += [
                replace(offset, name=f"offset.{recording}", symbol=rf"\Gamma_{{0,{number}}}")
                for number, recording in enumerate(self.own_offsets, start=1)
            ]
        elif self.offset:
            parameters.append(offset)
        if self.gain:
            parameters.append(parameter("drive", QUANTITIES["gain"], motion, ""))
        parameters += [
            parameter("drive", QUANTITIES[name], motion, "")
            for name, unknown in (("kp", self.kp), ("kd", self.kd))
            if unknown
        ]
        if self.smoothness:
            shape = parameter("drive", QUANTITIES["smoothness"], motion, "")
            parameters.append(replace(shape, name="target.smoothness"))
        if self.delay and self.by_target:
            late = parameter("drive", LATE_TARGET, motion, "")
            parameters.append(replace(late, name="target.delay"))
        elif self.delay:
            parameters.append(parameter("drive", QUANTITIES["delay"], motion, ""))
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

    def smoothnesses(self, values: Array) -> Array:
        """Return how targets pass between samples ``(n,)``; 0, in a line, where it is known."""
        name = "target.smoothness"
        return values[:, self.names.index(name)] if self.smoothness else np.zeros(len(values))

    @property
    def closed_loop(self) -> bool:
        """Whether its motion can be predicted from targets alone, which stand for the torque.

        A torque of the load that is computed from the recorded motion would follow it, not move
        it, unless its part by the joint's own acceleration is known.
        """
        computed = any(q.signal for q in self.load.quantities)
        return self.by_target and (self.own_inertia or not computed)

    def drive_gains(self, values: Array) -> tuple[Array, Array]:
        """Return kp over the one the law was read with, and what kd comes on top of the law's.

        ``(n,)`` of parameter vectors ``(n, n_parameters)``; 1 and 0 where they are known.
        """
        factor, kd = np.ones(len(values)), np.zeros(len(values))
        if self.kp:
            factor = values[:, self.names.index("drive.kp")] / self.kp
        if self.kd:
            kd = values[:, self.names.index("drive.kd")]
        return factor, kd

    @property
    def motor_motion(self) -> Motion:
        """Whether the motor turns or slides."""
        return self.elements[0].motion

    @property
    def torque_unit(self) -> str:
        """Unit of the motor's torque: N m, or N of what slides."""
        return "N m" if self.motor_motion == "rotary" else "N"

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

    def load_columns(
        self, values: Array, inputs: Inputs, time: Array
    ) -> tuple[Array, Array, Inputs]:
        """Split torques of the load by further columns into inertia and torque without it.

        Returns coefficients ``(n, c)`` of vectors ``(n, n_parameters)``, inertia and torque
        ``(c, 2, N)`` at times ``(N,)``, and what is left of the inputs.
        """
        terms = [t for t in self.carried_terms(inputs) if inputs.inertia_of(t.row.signal)]
        weights, columns = np.ones((len(values), len(terms))), np.zeros((len(terms), 2, time.size))
        acceleration = inputs.signal(ACCELERATION)
        for c, term in enumerate(terms):
            inertia = inputs.inertia_of(term.row.signal)
            assert inertia is not None
            assert acceleration is not None
            if term.index >= 0:
                weights[:, c] = values[:, term.index]
            columns[c, 0] = inertia.at(time)
            columns[c, 1] = along(term.row, 1.0, time, 0.0 * time, time, inputs)
            columns[c, 1] -= columns[c, 0] * acceleration.at(time)
        split = {term.row.signal for term in terms}
        others = {name: x for name, x in inputs.others.items() if name not in split}
        pushed = None if "load_torque" in split else inputs.load_torque
        return weights, columns, replace(inputs, others=others, load_torque=pushed)

    @property
    def unseen_inertia(self) -> tuple[str, ...]:
        """Names of the inertias where all are before load-dependent friction; else empty.

        An element's inertia is before its friction. Of a load that is computed from further
        columns, they have it.
        """
        lossy = [k for k, e in enumerate(self.elements) if e.load_loss != "none"]
        computed = any(q.signal for q in self.load.quantities)
        if not lossy or self.load.has("inertia") or computed:
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

    def torque(
        self,
        values: Mapping[str, ArrayLike],
        position: ArrayLike,
        speed: ArrayLike,
        acceleration: ArrayLike,
        *,
        time: ArrayLike | None = None,
    ) -> Array:
        """Give the motor torque that a motion of the joint takes, as it would be recorded.

        Where ``drive.gain`` is a parameter, the true torque is that times it. A delay of recorded
        positions has no part in a motion that is given, and losses are those at 20 degC.

        Parameters
        ----------
        values
            A number for each parameter, or ``(n,)`` draws of it, such as
            ``posterior.posterior[name].values.ravel()``.
        position, speed, acceleration
            ``(N,)`` of the joint, or one number for all (rad or m, SI). Where it stands still,
            losses that depend on direction are zero.
        time
            ``(N,)`` s, for terms that depend on it, which are NaN without.

        Returns
        -------
        ndarray
            ``(N,)``, or ``(n, N)`` of draws, N m or N.

        Raises
        ------
        KeyError
            If a parameter is missing or a name is unknown.
        ValueError
            If lengths differ.
        """
        draws = np.broadcast_arrays(*values.values())
        vectors = self.vector(dict(zip(values, draws, strict=True)))
        q, qd, qdd = np.broadcast_arrays(*np.atleast_1d(position, speed, acceleration))
        stamps = None if time is None else np.asarray(time, dtype=np.float64)
        samples = self.samples(q, qd, qdd, AT_ROOM, stamps)
        torque: Array = inverse_many(*self.tables(np.atleast_2d(vectors), AT_ROOM), samples)
        return torque[0] if vectors.ndim == 1 else torque

    def tables(self, values: Array, inputs: Inputs | None = None) -> Tables:
        """Lay parameter vectors ``(n, d)`` out, with the offset and known mass of a recording."""
        defaults, sources, targets = self._layout
        flat = np.tile(defaults.astype(values.dtype), (len(values), 1))
        flat[:, targets] = values[:, sources]
        if inputs is not None and inputs.recording in self.own_offsets:
            column = self.names.index(f"offset.{inputs.recording}")
            flat[:, OFFSET - len(LOAD_SLOTS)] = values[:, column]
        split = len(self.elements) * len(ELEMENT_SLOTS)
        elements = flat[:, :split].reshape(-1, len(self.elements), len(ELEMENT_SLOTS))
        load = np.ascontiguousarray(flat[:, split:])
        if inputs is not None:
            load[:, [LOAD_INERTIA, FIRST_MOMENT]] += inputs.load(self.load.motion)
        factor, kd = self.drive_gains(values)
        load[:, GAIN] *= factor
        elements[:, 0, VISCOUS] += kd / self.ratio
        terms = self.carried_terms(inputs)
        carried = np.zeros((len(values), len(terms), 2), values.dtype)
        for k, term in enumerate(terms):
            carried[:, k, 0] = values[:, term.index] if term.index >= 0 else 1.0
            if term.shape >= 0:
                carried[:, k, 1] = values[:, term.shape]
        return Tables(np.ascontiguousarray(elements), load, carried)

    def samples(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        inputs: Inputs,
        time: Array | None = None,
    ) -> Samples:
        """Lay a motion ``(N,)`` of the joint out for the kernels; terms of time are NaN without."""
        position, speed, acceleration, stamps = (
            np.ascontiguousarray(x, dtype=np.float64)
            for x in (q, qd, qdd, np.full(np.size(qd), np.nan) if time is None else time)
        )
        terms = self.carried_terms(inputs)
        columns = np.zeros((len(terms), speed.size))
        for k, term in enumerate(terms):
            if term.shape < 0:  # the kernels compute columns that a parameter shapes
                columns[k] = along(term.row, term.reach, position, speed, stamps, inputs)
        return Samples(
            np.sin(position),
            np.cos(position),
            speed,
            acceleration,
            position,
            stamps,
            columns,
            np.array([c.place for c in terms], dtype=np.int64),
            np.array([c.reach for c in terms], dtype=np.float64),
            np.array([c.address if c.shape >= 0 else 0 for c in terms], dtype=np.int64),
        )

    @cached_property
    def _layout(self) -> tuple[Array, Sequence[int], Sequence[int]]:
        """Default values ``(n_slots,)`` of all slots, and pairs of parameter and slot index.

        :meth:`tables` puts in a recording's separate offset.
        """
        known = {"gravity": self.load.gravity, "gain": 1.0}
        known |= {slot: QUANTITIES[slot].default for slot in ELEMENT_SLOTS if slot in QUANTITIES}
        slots = [(e.name, slot) for e in self.elements for slot in ELEMENT_SLOTS]
        slots += [("load", slot) for slot in LOAD_SLOTS]
        ratios = {e.name: e.ratio for e in self.elements}
        defaults = [
            ratios[owner] if slot == "ratio" else known.get(slot, 0.0) for owner, slot in slots
        ]
        where = {slot: i for i, slot in enumerate(slots)}
        pairs = [
            (source, where[_bearer(p), slot])
            for source, p in enumerate(self.parameters)
            # a recording's offset depends on the recording
            if not (p.quantity == "offset" and self.own_offsets)
            for slot in slots_of(p)
        ]
        return np.array(defaults), [i for i, _ in pairs], [i for _, i in pairs]


def _bearer(p: Parameter) -> str:
    return "load" if p.owner in ("", "drive") else p.owner


def slots_of(p: Parameter) -> tuple[str, ...]:
    """List the kernel slots that a parameter fills; none for a term with a column."""
    known = LOAD_SLOTS if _bearer(p) == "load" else ELEMENT_SLOTS
    slots = (p.quantity,) if p.row.slots is None else p.row.slots
    if slots and set(slots) <= set(known):
        return slots
    column = p.row.column is not None or p.row.signal
    if p.quantity not in SHAPES and p.owner != "drive" and not (p.row.role == "own" and column):
        raise KeyError(f"{p.name}: neither the kernels nor a column know {p.quantity!r}")
    return ()


@dataclass(frozen=True)
class Preset:
    """A named joint with values to simulate it with."""

    name: str  # as written in a configuration
    meaning: str  # one line
    when: str  # kind of joint to choose it for, one line
    elements: tuple[Element, ...]
    load: Load
    values: dict[str, float]  # true parameter values for simulation, by name, SI
    source: str  # where these are from
    offset: bool = False

    def chain(self) -> Joint:
        """Make the joint, which keeps the preset's name as ``made_from``."""
        return Joint(self.elements, self.load, self.offset, made_from=self.name)


PRESETS: dict[str, Preset] = {
    preset.name: preset
    for preset in (
        Preset(
            "rabbit-knee",
            "motor, gearbox that passes torque differently when driving and back-driven, leg",
            "a leg or an arm behind a gearbox of high ratio that loses more the more it carries",
            # eqs. (3) to (9)
            (
                Element("motor", inertia=True, coulomb="by-direction", viscous=True, subscript="m"),
                Element("gearbox", ratio=50.0, load_loss="two"),
                Element("joint", coulomb="by-direction", viscous=True, subscript="c"),
            ),
            Load(inertia=True, first_moment=True),
            {
                "motor.inertia": 3.56e-4,
                "motor.viscous": 4.0e-3,
                "motor.coulomb_positive": 0.087,
                "motor.coulomb_negative": 0.091,
                # alpha_1 = 1/(1 + mu_1), alpha_2 = 1/(1 - mu_2), eq. (6)
                "gearbox.load_drive": 1.0 / 0.7432 - 1.0,
                "gearbox.load_back": 1.0 - 1.0 / 1.408,
                "joint.viscous": 3.12,
                "joint.coulomb_positive": 5.03,
                "joint.coulomb_negative": 5.15,
                "load.inertia": 0.206,
                "load.first_moment": 0.42,
            },
            "Table 3 of the 2005 IFAC paper",
        ),
        Preset(
            "motor-axis",
            "one axis with inertia, Coulomb and viscous friction and a torque offset",
            "a motor, a wheel or a stage that gravity does not pull",
            (Element("motor", inertia=True, coulomb="symmetric", viscous=True, subscript="m"),),
            Load(),
            {"motor.inertia": 0.01, "motor.viscous": 0.05, "motor.coulomb": 0.2, "offset": 0.02},
            "values of a small rotary stage, made up for simulation",
            offset=True,
        ),
        Preset(
            "servo-pendulum",
            "a geared servo that swings a pendulum, all referred to its output shaft",
            "a pendulum or an arm that gravity pulls, with torque and position of the joint",
            (
                Element("motor", inertia=True, coulomb="symmetric", viscous=True, subscript="m"),
                Element("gearbox", load_loss="one"),
            ),
            Load(first_moment=True, gravity_angle=True),
            {
                "motor.inertia": 2.0e-3,
                "motor.viscous": 0.02,
                "motor.coulomb": 0.02,
                "gearbox.load": 0.2,
                "load.first_moment": 0.049,
                "load.gravity_angle": 0.02,
            },
            "values near those of a small hobby servo, made up for simulation",
        ),
    )
}
