"""Draws of the joint's numbers, a row each: CSV and NPZ, to randomise simulations by."""

from __future__ import annotations

import io
from collections.abc import Callable

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.export.at_joint import NUMBERS
from bayesfric.export.format import Content, Format
from bayesfric.recordings.arrays import Array


def _table(content: Content) -> tuple[dict[str, Array], dict[str, str]]:
    """Columns by name, and their units."""
    chain, wanted = content.found.joint, content.options.draws
    if wanted is not None and wanted > len(content.vectors.draws):
        has = f"is {wanted}, and the run has {len(content.vectors.draws)}"
        raise BadInput("--draws", has, "ask for fewer, or fit with more steps")
    columns = dict(content.draws)
    units = {name: NUMBERS[name].unit(chain) for name in columns}
    for p, values in zip(chain.parameters, content.vectors.draws.T, strict=True):
        columns[p.name], units[p.name] = values, p.unit
    return columns, units


def _csv(content: Content) -> bytes:
    import pandas as pd

    columns, units = _table(content)
    # what the numbers lose is told in export.json: many readers take no remarks
    named = {f"{name} [{units[name]}]" if units[name] else name: x for name, x in columns.items()}
    return pd.DataFrame(named).to_csv(index=False).encode()


def _npz(content: Content) -> bytes:
    columns, units = _table(content)
    sink = io.BytesIO()
    told = {"names": list(columns), "units": list(units.values()), "remarks": content.remarks}
    np.savez(sink, allow_pickle=False, **{k: np.array(v) for k, v in told.items()}, **columns)
    return sink.getvalue()


def _format(suffix: str, meaning: str, write: Callable[[Content], bytes]) -> Format:
    return Format(
        name=suffix,
        meaning=f"{meaning} of draws",
        names={name: name for name in NUMBERS},
        write=lambda content: {f"draws.{suffix}": write(content)},
        options=frozenset({"draws"}),
    )


FORMATS = (
    _format("csv", "a CSV table", _csv),
    _format("npz", "an NPZ archive", _npz),
)
