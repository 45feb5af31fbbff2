"""A chain of elements from the motor to the load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.parameter import Motion, Parameter, parameter

# Columns of the packed tables that the compiled kernels read. One element is a
# row of the first, the load and the measurement make up the second.
ELEMENT_SLOTS = (
    "ratio",
    "inertia",
    "coulomb_positive",
    "coulomb_negative",
    "viscous",
    "quadratic",
    "stribeck_ratio",
    "stribeck_velocity",
    "load_drive",
    "load_back",
)
LOAD_SLOTS = ("inertia", "first_moment", "gravity_angle", "gravity", "offset", "gain")

# A quantity given once for both directions fills two slots.
_FILLS = {"coulomb": ("coulomb_positive", "coulomb_negative"), "load": ("load_drive", "load_back")}


@dataclass(frozen=True)
class Chain:
    """Motor to load, any number of elements (section 2.2 of the paper).

    Attributes
    ----------
    elements
        From the motor to the load; names differ.
    load
        What the last element moves.
    offset
        Whether the measured motor torque holds an unknown constant.
    own_offsets
        Names of the recordings that have a constant of their own, ``offset.<recording>``;
        with none, ``offset`` is one for all.
    gain
        Whether the factor from the torque computed from current or voltage to
        the true motor torque is unknown (``drive.gain``).
    preset
        Name of the preset it was made from, for the record.

    Raises
    ------
    ValueError
        If names repeat or a ratio is not positive.
    """

    elements: tuple[Element, ...]
    load: Load
    offset: bool = False
    own_offsets: tuple[str, ...] = ()
    gain: bool = False
    preset: str = ""

    def __post_init__(self) -> None:
        names = [element.name for element in self.elements]
        if not names:
            raise ValueError("a chain needs at least one element")
        if len(set(names)) < len(names) or {"load", "drive", "total", ""} & set(names):
            raise ValueError(
                "element names must differ and must not be empty, 'load', 'drive' or 'total'"
            )
        for element in self.elements:
            if not (np.isfinite(element.ratio) and element.ratio > 0):
                raise ValueError(f"{element.name}.ratio must be a positive number")

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters, motor first."""
        found = [p for element in self.elements for p in element.parameters()]
        found += self.load.parameters()
        if self.offset and not self.own_offsets:
            found.append(parameter("", "offset", self.motor_motion, ""))
        for number, recording in enumerate(self.own_offsets, start=1):
            one = parameter("", "offset", self.motor_motion, "")
            found.append(replace(one, name=f"offset.{recording}", symbol=rf"\Gamma_{{0,{number}}}"))
        if self.gain:
            found.append(parameter("drive", "gain", self.motor_motion, ""))
        return tuple(found)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Parameter names in the order of :attr:`parameters`."""
        return tuple(p.name for p in self.parameters)

    @property
    def motor_motion(self) -> Motion:
        """Whether the motor turns or slides."""
        return self.elements[0].motion

    @cached_property
    def ratio(self) -> float:
        """Motor speed over joint speed."""
        return float(np.prod([element.ratio for element in self.elements]))

    def vector(self, values: Mapping[str, float]) -> NDArray[np.float64]:
        """Put named values in the order of :attr:`names`.

        Raises
        ------
        KeyError
            If a parameter is missing or a name is unknown.
        """
        unknown = set(values) - set(self.names)
        missing = set(self.names) - set(values)
        if unknown or missing:
            raise KeyError(f"unknown: {sorted(unknown)}, missing: {sorted(missing)}")
        return np.array([values[name] for name in self.names], dtype=np.float64)

    def tables(
        self, values: NDArray[np.float64], recording: str = ""
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lay parameter vectors out for the compiled kernels.

        Parameters
        ----------
        values
            ``(n, n_parameters)`` in the order of :attr:`names`.
        recording
            Whose own offset is meant; any other name has none.

        Returns
        -------
        elements : (n, n_elements, 10)
            Columns are :data:`ELEMENT_SLOTS`.
        load : (n, 6)
            Columns are :data:`LOAD_SLOTS`.
        """
        defaults, sources, targets = self._layout
        flat = np.tile(defaults, (values.shape[0], 1))
        flat[:, targets] = values[:, sources]
        if recording in self.own_offsets:
            own = self.names.index(f"offset.{recording}")
            flat[:, LOAD_SLOTS.index("offset") - len(LOAD_SLOTS)] = values[:, own]
        split = len(self.elements) * len(ELEMENT_SLOTS)
        elements = flat[:, :split].reshape(-1, len(self.elements), len(ELEMENT_SLOTS))
        return np.ascontiguousarray(elements), np.ascontiguousarray(flat[:, split:])

    @cached_property
    def _layout(self) -> tuple[NDArray[np.float64], Sequence[int], Sequence[int]]:
        slots = [f"{e.name}.{slot}" for e in self.elements for slot in ELEMENT_SLOTS]
        slots += [f"load.{slot}" for slot in LOAD_SLOTS]
        where = {slot: i for i, slot in enumerate(slots)}
        defaults = np.zeros(len(slots))
        for element in self.elements:
            defaults[where[f"{element.name}.ratio"]] = element.ratio
            # any value does where the Stribeck rise is zero, except a division by zero
            defaults[where[f"{element.name}.stribeck_velocity"]] = 1.0
        defaults[where["load.gravity"]] = self.load.gravity
        defaults[where["load.gain"]] = 1.0

        sources: list[int] = []
        targets: list[int] = []
        for source, p in enumerate(self.parameters):
            if p.quantity == "offset" and self.own_offsets:
                continue  # whose it is, only the recording says
            owner = p.name.rpartition(".")[0]
            owner = "load" if owner in ("", "drive") else owner
            for slot in _FILLS.get(p.quantity, (p.quantity,)):
                sources.append(source)
                targets.append(where[f"{owner}.{slot}"])
        return defaults, sources, targets
