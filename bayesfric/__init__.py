"""What a measured motor torque says about a joint, as posteriors.

A :class:`Joint` is made of :class:`Element` and :class:`Load`, a :class:`Recording` of files,
arrays or a table; a :class:`Model` of both answers every question, and :func:`check` says what
looks wrong beforehand. What it samples goes to :func:`summary`, :mod:`plot`, :func:`report` and
:func:`export`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bayesfric import plot
    from bayesfric.checked import check
    from bayesfric.export.exported import export
    from bayesfric.fleet.fleet import Fleet
    from bayesfric.mechanism.element import Element, Load
    from bayesfric.mechanism.joint import Joint
    from bayesfric.mechanism.own_term import Term
    from bayesfric.model import Model
    from bayesfric.recordings.recording import Recording
    from bayesfric.result import report, summary
    from bayesfric.rollouts.rollout import rollout

__version__ = "0.1.0"
__all__ = [
    "Element", "Fleet", "Joint", "Load", "Model", "Recording", "Term", "check", "export", "plot",
    "report", "rollout", "summary",
]  # fmt: skip

# Imported when first used: the command line must answer --help at once.
_HOMES = {
    "Element": "mechanism.element",
    "Fleet": "fleet.fleet",
    "Joint": "mechanism.joint",
    "Load": "mechanism.element",
    "Model": "model",
    "Recording": "recordings.recording",
    "Term": "mechanism.own_term",
    "check": "checked",
    "export": "export",
    "plot": "plot",
    "report": "report",
    "rollout": "rollouts.rollout",
    "summary": "result",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'bayesfric' has no attribute {name!r}")
    home = import_module(f"bayesfric.{_HOMES[name]}")
    # modules stay: plot holds the figures, and report can be called
    found = globals()[name] = home if name == _HOMES[name] else getattr(home, name)
    return found


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
