"""Check of the output-error likelihood's linearisation over the posterior, before sampling.

The derivatives of the motion are taken at the mode. For a joint that sticks they differ between
plausible parameters, and so does the likelihood.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from bayesfric.base.errors import BadInput
from bayesfric.inference.sampling.start import Start
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array

# Standard deviation of the log-likelihood's change beyond which a posterior is refused. Of 57
# simulated recordings, 45 were below 2, with the truth within 3.2 posterior standard deviations in
# all parameters of all but one, whether the joint stuck for 0 or 38 % of the time; above, errors
# were up to 90.
_MAX_CHANGE = 2.0
# Linearisation points.
_POINTS = 12


def linearisation_change(target: Target, start: Start, rng: np.random.Generator) -> float:
    """Return the standard deviation of the log-likelihood's change by relinearisation.

    Plausible parameters are compared by the log-likelihood linearised there and at the mode; a
    constant difference does not matter to a posterior. BadInput if it is too large.
    """
    changes: list[float] = []
    # the sum of squares about the mean only grows: stop once it is too large
    limit = _MAX_CHANGE**2 * (_POINTS - 1)
    for place in _plausible_parameters(target, start, rng):
        relinearised = target.relinearised_at(place)
        change = relinearised.log_likelihood(place[None]) - target.log_likelihood(place[None])
        changes.append(float(change[0]))
        if not np.var(changes) * len(changes) <= limit:  # or not finite
            sd = float(np.std(changes, ddof=1)) if np.isfinite(changes).all() else np.inf
            raise BadInput(
                'likelihood.method = "output-error"',
                f"cannot be linearised: at another point the log-likelihood changes by {sd:.2g} "
                f"(sd; at most {_MAX_CHANGE:g}), as if the joint sticks or reverses",
                'set likelihood.method = "input-error", or exclude standstills',
            )
    return float(np.std(changes, ddof=1))


def _plausible_parameters(target: Target, start: Start, rng: np.random.Generator) -> Array:
    """Draw up to a dozen parameter vectors ``(n, d)`` as probable as the posterior's.

    The start's normal is narrowed until enough draws are within the fall of log density of 99.9 %
    of a ``d``-dimensional normal.
    """
    d = start.mode.size
    root = np.linalg.cholesky(start.covariance)
    fall = stats.chi2.isf(1e-3, d) / 2.0
    spread = 1.0
    while True:
        u = start.mode + spread * rng.standard_normal((100, d)) @ root.T
        density = target(u)
        probable = u[density > max(density.max(), target(start.mode[None])[0]) - fall]
        if len(probable) >= _POINTS or spread < 1e-3:
            places = probable[:_POINTS] if len(probable) > 1 else u[:_POINTS]
            return np.asarray(target.to_parameters(places)[0])
        # bounds and curvature make a posterior narrower than its normal
        spread /= 2.0
