"""Variable projection: ``Theta2`` with ``Theta1`` in closed form, eqs. (12), (14) to (19)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from bayesfric.estimates.torque_form import POSITIVE, TorqueForm, columns, minimum_norm
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

_SAME = 1e-6  # two minima closer than this, relatively, are one


@dataclass(frozen=True, eq=False)
class Minimum:
    """The minimum of the criterion (12)."""

    theta1: Array  # (n1,) coefficients of the columns of the form, in motor units
    # (n2,), of this and its negative, which make the same torque, the physical one
    theta2: Array
    starts: int  # searches
    starts_agreeing: int  # those that reached this minimum


class VariableProjection:
    """The criterion (12) as a function of ``Theta2`` alone.

    Parameters
    ----------
    form
        Of the chain with the same observations.
    observations
        Recordings, prepared.

    Attributes
    ----------
    scale
        ``(n2,)`` norm of each column of psi that ``Theta2`` multiplies.

    Notes
    -----
    Model and measurement have passed the same linear filter, so (18) holds with filtered
    regressors. The columns of ``Theta1`` do not depend on ``Theta2``, so the derivative of the
    projected residual is the projected derivative, exactly.

    References
    ----------
    Golub and Pereyra, SIAM Journal on Numerical Analysis 10, 1973.
    """

    def __init__(self, form: TorqueForm, observations: Sequence[Observation]) -> None:
        self.form, self._observations = form, observations
        chain = form.chain
        self._psi2 = [columns(chain, o, form.names2) for o in observations]
        self._sign = [np.sign(o.qd) for o in observations]
        target, regressors = [], []
        two_losses = f"{form.loss}.load_drive" in chain.names
        for o in observations:
            known = np.zeros_like(o.measured)
            if o.inputs.known_load and "added_load" not in form.names1 and not two_losses:
                # lambda_1 is one: what the known load takes is known
                known = o.filter.apply(columns(chain, o, ("added_load",)))[0]
            target.append(o.measured - known)
            regressors.append(o.filter.apply(columns(chain, o, form.names1)))
        self._target = np.concatenate(target)
        *_, self._solution, self._range = minimum_norm(np.concatenate(regressors, axis=1).T)
        norms = np.sqrt(sum(((p**2).sum(axis=1) for p in self._psi2), np.zeros(len(form.names2))))
        self.scale: Array = np.where(norms > 0.0, norms, 1.0)

    def theta1(self, theta2: Array) -> Array:
        """Best ``Theta1`` ``(n1,)`` given ``Theta2`` ``(n2,)``, eq. (18).

        ``(psi' psi)^-1 psi' (torque - sign(qd) |psi Theta2|)``; of minimum norm if columns are
        collinear.
        """
        return np.asarray(self._solution @ (self._target - self._folded(theta2)))

    def residual(self, theta2: Array) -> Array:
        """Measured minus modelled torque at the best ``Theta1``, ``(n_outputs,)``, N m or N."""
        return self._outside(self._target - self._folded(theta2))

    def jacobian(self, theta2: Array) -> Array:
        """Differentiate :meth:`residual` by ``Theta2``, ``(n_outputs, n2)``; ``psi1`` of (17)."""
        blocks = [
            o.filter.apply(sign * np.sign(theta2 @ psi2) * psi2)
            for o, sign, psi2 in zip(self._observations, self._sign, self._psi2, strict=True)
        ]
        return -self._outside(np.concatenate(blocks, axis=1).T)

    def criterion(self, theta2: Array) -> float:
        """Sum of squares (12) at the best ``Theta1``."""
        residual = self.residual(theta2)
        return float(residual @ residual)

    def minimise(self, starts: Sequence[Array]) -> Minimum:
        """Solve eq. (19): search from several ``Theta2`` ``(n2,)`` (Levenberg-Marquardt)."""
        settings: Any = {"method": "lm", "x_scale": 1.0 / self.scale, "max_nfev": 100}
        settings |= {"xtol": 1e-12, "ftol": 1e-12, "gtol": 1e-14}
        # a start of zero would sit on the fold of |psi Theta2|
        unfolded = [np.where(start == 0.0, 1e-6 / self.scale, start) for start in starts]
        ends = [np.zeros(0)]
        if self.form.names2:
            ends = [least_squares(self.residual, x, self.jacobian, **settings).x for x in unfolded]
        heights = np.array([self.criterion(theta2) for theta2 in ends])
        best = int(np.argmin(heights))
        limit = (1.0 + _SAME) * heights[best] + 1e-20 * float(self._target @ self._target)
        theta2 = self._signed(ends[best])
        agreeing = int(np.count_nonzero(heights <= limit))
        return Minimum(self.theta1(theta2), theta2, len(ends), agreeing)

    def _signed(self, theta2: Array) -> Array:
        """Of the two equal solutions give the one with ``Jc > 0`` and ``alpha_2 > alpha_1``.

        Every loss and inertia is positive then; where noise has turned a sign, the larger torques
        decide.
        """
        totals1 = dict(zip(self.form.names1, self.theta1(theta2), strict=True))
        score = 0.0
        for name, value in zip(self.form.names2, theta2 * self.scale, strict=True):
            if name in POSITIVE:
                score += value
            elif name.startswith("gravity"):
                score += value * np.sign(totals1[name])
        return -theta2 if score < 0.0 else theta2

    def _folded(self, theta2: Array) -> Array:
        """``sign(qd) |psi Theta2|``, filtered."""
        blocks = [
            o.filter.apply(sign * np.abs(theta2 @ psi2))
            for o, sign, psi2 in zip(self._observations, self._sign, self._psi2, strict=True)
        ]
        return np.concatenate(blocks)

    def _outside(self, x: Array) -> Array:
        """Project off what ``psi Theta1`` explains."""
        return np.asarray(x - self._range @ (self._range.T @ x))
