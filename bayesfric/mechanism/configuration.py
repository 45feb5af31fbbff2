"""The ``[mechanism]`` table of a configuration, and the joint it describes.

Tables of elements and load have a key for each option of the table of quantities, so a new term
needs no line here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    Field,
    ValidationInfo,
    create_model,
    field_validator,
)

from bayesfric.base.errors import BadInput, Unfit, nearest
from bayesfric.base.options import Options
from bayesfric.mechanism.element import STANDARD_GRAVITY, Element
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.mechanism.own_term import Term
from bayesfric.mechanism.quantities import (
    CHOICES,
    CYCLES,
    LOAD_CHOICES,
    OPTION_MEANINGS,
    Motion,
)


def _not_zero(value: float) -> float:
    if value == 0.0:
        raise Unfit("a number other than 0", f"got {value:g}")
    return value


Cycles = Annotated[int, Field(strict=True, ge=1)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _Options(Options):
    def settings(self) -> dict[str, Any]:
        """Keys that the configuration sets; the preset's values count for the others."""
        return self.model_dump(exclude_unset=True)


class _Element(_Options):
    """One element; what is left out keeps the preset's choice."""

    ratio: Positive = Field(1.0, description="input speed over output speed")
    motion: Motion = Field("rotary", description="whether the input turns or slides")
    subscript: str = Field("", description="LaTeX subscript of the symbols")


class _Load(_Options):
    """The load; what is left out keeps the preset's choice."""

    gravity: Annotated[float, Field(allow_inf_nan=False), AfterValidator(_not_zero)] = Field(
        STANDARD_GRAVITY,
        description="of the earth, m/s²; negative for a joint mounted upside down",
    )
    motion: Motion = Field("rotary", description="whether the load turns or slides")
    signals: tuple[str, ...] = Field(
        (),
        description="names of further columns (others of the recording): torques of the load that "
        "are known up to a coefficient, load.<name>",
        examples=[("tool_torque",)],
    )


def _fields(options: Mapping[str, Mapping[str | bool, str]]) -> dict[str, Any]:
    """Make the fields of a table's options: true or false, or a choice of words."""
    fields: dict[str, Any] = {}
    for option, choices in options.items():
        words = tuple(choice for choice in choices if isinstance(choice, str))
        kind: Any = bool | Literal[words] if words else bool
        if True not in choices:
            kind = Literal[("none", *words)]
        default = False if True in choices else "none"
        fields[option] = (kind, Field(default, description=OPTION_MEANINGS[option]))
    for option in CYCLES:
        field = Field((), description=OPTION_MEANINGS[option], examples=[(1, 7, 42)])
        fields[option] = (tuple[Cycles, ...], field)
    return fields


if TYPE_CHECKING:

    class ElementOptions(_Element):
        """With the options of an element."""

    class LoadOptions(_Load):
        """With the options of the load."""

else:  # the options are those of the table of quantities
    ElementOptions = create_model("ElementOptions", __base__=_Element, **_fields(CHOICES))
    LoadOptions = create_model("LoadOptions", __base__=_Load, **_fields(LOAD_CHOICES))


class MechanismOptions(_Options):
    """A preset with changes, or elements from motor to load."""

    preset: str | None = Field(
        None,
        description="joint to begin with: "
        + "; ".join(f"{p.name}, {p.meaning}" for p in PRESETS.values()),
        json_schema_extra={"enum": list(PRESETS)},
    )
    motion: Motion | None = Field(None, description="makes every element turn, or slide")
    offset: Literal[True, False, "per-recording"] | None = Field(
        None, description="unknown constant in the motor torque; one for all, or per-recording"
    )
    gain: bool | None = Field(None, description="unknown factor of the torque constant")
    delay: bool | None = Field(
        None,
        description="unknown time by which the recorded position comes after the torque; of a "
        "torque that is computed from a target, by which the drive acts late on it: then unknown "
        "unless this is false",
    )
    elements: dict[str, ElementOptions] = Field(
        default_factory=dict,
        description="by name; changes to a preset's elements, or a custom chain in order "
        "from motor to load",
    )
    load: LoadOptions = Field(default_factory=LoadOptions, description="what the joint moves")
    terms: Literal["auto", "as written"] | tuple[str, ...] = Field(
        "as written",
        description="auto puts in what else explains the torque before it is fitted; or names of "
        "custom terms: functions, which only Python can give",
    )

    @field_validator("elements")
    @classmethod
    def _of_preset(
        cls, elements: dict[str, ElementOptions], info: ValidationInfo
    ) -> dict[str, ElementOptions]:
        """Drop tables that change nothing, as templates have them, also of another preset."""
        if info.data.get("preset") is None:
            return elements
        return {name: options for name, options in elements.items() if options.settings()}

    @property
    def auto(self) -> bool:
        """Whether what else explains the torque is put in before a fit, ``terms = "auto"``."""
        return self.terms == "auto"

    @property
    def named_terms(self) -> tuple[str, ...]:
        """Names of custom terms, which only Python can give; empty for a word."""
        return () if isinstance(self.terms, str) else self.terms

    def joint(self, terms: Sequence[Term] = ()) -> Joint:
        """Build the joint."""
        if missing := [
            name for name in self.named_terms if name not in {term.name for term in terms}
        ]:
            raise BadInput(
                "mechanism.terms",
                f"{missing[0]} is a custom term, a function that no file holds",
                "fit it in Python: bayesfric.Model.from_config(path, terms=[bayesfric.Term(...)])",
            )
        base, elements = self._elements()
        load = replace(base.load, **self.load.settings())
        if self.motion is not None:
            elements = [replace(element, motion=self.motion) for element in elements]
            load = replace(load, motion=self.motion)
        for element in elements:
            of_load = [option for option in element.choices if option.startswith("load_")]
            if of_load and "load_loss" not in of_load:
                # reports and exports of friction depend on the loss that these change
                raise BadInput(
                    f"mechanism.elements.{element.name}.{of_load[0]}",
                    "changes load-dependent friction, and there is none",
                    'set load_loss = "one", too; where no part of the loss is in proportion '
                    f'to the torque, "{element.name}.load" = 0 under [priors]',
                )
        if load.motion == "linear" and load.has("first_moment", "gravity_angle"):
            raise BadInput(
                "mechanism.load.first_moment",
                "a sliding load has no gravity moment",
                "set first_moment = false; a constant weight is what offset = true is for",
            )
        try:
            return Joint(
                elements=tuple(elements),
                load=load,
                offset=base.offset if self.offset is None else bool(self.offset),
                gain=base.gain if self.gain is None else self.gain,
                delay=base.delay if self.delay is None else self.delay,
                made_from=self.preset or "",
                terms=tuple(terms),
            )
        except ValueError as error:
            raise BadInput("mechanism.elements", str(error), "rename the element") from None

    def _elements(self) -> tuple[Joint, list[Element]]:
        """Return the preset, or an empty one, and its elements with their changes."""
        if self.preset is None:
            elements = [Element(name, **o.model_dump()) for name, o in self.elements.items()]
            if not elements:
                raise BadInput(
                    "mechanism", "describes no joint", f"set preset to one of {', '.join(PRESETS)}"
                )
            return Joint((Element("motor"),)), elements
        if self.preset not in PRESETS:
            raise BadInput(
                "mechanism.preset",
                f"there is no preset {self.preset!r}",
                nearest(self.preset, PRESETS),
            )
        base = Joint.preset(self.preset)
        changes = {name: options.settings() for name, options in self.elements.items()}
        names = [element.name for element in base.elements]
        for name in changes:
            if name not in names:
                raise BadInput(
                    f"mechanism.elements.{name}",
                    f"{self.preset} has no such element",
                    nearest(name, names),
                )
        return base, [replace(e, **changes.get(e.name, {})) for e in base.elements]
