"""Draws of the joint's numbers, a row each: CSV, Parquet and NPZ, to randomise simulations by."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from bayesfric.errors import BadInput
from bayesfric.export.at_joint import NUMBERS, Array
from bayesfric.export.format import Attribute, Content, Files, Format, Options
from bayesfric.mechanism.quantities import Motion

_OPTIONS = frozenset({"draws", "seed"})


def _attributes(_: Options, rotary: bool) -> Sequence[Attribute]:
    motion: Motion = "rotary" if rotary else "linear"
    return [Attribute(name, name, one.unit(motion)) for name, one in NUMBERS.items()]


def _table(content: Content) -> tuple[dict[str, Array], dict[str, str]]:
    """Columns by name, and their units."""
    wanted = content.options.draws
    if wanted is not None and wanted > len(content.vectors.draws):
        has = f"is {wanted}, and the run has {len(content.vectors.draws)}"
        raise BadInput("--draws", has, "ask for fewer, or fit with more steps")
    columns = dict(content.draws)
    units = {name: NUMBERS[name].unit_of(content.found.joint) for name in columns}
    for p, values in zip(content.found.joint.parameters, content.vectors.draws.T, strict=True):
        columns[p.name], units[p.name] = values, p.unit
    return columns, units


def _csv(content: Content) -> bytes:
    columns, units = _table(content)
    # a name has no comma, a unit no bracket
    head = [f"{name} [{units[name]}]" if units[name] else name for name in columns]
    rows = np.stack(list(columns.values()), axis=1).tolist()
    # what the numbers lose is told in export.json: many readers take no remarks
    return "\n".join([",".join(head), *(",".join(map(repr, r)) for r in rows), ""]).encode()


def _parquet(content: Content) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns, units = _table(content)
    fields = [pa.field(name, pa.float64(), metadata={"unit": units[name]}) for name in columns]
    told = {"remarks": json.dumps(list(content.remarks), ensure_ascii=False)}
    schema = pa.schema(fields, metadata=told)
    sink = io.BytesIO()
    pq.write_table(pa.table([pa.array(x) for x in columns.values()], schema=schema), sink)
    return sink.getvalue()


def _npz(content: Content) -> bytes:
    columns, units = _table(content)
    sink = io.BytesIO()
    told: dict[str, Any] = {"units": np.array(list(units.values())), "remarks": content.remarks}
    np.savez(sink, allow_pickle=False, names=np.array(list(columns)), **told, **columns)
    return sink.getvalue()


def _format(suffix: str, meaning: str, write: Callable[[Content], bytes]) -> Format:
    return Format(
        name=suffix,
        meaning=f"{meaning} of draws",
        carries=lambda _: frozenset(NUMBERS),
        supplied=frozenset(),
        attributes=_attributes,
        write=lambda content: _files(f"draws.{suffix}", write(content)),
        options=_OPTIONS,
        notes=lambda *_: ("draws",),
    )


def _files(name: str, content: bytes) -> Files:
    return {name: content}


FORMATS = (
    _format("csv", "a CSV table", _csv),
    _format("parquet", "a Parquet table", _parquet),
    _format("npz", "an NPZ archive", _npz),
)
