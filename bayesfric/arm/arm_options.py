"""``arm.toml``: options of an arm in addition to its URDF; the numbers of a joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from bayesfric.base.errors import Unfit
from bayesfric.base.options import Options
from bayesfric.mechanism.configuration import ElementOptions
from bayesfric.mechanism.quantities import QUANTITIES
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.source import Processing
from bayesfric.recordings.units import Delay, Kilograms, Metres

Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
# Relative standard deviation of a drive gain, or range of its factor.
Gain = Positive | tuple[Positive, Positive]


@dataclass(frozen=True)
class JointNumber:
    """A number of an arm's joint in its table, files and advice."""

    parameters: tuple[str, ...]  # of a fit: one, or two by direction whose mean it is
    title: str  # of its column in the table; empty for none
    word: str  # in comments of files

    @property
    def units(self) -> tuple[str, str]:
        """Units of a joint that turns, and of one that slides."""
        return QUANTITIES[self.parameters[0].rpartition(".")[2]].units


NUMBERS: Mapping[str, JointNumber] = {
    "armature": JointNumber(("motor.inertia",), "armature", "armature"),
    "coulomb": JointNumber(
        ("motor.coulomb", "motor.coulomb_positive", "motor.coulomb_negative"), "Coulomb", "friction"
    ),
    "viscous": JointNumber(
        ("motor.viscous", "motor.viscous_positive", "motor.viscous_negative"), "viscous", "damping"
    ),
    "load": JointNumber(
        ("motor.load", "motor.load_drive", "motor.load_back"), "load loss", "friction per load"
    ),
    "offset": JointNumber(("offset",), "", "offset"),
    "gain": JointNumber(("drive.gain",), "drive gain", "true torque per effort"),
}


def torque_columns(rigid: Array, speed: Array, acceleration: Array) -> Array:
    """Stack the torque of one of each number, in the order of :data:`NUMBERS` but for the gain.

    ``rigid`` is the rigid-body torque; all have any shape ``(...)``, and the result ``(5, ...)``.
    """
    sign = np.sign(speed)
    return np.stack([acceleration, sign, speed, np.abs(rigid) * sign, np.ones_like(speed)])


class Payload(Options):
    """The ``[payload]`` table: a mass on a link that is not in the URDF."""

    link: str | None = Field(
        None, description="Link that carries it; the last of the longest chain if left out."
    )
    logs: tuple[str, ...] | None = Field(
        None, description="Logs that it is on for, files without their ending; all if left out."
    )
    mass: Kilograms = Field(0.0, description="Known mass, kg.")
    centre: Vector = Field((0.0, 0.0, 0.0), description="Its centre in the link's frame, m.")
    mass_sd: Kilograms = Field(1.0, description="Standard deviation of that mass, kg.")
    centre_sd: Metres = Field(
        0.1, description="How far off its centre may be, and how large it is, m."
    )

    @property
    def given(self) -> bool:
        """Whether anything is said of a payload, so that there is one."""
        return self != Payload()


class Uncertainty(Options):
    """The ``[urdf]`` table: how well the bodies of the URDF are known, as standard deviations."""

    factor: NotNegative = Field(
        0.1, description="Relative, of all bodies together, and once more of each by itself."
    )
    centre: Metres = Field(0.02, description="Of each body's centre of mass, m, along each axis.")


class Repeatability(Options):
    """The ``[repeatability]`` table: relative standard deviations from one log to another."""

    friction: NotNegative = Field(
        0.1, description="Of friction, as temperature, grease and time change it."
    )
    effort: NotNegative = Field(
        0.05, description="Of the effort per torque, as drive gains and poses change it."
    )


class Coupling(Options):
    """The ``[coupling]`` table: joints of which a motor turns several, as in many wrists."""

    joints: tuple[str, ...] = Field((), description="Their names, in the order of the matrix.")
    matrix: tuple[tuple[Finite, ...], ...] = Field(
        (),
        description="Positions of the motors, each over its gear ratio, per positions of the "
        "joints, a row a motor: [[1, 0], [1, 1]]. Efforts are those of the motors.",
    )

    @model_validator(mode="after")
    def _invertible(self) -> Self:
        size = len(self.joints)
        if len(set(self.joints)) < size or [*map(len, self.matrix)] != [size] * size:
            raise Unfit(f"joints that differ, and {size} rows of {size} numbers", "got others")
        if size and not np.linalg.cond(np.array(self.matrix)) < 1e6:
            raise Unfit("a matrix that can be inverted", "got one that cannot")
        return self

    def motors(self, joints: Sequence[str]) -> Array:
        """Give the positions of all motors per positions of ``joints``, a square matrix."""
        every, at = np.eye(len(joints)), [[*joints].index(name) for name in self.joints]
        if at:
            every[np.ix_(at, at)] = self.matrix
        return every


class JointOptions(Options):
    """A ``[joints.NAME]`` table."""

    fit: bool = Field(True, description="Whether it is fitted.")
    label: str | None = Field(None, description="What {joint} is in the log; its name if left out.")
    held: Finite | None = Field(
        None, description="Position of a joint that the log does not have, rad or m."
    )
    torque_constant: str | None = Field(
        None,
        description="Torque at the joint per current (drive gain), such as '13.58 N m/A'; it is "
        "{torque_constant} in [recording].",
    )
    gain: Gain | None = Field(None, description="As that of the arm, for this joint.")
    delay: Delay | None = Field(None, description="As that of the arm, for this joint.")
    gear_ratio: Positive | None = Field(
        None, description="Motor speed over joint speed; then the rotor's inertia is reported, too."
    )
    rotor_inertia: Positive | None = Field(
        None, description="Known inertia of the rotor in kg m², within a fifth; with gear_ratio."
    )
    priors: dict[str, Any] = Field(
        default_factory=dict, description="As [priors] of a configuration, for this joint."
    )


class ArmOptions(Options):
    """Everything that ``arm.toml`` may hold."""

    gravity: Vector = Field((0.0, 0.0, -9.80665), description="In the frame of the root, m/s².")
    payload: Payload = Field(Payload(), description="A mass that is not in the URDF.")
    coupling: Coupling = Field(Coupling(), description="Joints of which a motor turns several.")
    repeatability: Repeatability = Field(
        Repeatability(), description="What may differ in another log, in bands of its prediction."
    )
    urdf: Uncertainty = Field(Uncertainty(), description="How well the URDF is known.")
    recording: dict[str, Any] = Field(
        default_factory=dict,
        description="A [[recordings]] table without file: {joint} in its texts is the joint's "
        "label, {number} its place in the URDF from 1, {index} from 0; or a list has an entry for "
        "each joint that is not held.",
    )
    friction: ElementOptions = Field(
        ElementOptions(),
        description="Further or other friction of all joints, as an element of a mechanism.",
    )
    spring: bool = Field(
        False, description="Whether a cable or spring pulls each joint in proportion to its angle."
    )
    terms: Literal["auto", "as written"] = Field(
        "as written",
        description="auto adds terms that explain a joint's torque; minutes more a joint.",
    )
    gain: Gain | None = Field(
        None,
        description="How well drive gains are known, or the scale of efforts: relative standard "
        "deviation, or range [0.8, 1.2] of true over measured torque; exact if left out.",
    )
    delay: Delay | None = Field(
        None,
        description="Time by which the positions of the log come after its efforts, such as "
        "'4 ms', or 'off'; estimated by all joints if left out.",
    )
    processing: Processing = Field(
        Processing(), description="As [processing] of a configuration, for all joints."
    )
    samples: int = Field(
        50_000,
        ge=1_000,
        description="Samples of all logs that are fitted at most: longer ones are reduced to "
        "segments all over them. Time and memory grow with it.",
    )
    fit: dict[str, Any] = Field(
        default_factory=dict,
        description="Other tables of a configuration: noise, sampling, self_check, likelihood.",
    )
    joints: dict[str, JointOptions] = Field(
        default_factory=dict, description="By name, as in the URDF."
    )

    def of(self, joint: str) -> JointOptions:
        """Return the options of a joint, the defaults where it has none."""
        return self.joints.get(joint, JointOptions())
