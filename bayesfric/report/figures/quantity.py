"""A sampled parameter, or a combination of them, as figures show it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesfric.inference.fitting import Fit
from bayesfric.inference.prior.priors import Prior
from bayesfric.mechanism.derived import derive
from bayesfric.report.figures.style import Array, mathtext, power_of_ten, scaled_unit
from bayesfric.report.summary.derived_quantities import described_as
from bayesfric.report.summary.noise import noise_described
from bayesfric.report.summary.record import Summary


@dataclass(frozen=True, eq=False)
class Quantity:
    """A sampled parameter, or a combination of them, as figures show it."""

    name: str  # as in `posterior.names`, or of the derived quantity
    symbol: str  # with dollar signs, ready for Matplotlib
    unit: str  # SI, empty where there is none
    draws: Array  # `(n,)` in `unit`; walkers that never moved are left out
    prior: Prior | None  # of the parameter; `None` of a combination

    @property
    def exponent(self) -> int:
        """Power of ten that is taken out of the numbers on an axis."""
        low, high = (float(v) for v in np.quantile(self.draws, [0.05, 0.95]))
        return power_of_ten(low, high)

    @property
    def factor(self) -> float:
        """What one on an axis stands for, in ``unit``."""
        return float(10.0**self.exponent)

    @property
    def scaled_unit(self) -> str:
        """Unit on an axis, with the power of ten; a dash where there is neither."""
        return scaled_unit(self.exponent, self.unit)

    def label(self, between: str = " ") -> str:
        """Symbol and unit for an axis, with ``between`` between them."""
        return f"{self.symbol}{between}({self.scaled_unit})"

    def nearly_all(self, margin: float) -> tuple[float, float]:
        """Give an axis nearly all draws and a share of their width, nothing beyond the support."""
        low, high = (float(v) for v in np.quantile(self.draws / self.factor, [0.001, 0.999]))
        room = margin * (high - low) or 0.05 * abs(low) or 1.0
        if self.prior is None:
            return low - room, high + room
        lower, upper = self.prior.lower / self.factor, self.prior.upper / self.factor
        return max(low - room, min(lower, low)), min(high + room, max(upper, high))


def quantities(fit: Fit) -> list[Quantity]:
    """List the sampled parameters of a fit, noise scales last."""
    posterior = fit.posterior
    said = {p.name: described_as(p) for p in fit.chain.parameters} | noise_described(fit)
    return [
        Quantity(name, mathtext(said[name]["symbol"], name), said[name]["unit"], draws, prior)
        for name, draws, prior in zip(
            posterior.names, posterior.flat().T, posterior.priors, strict=True
        )
    ]


def combinations(fit: Fit) -> list[Quantity]:
    """List what no scaling of leg parameters and alpha changes, where every draw has it."""
    # without a load no efficiency is stated
    return [
        Quantity(d.name, mathtext(d.symbol, d.name), d.unit, d.values, None)
        for d in derive(fit.chain, fit.chain_draws(), 0.0)
        if d.gauge_free and np.isfinite(d.values).all()
    ]


def which_posterior(summary: Summary) -> str:
    """Say of which posterior figures are whose intervals stand in the tables, where it matters."""
    wide = " Densities and intervals have room for the model's error, as in the tables."
    words = wide if summary.widened else ""
    if biased := [n for n, row in summary.rows.items() if row.reported and row.reported.how.bias]:
        words += f" The bias of filters and encoder is not taken off: {', '.join(biased)}."
    return words
