"""``bayesfric explain``: which terms the joint lacks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from bayesfric.explain.explanation import Explanation, Number, Term
from bayesfric.model import Model
from bayesfric.report.numbers import text_value
from bayesfric.report.text_templates import filled


def explain_record(found: Explanation, model: Model) -> dict[str, Any]:
    """Put an explanation into the form that ``--json`` prints; what is infinite is ``None``."""
    return {"config": str(model.config.path), **found.as_json()}


def explain_text(found: Explanation) -> list[str]:
    """Word an explanation for a person: first the answer, then the tables."""
    names = dict.fromkeys(name for m in found.models for name in m.numbers)
    text = filled(
        "explain.txt.j2",
        found=found,
        rungs=[m for m in found.models if not m.rival],
        names=list(names),
        names_of=_names,
        value=_value,
        inf=math.inf,
    )
    return text.splitlines()


def _names(terms: Sequence[Term]) -> list[str]:
    return [f"{t.phrase} ({t.owner})" if t.owner else t.phrase for t in terms]


def _value(number: Number) -> str:
    if math.isnan(number.sd):
        return f"{number.value:.5g}, on a limit"
    return text_value(number.value, number.sd) if math.isfinite(number.sd) else "not determined"
