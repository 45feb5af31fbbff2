"""Which noise model the residuals of an estimate ask for, and the evidence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesfric.inference.likelihood.autoregression import (
    PASSES,
    burg,
    ljung_box,
    variances,
    whitened,
)

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Longest memory that is tried.
MOST = 4
# Correlations that the test of what is left looks at, beyond those fitted.
_LAGS = 10


@dataclass(frozen=True)
class Evidence:
    """How well residuals are autoregressive noise of one order.

    Attributes
    ----------
    order
        Predecessors that each residual remembers.
    bic
        Bayesian information criterion over that of white noise; the smallest is chosen.
    innovations
        Root mean square of the innovations over that of the residuals.
    p_value
        Of the Ljung-Box test that the innovations are white.
    """

    order: int
    bic: float
    innovations: float
    p_value: float


@dataclass(frozen=True)
class Choice:
    """The order chosen, and every one that was tried."""

    order: int
    tried: tuple[Evidence, ...]

    @property
    def white(self) -> bool:
        """Whether the innovations of the chosen order pass as white."""
        return self.tried[self.order].p_value >= PASSES


def choose_order(
    residuals: Sequence[Array], follows: Sequence[Flags], own_scales: bool, most: int = MOST
) -> Choice:
    """Choose the order of autoregressive noise by the Bayesian information criterion.

    Parameters
    ----------
    residuals
        Of every recording, ``(M,)`` each.
    follows
        ``(M - 1,)`` each, whether runs go on.
    own_scales
        Whether every recording has a scale of its own.
    most
        Largest order tried.

    Returns
    -------
    Choice
    """
    n = sum(r.size for r in residuals)
    most = min(most, max(0, n // 20))
    whole = sum(float(r @ r) for r in residuals)
    if not whole > 0.0:
        return Choice(0, (Evidence(0, 0.0, 1.0, 1.0),))
    sizes = [_size([r]) if own_scales else _size(residuals) for r in residuals]
    scaled = [r / size if size > 0.0 else r for r, size in zip(residuals, sizes, strict=True)]
    tried: list[Evidence] = []
    for order in range(most + 1):
        partial = burg(scaled, follows, order)
        left = [whitened(r, partial, f) for r, f in zip(scaled, follows, strict=True)]
        # the first of a run are divided by their own, larger sds
        deviance = 2.0 * sum(float(_log_sds(partial, f).sum()) for f in follows)
        inner = [_size([z]) if own_scales else _size(left) for z in left]
        for z, size in zip(left, inner, strict=True):
            deviance += 2.0 * z.size * math.log(size) if size > 0.0 else 0.0
        power = sum(z.size * (a * b) ** 2 for z, a, b in zip(left, sizes, inner, strict=True))
        normal = [z / size if size > 0.0 else z for z, size in zip(left, inner, strict=True)]
        tried.append(
            Evidence(
                order,
                deviance + order * math.log(n) - (tried[0].bic if tried else 0.0),
                math.sqrt(power / whole),
                ljung_box(normal, follows, _LAGS + order, order),
            )
        )
    first = tried[0]
    tried[0] = Evidence(0, 0.0, first.innovations, first.p_value)
    best = min(tried, key=lambda one: one.bic)
    return Choice(best.order, tuple(tried))


def _log_sds(partial: Array, follows: Flags) -> Array:
    """Logarithms of the sds, over the innovations', that the first of every run have."""
    heads = np.log(variances(partial[None])[0]) / 2.0
    begins = np.concatenate([[0], np.flatnonzero(~follows) + 1])
    lengths = np.diff(np.append(begins, follows.size + 1))
    return np.concatenate([heads[: min(k, partial.size)] for k in lengths.tolist()] or [heads[:0]])


def _size(parts: Sequence[Array]) -> float:
    """Root mean square of all parts together."""
    return math.sqrt(sum(float(p @ p) for p in parts) / sum(p.size for p in parts))
