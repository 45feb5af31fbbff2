"""Every figure: its files' name, its title, caption and section of the page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from matplotlib.figure import Figure

from bayesfric.inference.fitting import Fit
from bayesfric.mechanism.quantities import effort_words
from bayesfric.recordings.checks import too_slow
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.figures.forest import forest_figure
from bayesfric.report.figures.posterior import corner_figure, ridge_figure
from bayesfric.report.figures.prediction import (
    MOST,
    friction_caption,
    friction_figure,
    prediction_figure,
    residual_figure,
    rollout_figure,
)
from bayesfric.report.summary.derived_quantities import LEVEL
from bayesfric.report.summary.record import Summary
from bayesfric.results.roll_out import RollOut

# Of the page of a run, and of a comparison.
Section = Literal[
    "methods", "ridge", "prediction", "roll-out", "friction", "posterior", "side-by-side",
]  # fmt: skip


@dataclass(frozen=True)
class Declared:
    """One figure."""

    stem: str  # its files' name
    title: str
    section: Section
    # of a run's fit and summary, a comparison or a roll-out; `None` where there is nothing to show
    draw: Callable[..., Figure | None]
    caption: str | Callable[..., str]  # text, or a function of what is drawn

    def caption_of(self, *drawn: Any) -> str:
        """Give the caption of one drawing."""
        return self.caption if isinstance(self.caption, str) else self.caption(*drawn)


_BARS = (
    f"Thick: {100 * LEVEL:.0f} %, accounting for correlated residuals; thin: assuming them "
    "uncorrelated, or of posteriors with model discrepancy; open symbols: not determined, "
    "dotted what fits as well."
)


def _corner_caption(_: Fit, summary: Summary) -> str:
    widened = " Densities and intervals allow for model discrepancy, as in the tables."
    return (
        f"Diagonal: posterior density with {100 * LEVEL:.0f} % interval, dashed the prior of "
        "parameters. Below: 50 % and 90 % of the draws. What the data leave open is hatched, "
        "has no interval and is not filled in its pairs: it shows prior and bounds. So is "
        "everything where the sampling has not converged. A limit has one dotted end."
        + (widened if summary.widened else "")
    )


def _rollout_caption(rollout: RollOut) -> str:
    count = len(rollout.rolled)
    which = f", {min(MOST, count)} of {count}, most inside first" if count > 1 else ""
    return (
        "Motion of the joint simulated with recordings' inputs, and the "
        f"measured position{which}. Dark: {rollout.draws} draws of "
        "the posterior, parameters alone; light: with torque that the model leaves unexplained."
    )


# Those of a fit and its summary, in the order of the page.
RUN_FIGURES = {
    figure.stem: figure
    for figure in (
        Declared(
            stem="methods",
            title="Estimates and posterior side by side",
            section="methods",
            # of a single run, whose name is nowhere shown
            draw=lambda _, summary: forest_figure(comparison({"run": summary})),
            caption=f"Every quantity by every method and by the posterior. {_BARS}",
        ),
        Declared(
            stem="ridge",
            title="The ridge: what can be scaled together without changing any torque",
            section="ridge",
            draw=lambda fit, _: ridge_figure(fit),
            caption=(
                "Draws of the posterior against the line along which no torque changes, between "
                "the ends that a passive gearbox sets. Only a known mass distinguishes them."
            ),
        ),
        Declared(
            stem="prediction",
            title="Measured and predicted",
            section="prediction",
            draw=lambda fit, _: prediction_figure(fit),
            caption=(
                "Measured outputs and the posterior predictive, noise included, with residuals "
                "below. Dashed: two standard deviations of the noise, its autocorrelation "
                "included; the tables' scale is then that of its innovations, which is smaller. "
                f"Gaps that are not hatched have no samples, or are not compared: {too_slow()}."
            ),
        ),
        Declared(
            stem="residual",
            title="What is left unexplained",
            section="prediction",
            draw=lambda fit, _: residual_figure(fit),
            caption=(
                "What the posterior mean leaves unexplained, against motion and load, as far as "
                f"they vary: means and {100 * LEVEL:.0f} % of the residuals, in bins of equally "
                "many outputs."
            ),
        ),
        Declared(
            stem="friction",
            title="Friction of the joint",
            section="friction",
            draw=lambda fit, _: friction_figure(fit.wide),
            caption=lambda fit, _: friction_caption(fit.wide),
        ),
        Declared(
            stem="corner",
            title="Marginal and pairwise posteriors",
            section="posterior",
            draw=corner_figure,
            caption=_corner_caption,
        ),
    )
}
# Of roll-outs, which are made when a run is finished; and of a comparison.
ROLL_OUT = Declared(
    stem="rollout",
    title="Simulated and measured motion",
    section="roll-out",
    draw=rollout_figure,
    caption=_rollout_caption,
)
FOREST = Declared(
    stem="forest",
    title="Every quantity by every run and method",
    section="side-by-side",
    draw=forest_figure,
    caption=_BARS,
)


def captions(fit: Fit, summary: Summary, figures: Sequence[Declared]) -> str:
    """Write the captions of a run's figures as Markdown, one line each."""
    lines = (f"**{figure.stem}**: {figure.caption_of(fit, summary)}\n" for figure in figures)
    return effort_words("\n".join(lines), fit.chain.motor_motion)


def read_captions(markdown: str) -> dict[str, str]:
    """Read back what :func:`captions` wrote, by stem."""
    lines = (line[2:].partition("**: ") for line in markdown.splitlines() if line[:2] == "**")
    return {stem: caption for stem, _, caption in lines if caption}
