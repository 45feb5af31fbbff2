"""Captions of all figures: what is drawn, and what it says of this run in words."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from bayesfric.inference.fit import Fit
from bayesfric.mechanism.parameter import effort_words
from bayesfric.report.figures.curve_band import CurveJudge
from bayesfric.report.summary.residual_analysis import residual_words
from bayesfric.report.summary.summary import LEVEL

_SHARE = f"{100 * LEVEL:.0f} %"


def friction_caption(fit: Fit) -> str:
    """Say what load means in the friction figure, which depends on what the run can tell."""
    start = (
        "Friction of the whole joint at the motor, at constant speed: posterior median and "
        f"{_SHARE} band. Dashed where no recording ran, hatched where the data do not tell. "
    )
    if all(element.load_loss == "none" for element in fit.chain.elements):
        return start + "No element has a loss that depends on load."
    if CurveJudge(fit).open_scale:
        return start + (
            "Load is the mean of what the motor feels of it while driving and while driven: the "
            "scale between leg and gearbox is open, and only this mean is the same for all "
            "parameters that make the same torque."
        )
    return start + "Load is the torque at the joint over the ratio, positive against the motion."


def efficiency_caption(_: Fit) -> str:
    """Say what the efficiency figure counts."""
    return (
        f"Efficiency of eq. (4) over the load at the joint: posterior median and {_SHARE} band, "
        "constant losses in and behind the element counted, viscous ones not. Dashed where no "
        "recording had such loads, hatched where the data do not determine it."
    )


def prior_posterior_caption(_: Fit) -> str:
    """Say how the panels of the prior-posterior figure are scaled."""
    return (
        f"Prior (dashed) and posterior density of each parameter; dotted: {_SHARE} interval; "
        "hatched where the data leave the parameter open. 1:n compares the sds of posterior and "
        "prior. A posterior can be far narrower than its prior and open all the same: then "
        "priors and bounds of other parameters confine it."
    )


def residual_caption(fit: Fit) -> str:
    """Say what the residuals look like."""
    return (
        "What the posterior mean leaves unexplained: autocorrelation, quantiles against those of a "
        "normal, and residuals against speed, load and angle (thin: one sd; thick: 95 % interval "
        "of the bin's mean; the share of variance that the bins' means hold is written in each "
        "panel). " + " ".join(residual_words(fit))
    )


def validation_caption(fit: Fit) -> str:
    """Say what was held out, and what its panels are."""
    names = ", ".join(f"{p.held_out.name} ({p.held_out.part})" for p in fit.held_out)
    return (
        f"Predicted and measured torque of what the fit did not see: {names}. Above: {_SHARE} "
        "band of the posterior predictive, noise included. Below left: predicted probability of "
        "less than was measured, level where predictions are right. Below right: share of outputs "
        "inside central predictive intervals; bars: two standard errors that account for "
        "correlation."
    )


_BARS = (
    f"Thick: {_SHARE}, accounting for correlated residuals; thin: taking them for uncorrelated; "
    "open symbols: not determined, dotted what fits as well."
)
# The same for every run. ``forest`` and ``overlay`` are of comparisons.
FIXED: dict[str, str] = {
    "methods": f"Every quantity by every method and by the posterior. {_BARS}",
    "forest": _BARS,
    "overlay": (
        "Marginal posterior density of every run, the area below each curve being one: filled "
        "where the data determine the quantity, not filled where the prior has a say or the data "
        "tell from one side only, hatched where they leave it open: then it is prior and bounds "
        "that are seen. What the data of no run determine is left out."
    ),
    "ridge": (
        "Draws of the posterior against the line along which no torque changes, between the ends "
        "that a passive gearbox sets. Below: the torque at both ends of the line and in its "
        "middle, and their difference."
    ),
    "prediction": (
        "What was measured and what the posterior predicts, noise included, with residuals below."
    ),
    "corner": (
        f"Diagonal: posterior density with {_SHARE} interval, dashed the prior of parameters. "
        "Below: 50 % and 90 % of the draws. What the data leave open is hatched, has no interval "
        "and is not filled in its pairs: there prior and bounds are seen. So is everything where "
        "the sampling has not converged. A limit has one dotted end."
    ),
    "trace": (
        "Median and spread of the walkers of every ensemble along the steps kept, and the "
        "autocorrelation of what the ensembles drew."
    ),
}
CAPTIONS: dict[str, Callable[[Fit], str]] = {
    "friction": friction_caption,
    "efficiency": efficiency_caption,
    "prior_posterior": prior_posterior_caption,
    "residual": residual_caption,
    "validation": validation_caption,
}


def captions(fit: Fit, stems: Sequence[str]) -> str:
    """Write the captions of the named figures, those that have one, as Markdown."""
    written = {stem: CAPTIONS[stem](fit) for stem in stems if stem in CAPTIONS}
    written |= {stem: FIXED[stem] for stem in stems if stem in FIXED}
    lines = (f"**{stem}**: {written[stem]}\n" for stem in stems if stem in written)
    return effort_words("\n".join(lines), fit.chain.motor_motion)
