"""Draws of the joint's numbers and of all parameters, a row each, to randomise simulations by."""

from __future__ import annotations

from bayesfric.base.errors import BadInput
from bayesfric.export.joint_model import NUMBERS
from bayesfric.export.format import Content, Files, Format


def _write(content: Content) -> Files:
    import pandas as pd

    chain, vectors, wanted = content.found.joint, content.vectors.draws, content.options.draws
    if wanted is not None and wanted > len(vectors):
        has = f"is {wanted}, and the run has {len(vectors)}"
        raise BadInput("--draws", has, "ask for fewer, or fit with more steps")
    columns = {(name, NUMBERS[name].unit(chain)): x for name, x in content.draws.items()}
    columns |= {(p.name, p.unit): x for p, x in zip(chain.parameters, vectors.T, strict=True)}
    # what the numbers lose is told in export.json: many readers take no remarks
    named = {f"{name} [{unit}]" if unit else name: x for (name, unit), x in columns.items()}
    return {"draws.csv": pd.DataFrame(named).to_csv(index=False).encode()}


FORMATS = (
    Format(
        name="csv",
        meaning="a CSV table of draws",
        names={name: name for name in NUMBERS},
        write=_write,
        options=frozenset({"draws"}),
    ),
)
