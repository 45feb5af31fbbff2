"""Whether a simulation's linearisation holds all over the posterior, asked before it is sampled.

The output-error likelihood takes the derivatives of the motion by torque and initial states at the
mode. A joint that sticks has none that last: whether and when it sticks differs from one
plausible parameter vector to the next, and so does the likelihood, if it is linearised there.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from bayesfric.base.errors import BadInput
from bayesfric.inference.sampling.start import Start
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array

# Standard deviation of the log-likelihood's change beyond which a posterior is refused. Measured on
# 57 simulated recordings: below 2 (45 of them) the truth lay within 3.2 posterior sds in all
# parameters of all but one, whether the joint stuck for 0 or 38 % of the time; above up to 90 off.
_MOST = 2.0
# Places to linearise at, of how many drawn; what is less probable than all but this share of a
# normal is none.
_PLACES, _DRAWN, _IMPROBABLE = 12, 100, 1e-3
# Share of the expected spread that is drawn over at least.
_NARROWEST = 1e-3


def linearisation_change(target: Target, start: Start, rng: np.random.Generator) -> float:
    """Tell by how much the log-likelihood changes where the simulation is linearised anew.

    At some places where the posterior is expected to be, the log-likelihood linearised there is
    compared with the one linearised at the mode. A constant difference does not matter to a
    posterior, so the standard deviation over the places is what counts.
    """
    apart: list[float] = []
    # the sum of squares about the mean only grows: once it is too large, so is the final one
    limit = _MOST**2 * (_PLACES - 1)
    for place in _places(target, start, rng):
        anew = target.relinearised_at(place)
        change = anew.log_likelihood(place[None]) - target.log_likelihood(place[None])
        apart.append(float(change[0]))
        if not np.var(apart) * len(apart) <= limit:  # nor where it is no number
            sd = float(np.std(apart, ddof=1)) if np.isfinite(apart).all() else np.inf
            raise BadInput(
                'likelihood.method = "output-error"',
                "what noise of the torque does to the motion cannot be linearised: done at another "
                f"place in the posterior it changes the log-likelihood by {sd:.2g} (sd; at most "
                f"{_MOST:g} can be trusted), as where the joint sticks or reverses",
                'take likelihood.method = "input-error", or a motion that seldom rests, or exclude '
                "such spans",
            )
    return float(np.std(apart, ddof=1))


def _places(target: Target, start: Start, rng: np.random.Generator) -> Array:
    """Draw up to a dozen parameter vectors ``(n, d)`` about as probable as the posterior's are.

    From the start's normal, narrowed until enough draws lie within the fall of log density that
    99.9 % of a ``d``-dimensional normal stay within.
    """
    d = start.mode.size
    root = np.linalg.cholesky(start.covariance)
    fall = stats.chi2.isf(_IMPROBABLE, d) / 2.0
    spread = 1.0
    while True:
        u = start.mode + spread * rng.standard_normal((_DRAWN, d)) @ root.T
        density = target(u)
        probable = u[density > max(density.max(), target(start.mode[None])[0]) - fall]
        if len(probable) >= _PLACES or spread < _NARROWEST:
            places = probable[:_PLACES] if len(probable) > 1 else u[:_PLACES]
            return np.asarray(target.to_parameters(places)[0])
        # bounds and bends make a posterior narrower than its normal
        spread /= 2.0
