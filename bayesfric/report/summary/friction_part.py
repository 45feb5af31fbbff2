"""Friction at recorded speeds, for ``summary.json``, terminal and page."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.stats import norm

from bayesfric.identifiability.friction_curve import (
    friction_curves,
    friction_torque,
)
from bayesfric.inference.fitting import Fit
from bayesfric.report.numbers import Medium
from bayesfric.report.summary.record import Friction, FrictionRow, Summary
from bayesfric.results.reported import LEVEL, Status

# Of the sizes of recorded speeds: those in summary.json, and of them those that are printed.
QUANTILES, PRINTED = (0.1, 0.25, 0.5, 0.75, 0.95), (0.1, 0.5, 0.95)


def friction_part(fit: Fit, summary: Summary) -> Friction | None:
    """Tabulate friction at recorded speeds; ``None`` where none of its parameters was sampled.

    A doubt in ``summary`` about a parameter of friction concerns friction.
    """
    wide, rotary = fit.wide, fit.chain.motor_motion == "rotary"
    curves = friction_curves(wide, QUANTILES)
    median = wide.target.chain_values(wide.posterior.median[None])
    columns = [fit.chain.names.index(name) for name in fit.target.free]
    without = np.repeat(median, len(columns), axis=0)
    without[np.arange(len(columns)), columns] = 0.0
    names = set()
    for curve in curves:
        every = np.concatenate([median, without])
        at = curve.speed[curve.shown], curve.load[curve.shown]
        torque = friction_torque(fit.chain, every, *at, open_scale=True)
        changed = (torque[1:] != torque[0]).any(axis=1)
        names |= {n for n, c in zip(fit.target.free, changed, strict=True) if c}
    if not names:
        return None
    sampled: Status = "doubtful" if any(summary.rows[n].doubtful for n in names) else "identified"
    unusable = summary.sampler.status == "unusable"
    rows = [
        FrictionRow(
            speed=float(curve.speed[k]),
            quantile=QUANTILES[k % len(QUANTILES)],
            load=float(curve.load[k]),
            value=float(curve.median[k]),
            interval=[float(curve.ends[0, k]), float(curve.ends[2, k])],
            status=sampled if curve.determined[k] and not unusable else "unidentified",
        )
        for curve in curves
        for k in np.flatnonzero(curve.shown)
    ]
    return Friction(
        unit="N m" if rotary else "N",
        speed_unit="rad/s" if rotary else "m/s",
        level=LEVEL,
        parameters=[name for name in fit.target.free if name in names],
        rows=rows,
    )


def friction_cells(friction: Friction | None, medium: Medium) -> Iterator[tuple[str, ...]]:
    """Write speed, load, value, interval and status of the rows to print.

    Both directions share a row where the law is symmetric.
    """
    rows = [r for r in friction.rows if r.quantile in PRINTED] if friction else []
    by_place = {(row.speed, row.load): row for row in rows}
    for row in rows:
        other = by_place.get((-row.speed, row.load))
        same = other is not None and np.allclose(
            [row.value, *row.interval], [other.value, *other.interval], rtol=1e-9, atol=0.0
        )
        if same and row.speed < 0.0:
            continue
        speed = ("±" if same else "") + medium.number(row.speed, 3)
        load = medium.number(row.load, 3) if row.load else ""
        low, high = row.interval
        sd = (high - low) / (2.0 * float(norm.ppf(0.5 + 0.5 * LEVEL)))
        if row.status == "unidentified" or not (math.isfinite(sd) and sd > 0.0):
            yield speed, load, "", "", row.status
        else:
            value = medium.ends(row.value, low, high, sd)
            yield speed, load, value, medium.interval(low, high, sd), row.status
