"""What programs take of the numbers in a file, as it was measured in them (``programs.toml``).

``python -m tests.export.programs`` loads a file of every format in every program that is installed,
fits numbers to the torque that the program's own dynamics need, and writes the table. A program
that is not installed keeps its row, with the version that it was last seen with.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files

from bayesfric.export.joint_model import LOSSES

# What a file may leave out: others are fitted in their place, or the user is left with it.
_REPLACED = {*LOSSES, "armature", "stiffness", "stiffness_cubic", "torque_offset"}


@dataclass(frozen=True)
class Program:
    """A program that reads a format, and how it reads its numbers."""

    name: str
    version: str  # that was measured
    # factor of each number in the dynamics: 1 arrives, 0 is lost
    takes: Mapping[str, float]
    stored: Sequence[str] = ()  # read, and left out of the dynamics
    warns: Sequence[str] = ()  # of these it says so
    # with this number in the file others are lost; none where the file is refused
    spoils: Mapping[str, Sequence[str]] = field(default_factory=dict)
    adds: Mapping[str, float] = field(default_factory=dict)  # where the file has none
    # errors along motions, N m; see the simulators' page
    torque: Mapping[str, Sequence[float | str]] = field(default_factory=dict)

    @property
    def unused(self) -> set[str]:
        """Numbers that a file for it has no use for: others are fitted in their place.

        What is stored only is left to the user, where no loss acts that could replace it.
        """
        lost = {name for name, factor in self.takes.items() if not factor} | {*self.spoils}
        acts = any(self.takes.get(name) for name in LOSSES)
        return (lost if acts else lost - {*self.stored}) & _REPLACED

    def changes(self, present: Iterable[str]) -> tuple[dict[str, float], list[str]]:
        """Give factors other than 1 of the numbers ``present``, and those that it refuses."""
        numbers = {*present}
        spoiling = [name for name in self.spoils if name in numbers]
        lost = {name: 0.0 for spoiler in spoiling for name in self.spoils[spoiler]}
        factors = {**self.takes, **lost}.items()
        changed = {name: x for name, x in factors if name in numbers and x != 1.0}
        return changed, [name for name in spoiling if not self.spoils[name]]


@cache
def programs() -> Mapping[str, Mapping[str, Program]]:
    """Read the programs of each format by name."""
    rows = tomllib.loads((files(__package__) / "programs.toml").read_text(encoding="utf-8"))
    return {
        form: {name: Program(name, **row) for name, row in of_form.items()}
        for form, of_form in rows.items()
    }
