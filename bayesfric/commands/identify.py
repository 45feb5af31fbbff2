"""``bayesfric identify``: what the recordings can and cannot tell, before sampling."""

from __future__ import annotations

from typing import Any

from bayesfric.identifiability.identification import Identification
from bayesfric.identifiability.sentences import page
from bayesfric.model import Model


def identify_record(found: Identification, model: Model) -> dict[str, Any]:
    """Put an identification into the form that ``--json`` prints; what is infinite is ``None``."""
    return {"config": str(model.config.path), **found.as_json()}


def identify_text(found: Identification, model: Model) -> list[str]:
    """Word an identification for a person: first what cannot be told, then the tables."""
    unit = "rad" if model.chain.load.motion == "rotary" else "m"
    return page("identify.txt", found=found, unit=unit)
