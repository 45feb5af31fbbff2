"""The draws of a finished run, read back from ``posterior.nc`` and checked against its summary."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.errors import BadInput
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.joint import Joint
from bayesfric.opened import array_of, opened_hdf5
from bayesfric.recordings.arrays import Array
from bayesfric.report.summary.record import Summary

# More draws change no interval that could be seen.
_MOST = 200_000


@dataclass(frozen=True)
class RunDraws:
    """What a run drew."""

    # `(n,)` draws in the quantity's unit, by its name: the sampled parameters and the derived
    # quantities that no scaling of leg parameters and alpha changes
    values: Mapping[str, Array] = field(default_factory=dict)
    # of the parameters' priors, `(m,)` each
    prior: Mapping[str, Array] = field(default_factory=dict)


def read_draws(run: Path, summary: Summary, rebuild: Callable[[str], Joint | None]) -> RunDraws:
    """Read the draws of what a run's checked summary tells; none where there are none to read.

    Those with room for the model's error where the run holds such, as its tables do. Totals as
    least squares would see them need the recordings and are never among them. ``rebuild`` makes the
    chain from the text of the run's configuration; where it cannot, derived quantities are left
    out.
    """
    try:
        with opened_hdf5(run / "posterior.nc") as file:
            group = file["told" if "told" in file else "posterior"]
            known = {**summary.derived, **summary.parameters}
            found = {name: _flat(group[name]) for name in known if name in group}
            before = file.get("prior", {})
            prior = {name: _flat(before[name]) for name in found if name in before}
            config = str(file.attrs.get("config", ""))
    except BadInput:
        return RunDraws()
    sampled = {name: x for name, x in found.items() if name in summary.parameters}
    found = _derived(rebuild(config), sampled, summary) | found
    return RunDraws({name: x for name, x in found.items() if np.isfinite(x).any()}, prior)


def _flat(stored: Any) -> Array:
    """Lay chains and draws of a data set out in a row, evenly thinned where there are many."""
    x = np.asarray(array_of(stored), dtype=np.float64).ravel()
    if x.size == 0:
        raise ValueError("no draws")
    return x[:: -(-x.size // _MOST)]


def _derived(
    chain: Joint | None, sampled: Mapping[str, Array], summary: Summary
) -> dict[str, Array]:
    """Derive what no scaling changes, draw by draw."""
    if chain is None:
        return {}
    known = {name: row.value for name, row in summary.fixed.items()}
    # recordings with an offset each are named by the draws, not by the configuration
    own = [name.partition(".")[2] for name in (*sampled, *known) if name.startswith("offset.")]
    if own:
        chain = replace(chain, own_offsets=tuple(own))
    n = {x.size for x in sampled.values()}
    if len(n) != 1 or not all(name in sampled or name in known for name in chain.names):
        return {}
    columns = [
        sampled[name] if name in sampled else np.full(max(n), known[name]) for name in chain.names
    ]
    with np.errstate(divide="ignore", invalid="ignore"):
        # at no load: efficiencies change with the scale anyway
        found = derive(chain, np.stack(columns, axis=1), 0.0)
    return {q.name: q.values for q in found if q.gauge_free and q.name in summary.derived}
