"""What ``page.json`` holds, made of a fit."""

from __future__ import annotations

import json

from bayesfric.inference.fitting import Fit
from bayesfric.report.answers.calculator import calculator
from bayesfric.report.answers.record import Answers
from bayesfric.report.answers.stretch import stretch


def answers_json(fit: Fit) -> str:
    """Put together what only the page shows: the joint's law with draws, the worst seconds."""
    found = Answers(calculator=calculator(fit), stretch=stretch(fit))
    return json.dumps(found.as_dict(), ensure_ascii=False, allow_nan=False) + "\n"
