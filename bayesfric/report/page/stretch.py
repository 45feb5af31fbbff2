"""The drawing of the few seconds that stand on the first screen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from bayesfric.recordings.moving import too_slow
from bayesfric.report.answers.record import Stretch

# The drawing is stretched to its box; words stand beside it, in the page's own letters.
_WIDTH, _HEIGHT = 1000.0, 200.0
_FREE = 0.04


# Why there is nothing to see, in words beside the drawing.
GAPS = {
    "missing": "No samples here",
    "rest": f"Not compared: {too_slow()}; friction has no direction there",
    "left-out": "Left out: by exclude, valid or the like",
}


def told_gaps(told: Stretch) -> dict[str, str]:
    """Give words for the kinds of gaps that there are."""
    kinds = {gap.why for gap in told.gaps}
    return {kind: words for kind, words in GAPS.items() if kind in kinds}


# What the user left out is hatched, as in figures.
_HATCH = Markup(
    '<defs><pattern id="left-out" width="8" height="8" patternUnits="userSpaceOnUse" '
    'patternTransform="rotate(45)"><path class="hatch" d="M0 0V8"></path></pattern></defs>'
)


@dataclass(frozen=True)
class StretchDrawing:
    """A drawing, the ends of its axes, and words for its gaps."""

    markup: Markup
    low: float
    high: float
    gaps: dict[str, str]


def stretch_drawing(told: Stretch) -> StretchDrawing | None:
    """Draw measured and predicted over time; ``None`` where the numbers make no picture."""
    pieces = [np.asarray(piece) for piece in told.pieces if len({*map(len, piece)}) == 1]
    pieces = [piece for piece in pieces if piece.shape[1]]
    if not pieces:
        return None
    every = np.concatenate(pieces, axis=1)
    ends = np.concatenate([every[1], every[2] - every[3], every[2] + every[3]])
    low, high = float(ends.min()), float(ends.max())
    begin, end = told.span
    if not (high > low and end > begin):
        return None
    free = _FREE * (high - low)
    low, high = low - free, high + free

    def path(time: np.ndarray, value: np.ndarray) -> str:
        x = _WIDTH * (time - begin) / (end - begin)
        y = _HEIGHT * (high - value) / (high - low)
        return "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))

    drawn = {"band": "", "mean": "", "dots": ""}
    for time, measured, mean, half in pieces:
        there, back = path(time, mean + half), path(time[::-1], (mean - half)[::-1])
        drawn["band"] += f"M{there}L{back}Z"
        drawn["mean"] += f"M{path(time, mean)}"
        drawn["dots"] += "".join(f"M{place}h0" for place in path(time, measured).split("L"))
    words = (
        f"Measured and predicted {told.quantity} of {told.recording} from {begin:.4g} to {end:.4g} "
        f"s, between {low:.3g} and {high:.3g} {told.unit}; the residuals there have a root mean "
        f"square of {told.residual_rms:.3g} {told.unit}."
    )
    gaps_in_words = told_gaps(told)
    words += "".join(f" {text}." for text in gaps_in_words.values())
    gaps = Markup("").join(
        Markup('<path class="gap {0}"{1} d="M{2:.1f} 0H{3:.1f}V{4:g}H{5:.1f}Z"></path>').format(
            gap.why, Markup(' fill="url(#left-out)"') if gap.why == "left-out" else "",
            *(_WIDTH * (x - begin) / (end - begin) for x in gap.span), _HEIGHT,
            _WIDTH * (gap.span[0] - begin) / (end - begin),
        )
        for gap in told.gaps
    )  # fmt: skip
    lines = Markup("").join(
        Markup('<path class="{}" d="{}"></path>').format(kind, d) for kind, d in drawn.items()
    )
    head = Markup(
        '<svg viewBox="0 0 {:g} {:g}" preserveAspectRatio="none" role="img" aria-label="{}">'
    ).format(_WIDTH, _HEIGHT, words)
    if "left-out" in gaps_in_words:
        head += _HATCH
    return StretchDrawing(head + gaps + lines + Markup("</svg>"), low, high, gaps_in_words)
