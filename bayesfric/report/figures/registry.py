"""Every figure: its files' name, its title, caption and section of the page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure

from bayesfric.identifiability.friction_curve import FEWEST
from bayesfric.mechanism.quantities import Motion, effort_words
from bayesfric.recordings.checks import too_slow
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.figures.forest import forest_figure
from bayesfric.report.figures.posterior import corner_figure, ridge_figure
from bayesfric.report.figures.prediction import (
    friction_figure,
    prediction_figure,
    residual_figure,
    rollout_figure,
)
from bayesfric.report.summary.record import Summary


@dataclass(frozen=True)
class Declared:
    """One figure."""

    stem: str  # its files' name
    title: str
    section: str  # of the page
    # of a run's fit and summary, a comparison or a roll-out; `None` where there is nothing to show
    draw: Callable[..., Figure | None]
    caption: str


_BARS = (
    "Bars are 90 % intervals; thin ones assume uncorrelated residuals. Open symbols: not "
    "determined, dotted what fits as well. An arrow leads from a limit to its bound."
)
# Those of a fit and its summary, in the order of the page.
RUN_FIGURES = {
    figure.stem: figure
    for figure in (
        Declared(
            "methods",
            "Estimates and posterior side by side",
            "methods",
            # of a single run, whose name is nowhere shown
            lambda _, summary: forest_figure(comparison({"run": summary})),
            f"Every quantity by every method and by the posterior. {_BARS}",
        ),
        Declared(
            "ridge",
            "The ridge: what can be scaled together without changing any torque",
            "ridge",
            lambda fit, _: ridge_figure(fit),
            "Draws of the posterior against the line along which no torque changes, between the "
            "ends that a passive gearbox sets. Only a known mass distinguishes them.",
        ),
        Declared(
            "prediction",
            "Measured and predicted",
            "prediction",
            lambda fit, _: prediction_figure(fit),
            "Measured outputs and the posterior predictive, noise included, with residuals below. "
            "Dashed: two standard deviations of the noise, its autocorrelation included; the "
            "tables' scale is then that of its innovations, which is smaller. Gaps that are not "
            f"hatched have no samples, or are not compared: {too_slow()}.",
        ),
        Declared(
            "residual",
            "What is left unexplained",
            "prediction",
            lambda fit, _: residual_figure(fit),
            "Residuals at the posterior mean against motion and load, as far as they vary: means "
            "and 90 % of them, in bins of equally many outputs.",
        ),
        Declared(
            "friction",
            "Friction of the joint",
            "friction",
            lambda fit, _: friction_figure(fit.wide),
            "Friction of the whole joint at the motor, at constant speed: posterior median and "
            "90 % band, hatched where the data do not determine it, dashed where fewer than "
            f"{FEWEST} compared outputs are near. Load is the torque at the joint over the ratio, "
            "positive against the motion; where the scale between load and gearbox is open, the "
            "mean of its torque at the motor while driving and while driven. Torque is the true "
            "one, as in the tables: what was recorded, times drive.gain where there is one.",
        ),
        Declared(
            "corner",
            "Marginal and pairwise posteriors",
            "posterior",
            corner_figure,
            "Diagonal: posterior density with 90 % interval, as in the tables, and dashed the "
            "prior of parameters. Below: 50 % and 90 % of the draws. What the data leave open is "
            "hatched, has no interval and is not filled in its pairs: it shows prior and bounds. "
            "So is everything where the sampling has not converged. A limit has one dotted end.",
        ),
    )
}
# Of roll-outs, which are made when a run is finished; and of a comparison.
ROLL_OUT = Declared(
    "rollout",
    "Simulated and measured motion",
    "roll-out",
    rollout_figure,
    "Motion of the joint simulated with recordings' inputs, and the measured position; of many "
    "recordings the one most inside its band, one between, and the least. Dark: draws of the "
    "posterior, parameters alone; light: with torque that the model leaves unexplained.",
)
FOREST = Declared(
    "forest", "Every quantity by every run and method", "side-by-side", forest_figure, _BARS
)


def captions(summary: Summary) -> dict[str, str]:
    """Give the captions of a run's figures by stem, of force where the motor is linear."""
    motion: Motion = "linear" if summary.fit.unit in ("N", "m") else "rotary"
    figures = [*RUN_FIGURES.values(), ROLL_OUT]
    return {figure.stem: effort_words(figure.caption, motion) for figure in figures}
