"""Whether a likelihood that comes out as no number cuts the posterior short."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bayesfric.inference.sampling.proposal import Proposal
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array

# Places looked at: a share of 1 % is then known to a fifth of itself.
_PLACES = 2000
# Seed of these places, beside those of the other draws that one seed gives.
_SPAWN = 2**31 + 1
# The parameter that tells bad places from good ones in so many of their pairs is named.
_TELLING = 0.8
# Share of such places that may lie beside the posterior. The proposal is the posterior's
# own shape, so about this share of the posterior may be missing, and the tail beyond an end
# of a 90 % interval, 5 %, may be off by as much. Below this it drowns in what chance leaves:
# 2000 independent draws know that tail to 0.5 %. Warm-up starts far out on purpose, and what it
# meets there says nothing.
TROUBLE = 0.01


def beside_posterior(target: Target, proposal: Proposal, seed: int, batch: int) -> Array:
    """Draw places as the sampler does that finds no number at some.

    ``proposal`` is fitted to the posterior and frozen; ``batch`` places are evaluated at once, as
    in a step. Gives ``(2000, d + 1)``: parameters, and 1 where the likelihood is no number there.
    """
    sequence = np.random.SeedSequence(seed, spawn_key=(_SPAWN,))
    random = np.random.RandomState(np.random.MT19937(sequence))
    u = proposal.draw(_PLACES, random)
    bad = [target.no_number(u[begin : begin + batch]) for begin in range(0, _PLACES, batch)]
    parameters, _ = target.to_parameters(u)
    return np.column_stack([parameters, np.concatenate(bad)])


def undefined_warning(names: tuple[str, ...], places: Array) -> str | None:
    """Say what share of these places has no likelihood, where they are and what to do.

    Nothing where the share is too small to matter.
    """
    parameters, bad = places[:, :-1], places[:, -1] > 0.0
    share = float(bad.mean())
    if share < TROUBLE:
        return None
    text = (
        f"at {100 * share:.2g} % of the places beside the posterior the likelihood is no number; "
        "they count as impossible"
    )
    check = "check units and columns of the recordings with 'bayesfric check'"
    where = _where(names, parameters, bad)
    if where is None:
        return f"{text}, and lie in no one direction: {check}, and do not trust the intervals"
    name, side, edge = where
    return (
        f"{text}, most of them where {name} is {side} {edge:.3g}: if the joint cannot be so, end "
        f"priors.{name} there; if it can, that end of its interval is cut short: {check}"
    )


def _where(
    names: tuple[str, ...], parameters: Array, bad: NDArray[np.bool_]
) -> tuple[str, str, float] | None:
    """Find the parameter that tells bad places from good: name, side, and where they begin."""
    sound = np.isfinite(parameters).all(axis=1)
    parameters, bad = parameters[sound], bad[sound]
    pairs = float(bad.sum()) * float((~bad).sum())
    if pairs == 0.0:
        return None
    ranks = np.asarray(stats.rankdata(parameters, axis=0))[bad].sum(axis=0)
    # share of pairs of a bad and a good place in which the bad one has more of it
    more = (ranks - bad.sum() * (bad.sum() + 1) / 2.0) / pairs
    j = int(np.argmax(np.abs(more - 0.5)))
    if max(more[j], 1.0 - more[j]) < _TELLING:
        return None
    above = bool(more[j] > 0.5)
    edge = float(np.quantile(parameters[bad, j], 0.05 if above else 0.95))
    return names[j], "above" if above else "below", edge
