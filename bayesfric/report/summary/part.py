"""What every piece of ``summary.json`` is: checked when it is read, and written as it was set."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from bayesfric.configuration_errors import configuration_error
from bayesfric.errors import BadInput

# JSON has lists only; a pair is one with a low and a high end.
Pair = Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]
NotNegative = Annotated[FiniteFloat, Field(ge=0.0)]
Share = Annotated[FiniteFloat, Field(ge=0.0, le=1.0)]
Bound = Literal["lower", "upper"]
Name = Annotated[str, Field(min_length=1)]


class Part(BaseModel):
    """A piece of a summary. What is not set is not written: a run read and written is the same."""

    # what other versions add is none of ours; what they lack has a default
    model_config = ConfigDict(frozen=True, extra="ignore", strict=True, populate_by_name=True)

    @classmethod
    def read(cls, found: Self | Mapping[str, Any], where: str = "summary.json") -> Self:
        """Check what a file, called ``where`` in complaints, or a piece of the package tells.

        What is one already is given back. BadInput, naming the key, where something is missing or
        of another type.
        """
        if isinstance(found, cls):
            return found
        try:
            return cls.model_validate(found)
        except ValidationError as error:
            said = configuration_error(f"{where}: ", "configuration", error, found, cls)
            mend = "name a run that 'bayesfric fit' wrote, or fit it again"
            raise BadInput(said.where, said.what, mend) from None

    def as_dict(self) -> dict[str, Any]:
        """Give strings, numbers, lists and dicts, as JSON has them."""
        return self.model_dump(mode="json", exclude_unset=True, by_alias=True)


class Open(Part):
    """A piece that keeps keys of its own."""

    model_config = ConfigDict(frozen=True, extra="allow", strict=True)


class Described(Part):
    """What a quantity is; the symbol is LaTeX without dollar signs."""

    unit: str
    symbol: str = ""
    meaning: str = ""
