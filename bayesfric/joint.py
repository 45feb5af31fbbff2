"""A joint, by name or made of elements."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from typing import Any, Self

from bayesfric.errors import BadInput, nearest
from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.presets import PRESETS


class Joint(Chain):
    """Elements from the motor to the load; see :class:`bayesfric.mechanism.chain.Chain`."""

    def __init__(self, elements: Iterable[Element], load: Load | None = None, **more: Any) -> None:
        super().__init__(tuple(elements), load or Load(), **more)

    @classmethod
    def preset(cls, name: str) -> Self:  # type: ignore[override]
        """Make the joint of that name.

        Raises
        ------
        BadInput
            If there is none.
        """
        if name not in PRESETS:
            raise BadInput("preset", f"there is no preset {name!r}", nearest(name, PRESETS))
        return cls(**vars(PRESETS[name].chain()))

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{escape(p.name)}</td><td>{escape(p.unit)}</td><td>{escape(p.meaning)}</td></tr>"
            for p in self.parameters
        )
        return f"<table><tbody>{rows}</tbody></table>"
