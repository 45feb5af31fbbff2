"""The table of all terms that a joint may have, each declared once.

A term of the friction law is one :class:`Quantity`. What it adds to the torque, its *column*,
is a function of the state of its own element; ratios, totals, regressors, default priors,
configuration and words follow from the row. The compiled kernels of
:mod:`bayesfric.mechanism.kernels` write out the terms that have a slot there; any other term
that adds a torque is carried by its column. A quantity with neither is refused.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np

from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import ROOM

Motion = Literal["rotary", "linear"]
Column = Callable[..., Any]  # of a State, and of the value of the parameter that shapes it
Choice = str | bool | int
Units = tuple[str, str]  # where the element's input turns, where it slides

Angle = TypeVar("Angle", float, Array)
TURN = 2.0 * math.pi
_INF = math.inf
# The word alone, not as a part of a name such as noise.torque, torque_constant or torque-steps.
_TORQUE_WORD = re.compile(r"(?<![\w.-])torque(s?)(?![\w]|[.-]\w)")


class State(NamedTuple):
    """What an element's torque depends on, at its own input; numbers or arrays ``(N,)``, in SI."""

    position: Any  # rad or m and s
    speed: Any
    acceleration: Any
    # sign of the speed; at rest, where a joint is about to break away, that of the torque
    direction: Any
    time: Any  # s since the recording's first stamp
    transmitted: Any = 0.0  # torque at the element's output, brought to its input, N m or N
    gravity: Any = 0.0  # gravity torque of a first moment of 1 kg m, g sin(q + q_g)


@dataclass(frozen=True)
class TypicalSizes:
    """Sizes of what was measured, at one shaft, by which default priors are scaled."""

    torque: float  # largest of the motor (99.9th percentile), N m or N
    speed: float  # root mean square, rad or m and s
    acceleration: float
    gravity: float = 1.0  # m/s²
    lean: float = 1.0  # largest sine of the joint's angle that gravity was seen at
    exchanged: float = 0.0  # torque that one term surely takes, from another maybe, N m or N
    position: float = 1.0  # range of the joint's, rad or m
    duration: float = 1.0  # of the longest recording, s
    position_step: float = 0.0  # finest that one was read in, rad or m; 0 where it is not known
    period: float = 0.0  # longest between two samples, s
    # rms torque of each custom or signal term, for a value of one
    columns: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Quantity:
    """One row of the table."""

    name: str  # after the dot of a parameter's name
    units: Units  # as printed, in SI; empty for none
    symbol: str  # LaTeX without dollar signs, the paper's where it has one; {} is the subscript
    meaning: str  # one line for people, worded for what turns
    # option of an element or load that brings it (CHOICES, CYCLES), empty for the chain's; several
    # choices where each brings it
    option: str = ""
    choice: Choice | tuple[Choice, ...] = True
    # own adds value * column to the torque; loss, too, and depends on the transmitted torque; form
    # only shapes other terms
    role: Literal["own", "loss", "form"] = "own"
    column: Column | None = None  # torque for a value of one, a function of a State
    shape: str = ""  # quantity of the same element that its column takes, too
    signal: str = ""  # signal of Inputs that its column is, or is multiplied by
    zero: float = 0.0  # subtracted from the signal
    # column scales with r**power where position, speed and acceleration scale with r, as through a
    # ratio; None where it does not
    power: int | None = None
    slots: tuple[str, ...] | None = None  # of the compiled kernels; its name if left out
    # columns of psi, eq. (13), that it fills (TOTALS), with weights; that of its name if left out
    shares: tuple[tuple[str, float], ...] = ()
    totals: tuple[str, ...] = ()  # motor-side totals it is part of; that of its name if left out
    # the totals it is part of instead, where other elements distinguish the directions
    by_direction: tuple[str, str] | None = None
    rises: bool = False  # whether the rise at low speed multiplies it
    scaled_by: int = 0  # power of the factor of section 4.2 that divides it
    lower: float = 0.0  # support; no prior may reach outside
    upper: float = _INF
    default: float = 0.0  # value where it is not part of the model
    circular: bool = False  # whether values a turn apart are the same
    # family and scale of the default prior; by default half-normal or, where both signs are
    # possible, normal, with the scale that would need the largest torque
    prior: str = ""
    spread: Callable[[TypicalSizes], float] | None = None
    stores: bool = False  # whether it is conservative: other terms may balance it, not the motor
    prior_upper: float = _INF  # where default priors end if before upper
    # values to try first
    tries: Callable[[TypicalSizes], tuple[float, ...]] | None = None
    start: float | None = None  # of a search; None for its share of a total
    alone: str = ""  # its meaning where no other element has it; {} is its owner
    # of a total: its regressor of eq. (11) in plain least squares; its symbol where an angle turns
    # gravity
    regressor: str = ""
    turned: str = ""
    # a constant has a physical value; a law coefficient is that of the same model fitted to similar
    # motions
    measurand: Literal["constant", "law"] = "law"

    def brought_by(self, choice: Any) -> bool:
        """Whether this choice of its option brings it."""
        if isinstance(self.choice, tuple):
            return choice in self.choice
        if self.option in CYCLES and not isinstance(choice, bool):
            return self.choice in choice
        return bool(choice == self.choice)

    @property
    def bends(self) -> bool:
        """Whether it changes the totals of eq. (11): a loss, or a shape."""
        shapes = self.role == "form" and self.option != "" and not self.circular
        return self.role == "loss" or shapes

    @property
    def bent_by(self) -> str:
        """What changes them, in words."""
        of_load = self.role == "loss" or self.option.startswith("load_")
        return ("load-dependent friction" if of_load else "changing friction") if self.bends else ""

    @property
    def fills(self) -> tuple[tuple[str, float], ...]:
        """Columns of ``psi``, eq. (13), that it fills, and the weight in each."""
        return self.shares or ((self.name, 1.0),)

    def unit(self, motion: Motion) -> str:
        """Look up the unit for an element whose input turns or slides."""
        return self.units[0 if motion == "rotary" else 1]


def _drives(state: State) -> Any:
    """Torque of a loss per transmitted torque of one, while the motor side drives."""
    return np.maximum(state.transmitted * state.direction, 0.0) * state.direction


def _is_driven(state: State) -> Any:
    """Torque of a loss per transmitted torque of one, while the load drives."""
    return np.maximum(-state.transmitted * state.direction, 0.0) * state.direction


_TORQUE, _NONE = ("N m", "N"), ("", "")

# Options of an element, of the load, and of both that list numbers of cycles a turn: what each may
# be but false or "none", and the line that `init` writes of it.
CHOICES: dict[str, tuple[tuple[str | bool, ...], str]] = {
    "inertia": ((True,), "whether it has inertia"),
    "coulomb": (("symmetric", "by-direction"), "constant loss"),
    "viscous": ((True, "by-direction"), "loss in proportion to speed"),
    "quadratic": ((True,), "loss with the square of speed"),
    "power": (
        (True,), "loss with a power of speed between 0 and 2, flattening or steepening"
    ),
    "temperature": (
        ("viscous", "constant", "both"),
        "change of losses with the recorded temperature, from 20 degC on",
    ),
    "warming": (
        ("viscous", "constant", "both"), "change of losses with time since the recording began"
    ),
    "stribeck": (
        (True, "either", "apart"), "rise of constant and load-dependent friction at low speed"
    ),
    "stribeck_exponent": ((True,), "exponent of speed in that rise; 2 if left out"),
    "load_loss": (("one", "two"), "loss in proportion to transmitted torque"),
    "load_direction": ((True, "quadrants"), "load-dependent friction by direction of motion"),
    "load_speed": ((True,), "growth of load-dependent friction with speed"),
    "load_square": ((True,), "growth of load-dependent friction with the load"),
}  # fmt: skip
LOAD_CHOICES: dict[str, tuple[tuple[str | bool, ...], str]] = {
    "inertia": CHOICES["inertia"],
    "first_moment": ((True,), "gravity moment ml"),
    "gravity_angle": ((True,), "unknown angle of gravity's zero"),
    "spring": ((True, "stiffening"), "torque in proportion to angle, as of a spring or cable"),
}
CYCLE_MEANINGS = {
    "cogging": "torque that repeats; cycles a turn (in 2π m of what slides)",
    "periodic_friction": "constant loss that depends on the angle; cycles a turn (in 2π m)",
}

# What several rows share: losses that change with the recorded temperature, rises at low speed,
# differences of load-dependent friction by direction.
_warm = partial(Quantity, option="temperature", lower=-_INF, signal="temperature", zero=ROOM)
_rise = partial(Quantity, option="stribeck", role="form", spread=lambda _: 1.0, start=0.3)
_apart = partial(
    Quantity, option="load_direction", choice="quadrants", role="form", lower=-_INF, start=0.0,
    spread=lambda _: 0.1, scaled_by=1,
)  # fmt: skip

# In the order in which an element lists its parameters.
QUANTITIES: dict[str, Quantity] = {
    row.name: row
    for row in (
        Quantity(
            "inertia", ("kg m²", "kg"), "J_{{{}}}", "inertia at the element's input",
            option="inertia", column=lambda m: m.acceleration, power=1, stores=True,
            alone="inertia of everything that moves, seen by the {}", measurand="constant",
        ),
        Quantity(
            "viscous", ("N m s", "N s/m"), "f_{{{}}}", "loss growing in proportion to speed",
            option="viscous", column=lambda m: m.speed, power=1,
            by_direction=("viscous_positive", "viscous_negative"),
        ),
        Quantity(
            "viscous_positive", ("N m s", "N s/m"), "f_{{{}1}}",
            "loss growing in proportion to positive speed",
            option="viscous", choice="by-direction",
            column=lambda m: np.maximum(m.speed, 0.0), power=1,
            shares=(("viscous", 0.5), ("viscous_difference", 0.5)),
        ),
        Quantity(
            "viscous_negative", ("N m s", "N s/m"), "f_{{{}2}}",
            "loss growing in proportion to negative speed",
            option="viscous", choice="by-direction",
            column=lambda m: np.minimum(m.speed, 0.0), power=1,
            shares=(("viscous", 0.5), ("viscous_difference", -0.5)),
        ),
        Quantity(
            "coulomb", _TORQUE, "C_{{{}}}", "constant loss, same in both directions",
            option="coulomb", choice="symmetric", column=lambda m: m.direction, power=0,
            slots=("coulomb_positive", "coulomb_negative"),
            totals=("coulomb_positive", "coulomb_negative"), rises=True,
        ),
        Quantity(
            "coulomb_positive", _TORQUE, "C_{{{}1}}", "constant loss at positive speed",
            option="coulomb", choice="by-direction",
            column=lambda m: np.maximum(m.direction, 0.0), power=0,
            shares=(("coulomb", 0.5), ("difference", 0.5)), rises=True,
        ),
        Quantity(
            "coulomb_negative", _TORQUE, "C_{{{}2}}", "constant loss at negative speed",
            option="coulomb", choice="by-direction",
            column=lambda m: np.minimum(m.direction, 0.0), power=0,
            shares=(("coulomb", 0.5), ("difference", -0.5)), rises=True,
        ),
        Quantity(
            "quadratic", ("N m s²", "N s²/m²"), "f_{{3,{}}}",
            "loss growing with the square of speed",
            option="quadratic", column=lambda m: m.speed * np.abs(m.speed), power=2,
        ),
        # viscous friction of greases: exponents of 0.4 to 1 (Ruderman 2012; Waiboer, Aarts and
        # Jonker 2005); bearing friction with lambda = 2/3 (Palmgren 1957)
        Quantity(
            "power", _TORQUE, "f_{{p,{}}}",
            "loss growing with a power of speed; at a speed of 1",
            option="power", column=lambda m, exponent: m.direction * np.abs(m.speed) ** exponent,
            shape="power_exponent",
        ),
        Quantity(
            "power_exponent", _NONE, "p_{{{}}}", "power of speed that a loss grows with",
            option="power", role="form", upper=2.0, default=1.0, prior="uniform", start=0.6,
            tries=lambda _: (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.2, 1.4, 1.6, 1.8),
        ),
        _warm(
            "viscous_temperature", ("N m s/K", "N s/(m K)"), r"f_{{\vartheta,{}}}",
            "change of viscous loss per kelvin above 20 degC",
            choice=("viscous", "both"), column=lambda m: m.speed,
        ),
        _warm(
            "coulomb_temperature", ("N m/K", "N/K"), r"C_{{\vartheta,{}}}",
            "change of constant loss per kelvin above 20 degC",
            choice=("constant", "both"), column=lambda m: m.direction,
        ),
        # oil thins as it warms (Simoni et al. 2015: friction of a robot's joint falls by half)
        Quantity(
            "viscous_warming", ("N m s", "N s/m"), r"\Delta f_{{{}}}",
            "change of viscous loss from the recording's begin until warm",
            option="warming", choice=("viscous", "both"), lower=-_INF, shape="warming_time",
            column=lambda m, time: -m.speed * np.expm1(-m.time / np.maximum(time, 1e-9)),
        ),
        Quantity(
            "coulomb_warming", _TORQUE, r"\Delta C_{{{}}}",
            "change of constant loss from the recording's begin until warm",
            option="warming", choice=("constant", "both"), lower=-_INF, shape="warming_time",
            column=lambda m, time: -m.direction * np.expm1(-m.time / np.maximum(time, 1e-9)),
        ),
        Quantity(
            "warming_time", ("s", "s"), r"\tau_{{{}}}", "time constant of warming up",
            option="warming", choice=("viscous", "constant", "both"), role="form", default=1.0,
            spread=lambda s: s.duration, start=60.0,
            tries=lambda s: tuple(x * s.duration for x in (0.05, 0.1, 0.2, 0.35, 0.6, 1.0)),
        ),
        _rise(
            "stribeck_ratio", _NONE, "c_{{{}}}",
            "relative rise of constant and load-dependent friction at low speed",
            slots=("stribeck_ratio", "stribeck_load_ratio"),
        ),
        # a loss that falls towards standstill: elements that give way before they slide
        _rise(
            "stribeck_change", _NONE, "c_{{{}}}",
            "relative rise of constant and load-dependent friction at low speed, "
            "negative for a fall",
            choice="either", slots=("stribeck_ratio", "stribeck_load_ratio"), lower=-1.0,
            spread=lambda _: 0.5, start=0.1,
        ),
        _rise(
            "stribeck_constant", _NONE, "c_{{C,{}}}",
            "relative rise of the constant loss at low speed",
            choice="apart", slots=("stribeck_ratio",),
        ),
        _rise(
            "stribeck_load", _NONE, r"c_{{\mu,{}}}",
            "relative rise of load-dependent friction at low speed",
            choice="apart", slots=("stribeck_load_ratio",),
        ),
        Quantity(
            "stribeck_velocity", ("rad/s", "m/s"), r"\dot q_{{0,{}}}",
            "speed at which the low-speed rise has fallen to 37 %",
            option="stribeck", choice=(True, "either", "apart"), role="form", default=1.0,
            spread=lambda s: s.speed, start=1.0,
            tries=lambda s: tuple(x * s.speed for x in (0.03, 0.05, 0.08, 0.13, 0.22, 0.36, 0.6)),
        ),
        # 2 in eq. (2); published between 0.5 and 2 (Armstrong-Helouvry 1991), free in BAM
        Quantity(
            "stribeck_exponent", _NONE, "a_{{{}}}", "exponent of speed in the low-speed rise",
            option="stribeck_exponent", role="form", upper=4.0, default=2.0, prior="uniform",
            start=2.0,
        ),
        Quantity(
            "load", _NONE, r"\mu_{{{}}}", "loss per transmitted torque, both directions of power",
            option="load_loss", choice="one", role="loss",
            column=lambda m: _drives(m) + _is_driven(m), slots=("load_drive", "load_back"),
            rises=True, spread=lambda _: 0.5, prior_upper=1.0,
        ),
        Quantity(
            "load_drive", _NONE, r"\mu_{{{}1}}",
            "loss per transmitted torque when the motor drives",
            option="load_loss", choice="two", role="loss", column=_drives, rises=True,
            spread=lambda _: 0.5,
        ),
        # a reversible gearbox keeps mu_2 below one: alpha_2 = 1/(1 - mu_2) is finite
        Quantity(
            "load_back", _NONE, r"\mu_{{{}2}}",
            "loss per transmitted torque when the load drives",
            option="load_loss", choice="two", role="loss", column=_is_driven, rises=True,
            spread=lambda _: 0.5, prior_upper=1.0,
        ),
        _apart(
            "load_difference", _NONE, r"\Delta\mu_{{{}}}",
            "half the difference of load-dependent friction at positive and negative speed",
            choice=True, slots=("load_drive_difference", "load_back_difference"),
        ),
        _apart(
            "load_drive_difference", _NONE, r"\Delta\mu_{{{}1}}",
            "half the difference by direction of load-dependent friction when the motor drives",
        ),
        _apart(
            "load_back_difference", _NONE, r"\Delta\mu_{{{}2}}",
            "half the difference by direction of load-dependent friction when the load drives",
        ),
        # gear friction of oil films (Hamon, Gautier and Garrec 2010)
        Quantity(
            "load_speed", ("s/rad", "s/m"), r"\mu_{{v,{}}}",
            "growth of load-dependent friction in proportion to speed",
            option="load_speed", role="form",
            spread=lambda s: 0.3 / s.speed, start=0.0, scaled_by=1,
        ),
        # BAM's M6
        Quantity(
            "load_square", ("1/(N m)", "1/N"), r"\mu_{{T,{}}}",
            "growth of load-dependent friction in proportion to transmitted torque",
            option="load_square", role="form", spread=lambda s: 0.3 / s.torque, start=0.0,
            scaled_by=2,
        ),
        Quantity(
            "first_moment", ("kg m", ""), "ml", "mass times distance to its centre",
            option="first_moment", column=lambda m: m.gravity, power=0,
            shares=(("gravity", 1.0),), totals=("gravity",),
            spread=lambda s: s.torque / abs(s.gravity * s.lean), stores=True, measurand="constant",
        ),
        Quantity(
            "gravity_angle", ("rad", ""), "q_g", "angle added to q in gravity",
            option="gravity_angle", role="form", lower=-_INF, circular=True,
            prior="uniform", measurand="constant",
        ),
        Quantity(
            "spring", ("N m/rad", "N/m"), "k_{{{}}}", "torque in proportion to position",
            option="spring", choice=(True, "stiffening"), column=lambda m: m.position, power=1,
            lower=-_INF, stores=True, measurand="constant",
        ),
        # a cable or hose that tightens towards the ends of the range
        Quantity(
            "spring_cubic", ("N m/rad³", "N/m³"), "k_{{3,{}}}",
            "torque in proportion to the cube of position",
            option="spring", choice="stiffening", column=lambda m: m.position**3, power=3,
            lower=-_INF, stores=True, measurand="constant",
        ),
        Quantity(
            "offset", _TORQUE, r"\Gamma_0", "constant torque in the measured motor torque",
            column=lambda m: np.ones_like(m.speed), power=0, lower=-_INF, measurand="constant",
        ),
        Quantity(
            "gain", _NONE, "k",
            "true motor torque over the torque computed from current or voltage",
            role="form", default=1.0, prior="lognorm", spread=lambda _: 0.5, measurand="constant",
        ),
        # the gains of the drive's controller, at the joint; a step of the law, not of the friction
        Quantity(
            "kp", ("N m/rad", "N/m"), "k_p", "gain of the drive's controller",
            role="form", slots=(), spread=lambda s: s.torque / s.position, measurand="constant",
        ),
        Quantity(
            "kd", ("N m s/rad", "N s/m"), "k_d", "gain of the drive's controller for the speed",
            role="form", slots=(), spread=lambda s: s.torque / s.speed, start=0.0,
            measurand="constant",
        ),
        # a target that is held until the next is one half, half a sample late
        Quantity(
            "smoothness", _NONE, "s",
            "how the target passes between samples: 0 in a line, 1 in a smooth curve",
            role="form", slots=(), lower=-_INF, spread=lambda _: 1.0, start=0.5,
            measurand="constant",
        ),
        # with a late position the torque of earlier on is recorded
        Quantity(
            "delay", ("s", "s"), r"\delta",
            "time by which the recorded position comes after the torque",
            signal="torque_rate", slots=(), lower=-_INF, measurand="constant",
        ),
    )
}  # fmt: skip

# The delay of a torque that is computed from a target: only the target is late.
LATE_TARGET = replace(
    QUANTITIES["delay"], meaning="time by which the drive acts late on its target", lower=0.0
)
# Quantities that shape terms without a slot.
SHAPES = frozenset(row.shape for row in QUANTITIES.values() if row.shape)


@lru_cache(maxsize=512, typed=True)
def _waves(option: str, cycles: Any) -> tuple[Quantity, ...]:
    """Sine and cosine over the angle: torque, or friction that goes by the direction."""
    if isinstance(cycles, bool) or not isinstance(cycles, int) or cycles < 1:
        problem = "is not a number of cycles a turn; write 1, 2, ..."
        raise ValueError(f"{option} = {cycles!r} {problem}")
    rest: dict[str, Any] = {"option": option, "choice": cycles, "lower": -_INF, "slots": ()}
    if option == "cogging":  # of magnets and teeth (Hsu et al. 2015)
        letter, effect, rest["measurand"] = "a", "torque", "constant"
        sine, cosine = lambda m: np.sin(cycles * m.position), lambda m: np.cos(cycles * m.position)
    else:  # as of an eccentric gear (Armstrong-Helouvry 1991)
        letter, effect = "c", "constant loss"
        sine = lambda m: m.direction * np.sin(cycles * m.position)  # noqa: E731
        cosine = lambda m: m.direction * np.cos(cycles * m.position)  # noqa: E731
    return tuple(
        Quantity(
            f"{option}_{part}_{cycles}", _TORQUE, rf"{letter}_{{{{{{}},\{part}\,{cycles}}}}}",
            f"{effect} with the {word} of {cycles} cycles a turn", column=column, **rest,
        )
        for part, word, column in (("sin", "sine", sine), ("cos", "cosine", cosine))
    )  # fmt: skip


# Options that list numbers of cycles a turn, and the quantities that each number brings.
CYCLES: Mapping[str, Callable[[int], tuple[Quantity, ...]]] = {
    option: partial(_waves, option) for option in CYCLE_MEANINGS
}


def _total(quantity: str, symbol: str, meaning: str, **changes: Any) -> Quantity:
    """Make the motor-side total of a quantity, or the half difference of two."""
    return replace(QUANTITIES[quantity], symbol=symbol, meaning=meaning, **changes)


# Columns of ``psi`` in motor units, eq. (13), in the order of the paper's theta; a column is a
# function of the motor's state. A coefficient is positive in any mechanism that loses energy where
# its support is.
TOTALS: dict[str, Quantity] = {
    row.name: row
    for row in (
        _total("inertia", "J_t", "inertia seen by the motor"),
        _total("viscous", "f_t", "viscous loss seen by the motor"),
        _total(
            "viscous", r"\Delta f_t",
            "half the difference of the viscous losses at positive and negative speed",
            name="viscous_difference", column=lambda m: np.abs(m.speed), lower=-_INF,
        ),
        _total("quadratic", "f_{3,t}", "quadratic loss seen by the motor"),
        _total("coulomb", "C_t", "constant loss seen by the motor"),
        # C1 and C2 act on what moves; plain least squares takes the offset for their difference
        _total(
            "coulomb", r"\Delta C", "half the difference of the constant losses",
            name="difference", column=lambda m: np.abs(m.direction), lower=-_INF,
            regressor="offset",
        ),
        _total("offset", r"\Delta C_t", "constant torque, half the difference of the losses"),
        Quantity(
            "gravity", _TORQUE, r"ml\,g/(\alpha_m N)",
            "gravity torque seen by the motor, sine part",
            column=lambda m: m.gravity, lower=-_INF, turned=r"ml\,g\cos q_g/(\alpha_m N)",
        ),
        Quantity(
            "gravity_cosine", _TORQUE, r"ml\,g\sin q_g/(\alpha_m N)", "gravity torque, cosine part",
            column=lambda m: m.gravity, lower=-_INF,
        ),
        Quantity(
            "added_load", _NONE, r"1/\alpha_m", "motor torque per torque of the known added load",
            column=lambda m: m.transmitted,
        ),
    )
}  # fmt: skip


# --- parameters: quantities of one element --------------------------------------------


@dataclass(frozen=True)
class Parameter:
    """One parameter of the joint, ``element.quantity``."""

    name: str  # for example motor.inertia
    row: Quantity  # its row in the table of quantities
    owner: str  # name of the element, load, drive, or empty for the whole chain
    unit: str  # as printed, in SI
    symbol: str  # LaTeX without dollar signs, the paper's where it has one
    meaning: str  # one line for people
    quantity: str  # the part after the dot of its name; this and the next four are its row's
    lower: float  # support; no prior may reach outside
    upper: float
    default: float  # value where it is not part of the model
    circular: bool  # whether values a turn apart are the same


def parameter(
    owner: str, row: Quantity, motion: Motion, subscript: str, *, alone: bool = False
) -> Parameter:
    """Describe one quantity of one element."""
    meaning = row.alone.format(owner) if alone and row.alone else row.meaning
    return Parameter(
        f"{owner}.{row.name}" if owner else row.name,
        row,
        owner,
        row.unit(motion),
        row.symbol.format(subscript),
        effort_words(meaning, motion),
        *(row.name, row.lower, row.upper, row.default, row.circular),
    )


def turned(value: Angle, towards: float) -> Angle:
    """Add whole turns to an angle until it lies at most half a turn from another one."""
    out: Angle = value + TURN * np.round((towards - value) / TURN)
    return out


def scales_with_torque(unit: str) -> bool:
    """Whether a wrong scale of the torque multiplies a number of this unit.

    A wrong torque constant multiplies inertia, friction and offsets; not a loss per torque, a speed
    or an angle.
    """
    return unit.startswith(("kg", "N"))


def effort_words(words: str, motion: Motion) -> str:
    """Say force in place of torque of what slides, and 2π m in place of a turn."""
    if motion == "rotary":
        return words
    return _TORQUE_WORD.sub(r"force\1", words).replace("cycles a turn", "cycles in 2π m")


def quantity_of(name: str) -> str:
    """Give the quantity of a parameter or total: ``inertia`` of ``total.inertia``.

    An offset may go by a recording's name, which says nothing: ``total.offset.<recording>``.
    """
    first, _, rest = name.removeprefix("total.").partition(".")
    return first if first == "offset" or not rest else rest
