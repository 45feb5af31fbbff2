"""The ``[mechanism]`` table of a configuration, and the chain it describes."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from bayesfric.errors import BadInput, Unfit, nearest
from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.element import CoulombLoss, Element, Load, LoadLoss
from bayesfric.mechanism.parameter import Motion
from bayesfric.mechanism.presets import PRESETS


def _not_zero(value: float) -> float:
    if value == 0.0:
        raise Unfit("a number other than 0", f"got {value:g}")
    return value


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _Options(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    def given(self) -> dict[str, Any]:
        """Only what the configuration says."""
        return self.model_dump(exclude_unset=True)


class ElementOptions(_Options):
    """One element; what is left out keeps the preset's choice, or is not there."""

    ratio: Positive = Field(1.0, description="input speed over output speed")
    inertia: bool = Field(False, description="whether the element has inertia")
    coulomb: CoulombLoss = Field("none", description="constant loss")
    viscous: bool = Field(False, description="loss in proportion to speed")
    quadratic: bool = Field(False, description="loss with the square of speed")
    stribeck: bool = Field(False, description="rise of constant and load loss at low speed")
    load_loss: LoadLoss = Field("none", description="loss in proportion to transmitted torque")
    motion: Motion = Field("rotary", description="whether the input turns or slides")
    subscript: str = Field("", description="LaTeX subscript of the symbols")


class LoadOptions(_Options):
    """The load; what is left out keeps the preset's choice, or is not there."""

    inertia: bool = Field(False, description="whether the load has an inertia of its own")
    first_moment: bool = Field(False, description="gravity moment ml")
    gravity_angle: bool = Field(False, description="unknown angle of gravity's zero")
    gravity: Annotated[float, Field(allow_inf_nan=False), AfterValidator(_not_zero)] = Field(
        9.80665, description="m/s², negative for a joint mounted upside down"
    )
    motion: Motion = Field("rotary", description="whether the load turns or slides")


class MechanismOptions(_Options):
    """A preset with changes, or elements from motor to load."""

    preset: str | None = Field(None, description="rabbit-knee, motor-axis or servo-pendulum")
    motion: Motion | None = Field(None, description="makes every element turn, or slide")
    offset: Literal[True, False, "per-recording"] | None = Field(
        None, description="unknown constant in the motor torque; one for all, or per-recording"
    )
    gain: bool | None = Field(None, description="unknown factor of the torque constant")
    elements: dict[str, ElementOptions] = Field(
        default_factory=dict,
        description="by name; changes to a preset's elements, or a chain of one's own in order "
        "from motor to load",
    )
    load: LoadOptions = Field(default_factory=LoadOptions, description="what the joint moves")

    def chain(self) -> Chain:
        """Build the chain.

        Raises
        ------
        BadInput
            If the preset or one of its elements does not exist, or nothing is described.
        """
        if self.preset is None:
            base = Chain(elements=(Element("motor"),), load=Load())
            elements = [Element(name, **o.model_dump()) for name, o in self.elements.items()]
            if not elements:
                raise BadInput(
                    "mechanism", "describes no joint", f"set preset to one of {', '.join(PRESETS)}"
                )
        else:
            if self.preset not in PRESETS:
                raise BadInput(
                    "mechanism.preset",
                    f"there is no preset {self.preset!r}",
                    nearest(self.preset, PRESETS),
                )
            base = PRESETS[self.preset].chain()
            names = [element.name for element in base.elements]
            for name in self.elements:
                if name not in names:
                    raise BadInput(
                        f"mechanism.elements.{name}",
                        f"{self.preset} has no such element",
                        nearest(name, names),
                    )
            elements = [
                _changed(element, self.elements[element.name].given())
                if element.name in self.elements
                else element
                for element in base.elements
            ]
        load = _changed(base.load, self.load.given())
        if self.motion is not None:
            elements = [_changed(element, {"motion": self.motion}) for element in elements]
            load = _changed(load, {"motion": self.motion})
        if load.motion == "linear" and (load.first_moment or load.gravity_angle):
            raise BadInput(
                "mechanism.load.first_moment",
                "a sliding load has no gravity moment",
                "set first_moment = false; a constant weight is what offset = true is for",
            )
        try:
            return Chain(
                elements=tuple(elements),
                load=load,
                offset=base.offset if self.offset is None else bool(self.offset),
                gain=base.gain if self.gain is None else self.gain,
                preset=self.preset or "",
            )
        except ValueError as error:
            raise BadInput("mechanism.elements", str(error), "rename the element") from None


def _changed(item: Any, changes: dict[str, Any]) -> Any:
    return type(item)(**{**vars(item), **changes})
