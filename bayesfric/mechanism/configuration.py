"""The ``[mechanism]`` table of a configuration, and the joint it describes.

Tables of elements and load have a key for each option of the table of quantities, so a new term
needs no line here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from pydantic import AfterValidator, Field, ValidationInfo, create_model, field_validator

from bayesfric.base.errors import BadInput, Unfit, nearest
from bayesfric.base.options import Options
from bayesfric.mechanism.element import STANDARD_GRAVITY, Element
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.mechanism.own_term import Term
from bayesfric.mechanism.quantities import CHOICES, CYCLE_MEANINGS, LOAD_CHOICES, Motion


def _not_zero(value: float) -> float:
    if value == 0.0:
        raise Unfit("a number other than 0", f"got {value:g}")
    return value


Cycles = Annotated[int, Field(strict=True, ge=1)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


def _fields(options: Mapping[str, tuple[tuple[str | bool, ...], str]]) -> dict[str, Any]:
    """Make the fields of a table's options: true or false, or a choice of words."""
    fields: dict[str, Any] = {}
    for option, (choices, meaning) in options.items():
        words = tuple(choice for choice in choices if isinstance(choice, str))
        kind: Any = Literal[words] if words else bool
        default: bool | str = False
        if True not in choices:
            kind, default = Literal[("none", *words)], "none"
        elif words:
            kind = bool | Literal[words]
        fields[option] = (kind, Field(default, description=meaning))
    for option, meaning in CYCLE_MEANINGS.items():
        examples = [(1, 7, 42)]
        fields[option] = (tuple[Cycles, ...], Field((), description=meaning, examples=examples))
    return fields


if TYPE_CHECKING:
    ElementOptions: TypeAlias = Options
    LoadOptions: TypeAlias = Options
else:  # the options are those of the table of quantities; what is left out keeps the preset's
    ElementOptions = create_model(
        "ElementOptions",
        __base__=Options,
        ratio=(Positive, Field(1.0, description="input speed over output speed")),
        motion=(Motion, Field("rotary", description="whether the input turns or slides")),
        subscript=(str, Field("", description="LaTeX subscript of the symbols")),
        **_fields(CHOICES),
    )
    LoadOptions = create_model(
        "LoadOptions",
        __base__=Options,
        gravity=(
            Annotated[float, Field(allow_inf_nan=False), AfterValidator(_not_zero)],
            Field(
                STANDARD_GRAVITY,
                description="of the earth, m/s²; negative for a joint mounted upside down",
            ),
        ),
        motion=(Motion, Field("rotary", description="whether the load turns or slides")),
        signals=(
            tuple[str, ...],
            Field(
                (),
                description="names of further columns (others of the recording): torques of the "
                "load that are known up to a coefficient, load.<name>",
                examples=[("tool_torque",)],
            ),
        ),
        **_fields(LOAD_CHOICES),
    )


class MechanismOptions(Options):
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

    def joint(self, terms: Sequence[Term] = ()) -> Joint:
        """Build the joint."""
        known = {term.name for term in terms}
        names = () if isinstance(self.terms, str) else self.terms
        if missing := [name for name in names if name not in known]:
            raise BadInput(
                "mechanism.terms",
                f"{missing[0]} is a custom term, a function that no file holds",
                "fit it in Python: bayesfric.Model.from_config(path, terms=[bayesfric.Term(...)])",
            )
        base = self._base()
        moves = {} if self.motion is None else {"motion": self.motion}
        load = replace(base.load, **self.load.settings() | moves)
        changes = {name: options.settings() for name, options in self.elements.items()}
        elements = [replace(e, **changes.get(e.name, {}) | moves) for e in base.elements]
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
            return replace(
                base,
                elements=tuple(elements),
                load=load,
                offset=base.offset if self.offset is None else bool(self.offset),
                gain=bool(self.gain),
                delay=self.delay,
                terms=tuple(terms),
            )
        except ValueError as error:
            raise BadInput("mechanism.elements", str(error), "rename the element") from None

    def _base(self) -> Joint:
        """Return the preset, or a joint of the bare elements."""
        key, names = "mechanism", list(self.elements)
        if self.preset is None:
            if not names:
                hint = f"set preset to one of {', '.join(PRESETS)}"
                raise BadInput(key, "describes no joint", hint)
            try:
                return Joint([Element(name) for name in names])
            except ValueError as error:
                raise BadInput(f"{key}.elements", str(error), "rename the element") from None
        if self.preset not in PRESETS:
            problem = f"there is no preset {self.preset!r}"
            raise BadInput(f"{key}.preset", problem, nearest(self.preset, PRESETS))
        base = PRESETS[self.preset].chain()
        known = [element.name for element in base.elements]
        for name in names:
            if name not in known:
                problem = f"{self.preset} has no such element"
                raise BadInput(f"{key}.elements.{name}", problem, nearest(name, known))
        return base
