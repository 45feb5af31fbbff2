"""Whether a likelihood that comes out as no number cuts the posterior short."""

from __future__ import annotations

import numpy as np

from bayesfric.inference.sampling.proposal import Proposal
from bayesfric.inference.target import Target

# Places looked at: a share of 1 % is then known to a fifth of itself.
_PLACES = 2000
# Seed of these places, beside those of the other draws that one seed gives.
_SPAWN = 2**31 + 1
# Share of such places that may lie beside the posterior. The proposal is the posterior's
# own shape, so about this share of the posterior may be missing, and the tail beyond an end
# of a 90 % interval, 5 %, may be off by as much. Below this it drowns in what chance leaves:
# 4000 independent draws know that tail to 0.3 %. Warm-up starts far out on purpose, and what it
# meets there says nothing.
TROUBLE = 0.01


def share_undefined(target: Target, proposal: Proposal, seed: int, batch: int) -> float:
    """Draw places as the sampler does that finds no number at some, and give their share.

    ``proposal`` is fitted to the posterior and frozen; ``batch`` places are evaluated at once, as
    in a step.
    """
    sequence = np.random.SeedSequence(seed, spawn_key=(_SPAWN,))
    random = np.random.RandomState(np.random.MT19937(sequence))
    u = proposal.draw(_PLACES, random)
    bad = [target.no_number(u[begin : begin + batch]) for begin in range(0, _PLACES, batch)]
    return float(np.concatenate(bad).mean())


def undefined_warning(share: float) -> str | None:
    """Say what share of these places has no likelihood, if that is enough to matter."""
    if share < TROUBLE:
        return None
    return (
        f"at {100 * share:.2g} % of the places beside the posterior the likelihood is no number; "
        "they count as impossible: check units and columns of the recordings with 'bayesfric "
        "check', and do not trust the intervals"
    )
