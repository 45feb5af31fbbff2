"""The numbers of an arm's joint that its table, files and advice have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from bayesfric.mechanism.quantities import QUANTITIES


@dataclass(frozen=True)
class JointNumber:
    """One of them.

    Attributes
    ----------
    parameters
        That it is in a fit, one, or two by direction whose mean it is.
    title
        Of its column in the table; empty for none.
    word
        For people who read a file.
    """

    parameters: tuple[str, ...]
    title: str
    word: str

    @property
    def units(self) -> tuple[str, str]:
        """Of a joint that turns, and of one that slides."""
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
}
