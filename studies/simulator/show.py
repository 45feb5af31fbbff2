"""Tables and figure of the comparison."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from bayesfric.report.figures.style import COLUMN, PALETTE, paper_style, save

_LINES = ("solid", (0, (4.0, 1.5)), (0, (5.0, 1.5, 1.0, 1.5)), (0, (1.0, 1.0)))

METHODS = ("RK45", "DOP853", "LSODA", "Radau")


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def order_table(rows: Sequence[dict[str, Any]]) -> str:
    head = ["error (rad), 100 Hz", *(f"{n} steps" for n in rows[0]["substeps"]), "orders"]
    body = [
        [r["case"], *(f"{e:.1e}" for e in r["errors"]), ", ".join(f"{o:.1f}" for o in r["orders"])]
        for r in rows
    ]
    return table(head, body)


def agreement_table(rows: Sequence[dict[str, Any]]) -> str:
    head = ["case", "rate (Hz)", "reversals", "power-flow changes", "sticks (% of samples)"]
    head += ["steps chosen", "reported step error (rad)", "true error (rad)", "true error (rad/s)"]
    head += ["encoder / true error", "64 steps: error (rad)"]
    body = []
    for r in rows:
        cells = [r["case"], r["rate"], r["reversals"], r["turns"], f"{100 * r['sticking']:.1f}"]
        cells += [r["substeps"], *(f"{r[k]:.1e}" for k in ("step_error", "error", "error_qd"))]
        cells += [f"{r['encoder_over_error']:.0e}", f"{r['error_finest']:.1e}"]
        body.append(cells)
    return table(head, body)


def speed_table(rows: Sequence[dict[str, Any]]) -> str:
    head = ["case", "required (rad)", "fastest `solve_ivp`", "error (rad)", "ms (compiled)"]
    head += ["`simulate`", "error (rad)", "ms", "ratio (compiled)"]
    head += ["bare", "error (rad)", "ms", "ratio (compiled)"]
    body = []
    for r in rows:
        named = r["level"][0] != "1"  # other levels are numbers
        required = f"{r['rad']:.1e}, {r['level']}" if named else r["level"]
        rival = r["rival"]
        cells = [
            f"{r['case']}, {r['rate']} Hz",
            required,
            rival["setting"],
            f"{rival['error']:.0e}",
        ]
        cells += [f"{1e3 * rival['seconds']:.0f} ({1e3 * r['compiled']:.0f})"]
        for key in ("simulate", "bare"):
            cells += [r[key]["setting"], f"{r[key]['error']:.0e}"]
            cells += [f"{1e3 * r[key]['seconds']:.2f}"]
            cells += [f"**{r[f'{key}_ratio']:.0f}** ({r[f'{key}_ratio_compiled']:.0f})"]
        body.append(cells)
    return table(head, body)


def front(points: Sequence[Any]) -> tuple[list[float], list[float]]:
    """Return errors and times (ms) of the Pareto-optimal settings."""
    errors, times, smallest = [], [], math.inf
    for p in sorted(points, key=lambda p: p.seconds):
        if p.error < smallest:
            smallest = p.error
            errors.append(p.error)
            times.append(1e3 * p.seconds)
    return errors, times


def draw(panels: Sequence[tuple[str, dict[str, Any]]], encoder: float, folder: Path) -> None:
    """Draw the work-precision diagram: largest error against time, logarithmic."""
    with paper_style():
        figure = Figure(figsize=(COLUMN, 4.4), layout="constrained")
        axes = figure.subplots(len(panels), 1, sharex=True, sharey=True)
        for ax, (text, comparison) in zip(axes, panels, strict=True):
            for k, method in enumerate(METHODS):
                settings = [p for p in comparison["points"] if p.options[0] == method]
                colour = PALETTE[(1, 2, 3, 2)[k]]
                ax.plot(
                    *front(settings), marker="s^Dv"[k], ms=3, color=colour, ls=_LINES[k], mfc="w"
                )
            for key, fill in (("full", PALETTE[0]), ("bare", "w")):
                ax.plot(
                    *front(comparison[key]), marker="o", ms=3.5, color=PALETTE[0], mfc=fill, lw=1.2
                )
            ax.axvline(encoder, color="0.5", lw=0.6, zorder=0)
            ax.annotate(text, (0.03, 0.96), xycoords="axes fraction", va="top")
            ax.set(
                xscale="log", yscale="log", xlim=(1e-14, 1e-2), ylim=(0.1, 1e4), ylabel="time (ms)"
            )
        axes[-1].set_xlabel("largest error of position (rad)")
        names = [*(f"solve_ivp, {m}" for m in METHODS), "simulate", "one bare integration"]
        figure.legend(axes[0].lines[:6], names, loc="outside upper center", ncols=2)
        axes[0].annotate(
            "one count\nof the encoder",
            (encoder, 0.96),
            xycoords=("data", "axes fraction"),
            xytext=(3, 0),
            textcoords="offset points",
            va="top",
            fontsize=6,
        )
        folder.mkdir(parents=True, exist_ok=True)
        save(figure, folder, "work-precision")
