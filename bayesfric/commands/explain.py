"""``bayesfric explain``: which terms the joint lacks."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bayesfric.errors import BadInput
from bayesfric.explain.explanation import Explanation, Number
from bayesfric.model import Model
from bayesfric.report.alerts import doubt_text
from bayesfric.report.figures.ladder import ladder_figure
from bayesfric.report.figures.style import save
from bayesfric.report.files import parents_made, unwritable
from bayesfric.report.numbers import text_value
from bayesfric.report.summary.doubts import little_explained
from bayesfric.report.text_templates import filled


def explain_record(found: Explanation, model: Model) -> dict[str, Any]:
    """Put an explanation into the form that ``--json`` prints."""
    return {"config": str(model.config.path), **found.as_json()}


def figure_file(path: Path) -> Path:
    """Settle where the figure goes, before anything is computed."""
    if path.suffix.lower() != ".pdf":
        raise BadInput(str(path), "is not named .pdf", "name the figure something.pdf")
    try:
        # what cannot be made is told before anything is computed
        with parents_made(path):
            return path
    except OSError as error:
        raise unwritable(path, error, "file") from None


def write_figure(found: Explanation, path: Path) -> None:
    """Draw the models, as PDF, PNG and SVG."""
    try:
        with parents_made(path), TemporaryDirectory(prefix=".", dir=path.parent) as aside:
            save(ladder_figure(found), Path(aside), path.stem)
            for made in Path(aside).iterdir():
                made.replace(path.parent / made.name)
    except OSError as error:
        raise unwritable(path, error, "file") from None


def explain_text(found: Explanation, model: Model) -> list[str]:
    """Word an explanation for a person: first the answer and what to write, then the tables."""
    # what would mend it comes first, where it was found
    wrong = [] if found.asked else little_explained(model.chain, model.observations)
    text = filled(
        "explain.txt.j2",
        found=found,
        warnings=[doubt_text({**one, "none_asked": True}) for one in wrong],
        rungs=[m for m in found.models if not m.rival],
        value=_value,
    )
    return text.splitlines()


def _value(number: Number) -> str:
    if number.at_bound:
        return f"{number.value:.5g}, on a limit"
    return "not determined" if number.sd is None else text_value(number.value, number.sd)
