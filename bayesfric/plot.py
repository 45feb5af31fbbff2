"""The figures of a report, one function each: ``bayesfric.plot.friction(posterior)``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from matplotlib.figure import Figure

from bayesfric.base.errors import BadInput, nearest
from bayesfric.fit.result import result_of
from bayesfric.report.figures.prediction import rollout_figure
from bayesfric.report.figures.registry import RUN_FIGURES
from bayesfric.results.roll_out import RollOut


def rollout(result: RollOut) -> Figure:
    """Draw what :func:`bayesfric.rollout` gives: measured positions in their bands."""
    return rollout_figure(result)


def __getattr__(name: str) -> Callable[[Any], Figure]:
    if name.startswith("__") or name not in RUN_FIGURES:
        raise AttributeError(f"there is no figure {name!r}; {nearest(name, RUN_FIGURES)}")

    def draw(posterior: Any) -> Figure:
        result = result_of(posterior)
        figure = RUN_FIGURES[name].draw(result.fit, result.summary)
        if figure is None:
            raise BadInput(f"plot.{name}", "there is nothing to show", "draw another figure")
        return figure

    draw.__name__ = draw.__qualname__ = name
    draw.__doc__ = f"Draw {name.replace('_', ' ')} of what :meth:`bayesfric.Model.sample` returned."
    return draw


def __dir__() -> list[str]:
    return sorted({*RUN_FIGURES, "rollout"})
