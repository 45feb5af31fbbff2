"""What a measured motor torque says about a joint, as posteriors.

A :class:`Joint` is made of :class:`Element` and :class:`Load`, a :class:`Recording` of files,
arrays or a table; a :class:`Model` of both answers every question, :func:`check` says what looks
wrong beforehand, and :func:`pool` fits recordings that differ in some parameters. What it samples
goes to :func:`summary`, :mod:`plot`, :func:`report` and :func:`export`.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from bayesfric.base import __version__ as __version__

if TYPE_CHECKING:
    from bayesfric import plot
    from bayesfric.arm.arm import Arm
    from bayesfric.base.errors import BadInput
    from bayesfric.export.exported import export
    from bayesfric.fit.check_report import check
    from bayesfric.fit.model import Model
    from bayesfric.fit.pooled_fit import pool
    from bayesfric.fit.result import report, summary
    from bayesfric.fleet.fleet import Fleet
    from bayesfric.mechanism.element import Element, Load
    from bayesfric.mechanism.experiment import simulate
    from bayesfric.mechanism.joint import Joint
    from bayesfric.mechanism.own_term import Term
    from bayesfric.recordings.source import Recording
    from bayesfric.rollouts.rollout import rollout

__all__ = [
    "Arm", "BadInput", "Element", "Fleet", "Joint", "Load", "Model", "Recording", "Term", "check",
    "export", "plot", "pool", "report", "rollout", "simulate", "summary",
]  # fmt: skip

# Imported when first used: the command line must answer --help at once.
_HOMES = {
    "Arm": "arm.arm",
    "BadInput": "base.errors",
    "Element": "mechanism.element",
    "Fleet": "fleet.fleet",
    "Joint": "mechanism.joint",
    "Load": "mechanism.element",
    "Model": "fit.model",
    "Recording": "recordings.source",
    "Term": "mechanism.own_term",
    "check": "fit.check_report",
    "export": "export.exported",
    "plot": "plot",
    "pool": "fit.pooled_fit",
    "report": "fit.result",
    "rollout": "rollouts.rollout",
    "simulate": "mechanism.experiment",
    "summary": "fit.result",
}


class _Room(ModuleType):
    """A room with the name of what it is for: ``bayesfric.report(posterior, folder)``."""

    def __call__(self, *given: Any, **named: Any) -> Any:
        name = self.__name__.rpartition(".")[2]
        return getattr(import_module(f"bayesfric.{_HOMES[name]}"), name)(*given, **named)


class _Face(ModuleType):
    def __setattr__(self, name: str, value: Any) -> None:
        if name in ("export", "report"):  # Python puts a room here, whoever imports it
            value.__class__ = _Room
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Face


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'bayesfric' has no attribute {name!r}")
    # rooms and plot, which holds the figures, stay modules
    module = name in ("export", "plot", "report")
    home = import_module(f"bayesfric.{name if module else _HOMES[name]}")
    value = globals()[name] = home if module else getattr(home, name)
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
