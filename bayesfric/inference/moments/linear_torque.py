"""The torque as a linear function of a few coefficients, once the direction of power is known.

With the load's torque ``T = psi2 l`` at the gearbox (``l`` the leg's parameters in motor units)
the motor torque is ``psi1 Theta1 + sign(qd) sign(T) psi2 Theta2``, eq. (13): its sign is that of
``l``, whatever the sign of lambda_2, so this holds for negative load losses too. At exact rest
the mechanism takes no loss while eq. (13) leaves ``lambda_1 T``; columns of their own for the
samples at rest put that right. An unknown gain divides all coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.torque_form import Term, columns, torque_form
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]

# Samples of a recording from which the size of its columns is judged.
_TRIED = 20_000


@dataclass(frozen=True)
class Coefficients:
    """What multiplies the columns, for ``n`` parameter vectors."""

    # (n, K): one for the measured torque, minus Theta1, minus Theta2, and, where a sample is
    # at rest, minus (1 - lambda_1) l
    all: Array
    leg: Array  # (n, n2) l, whose product with psi2 has the direction of the load's torque
    lambda2: Array  # (n,)


class LinearTorque:
    """Columns and coefficients of a chain's torque; made by :func:`linear_torque`.

    Attributes
    ----------
    names1, names2
        Columns ``psi1`` and ``psi2``, as in
        :class:`bayesfric.estimates.torque_form.TorqueForm`; a known mass always has its own.
    rest
        Whether there are columns for samples at rest.
    size
        ``K``, all columns together with the measured torque.
    """

    def __init__(self, chain: Joint, observations: Sequence[Observation]) -> None:
        form = torque_form(chain, times_gain=True)
        if form is None:
            raise ValueError("the chain's torque is not of the form of eq. (13)")
        self.chain = chain
        loaded = ("added_load",) if any(o.inputs.known_load for o in observations) else ()
        self.names1 = (*form.names1, *loaded)
        self.names2 = (*form.names2, *loaded) if form.loss else ()
        self._both = [self.names1.index(name) for name in self.names2]
        self._front, self._behind = self._matrix(form.front), self._matrix(form.behind)
        self._angle = -1
        if "gravity_cosine" in self.names1:
            self._angle = chain.names.index("load.gravity_angle")
        self._gain = chain.names.index("drive.gain") if chain.gain else -1
        # what is of the recorded torque itself no gain divides
        self._joints = [i for i, n in enumerate(self.names1) if not n.startswith("drive.")]
        self._known = np.zeros((2, len(self.names1)))
        if loaded:
            self._known[1 if form.loss else 0, -1] = 1.0
        at = {name: i for i, name in enumerate(chain.names)}
        self._losses: list[int] = []
        if form.loss:
            one, ways = f"{form.loss}.load", ("drive", "back")
            self._losses = [at[one if one in at else f"{one}_{way}"] for way in ways]
        two = bool(self._losses) and self._losses[0] != self._losses[1]
        self.rest = two and any(bool((o.qd == 0.0).any()) for o in observations)
        n2 = len(self.names2)
        self.size = 1 + len(self.names1) + n2 + (n2 if self.rest else 0)

    def _matrix(self, terms: Mapping[str, list[Term]]) -> Array:
        out = np.zeros((len(self.chain.names), len(self.names1)))
        for name, found in terms.items():
            for i, factor in found:
                out[i, self.names1.index(name)] += factor
        return out

    def coefficients(self, values: Array) -> Coefficients:
        """Coefficients of parameter vectors ``(n, n_parameters)``."""
        n, k1, n2 = values.shape[0], len(self.names1), len(self.names2)
        motor = values @ self._front + self._known[0]
        leg = values @ self._behind + self._known[1]
        if self._angle >= 0:
            sine, cosine = np.sin(values[:, self._angle]), np.cos(values[:, self._angle])
            for part in (motor, leg):
                part[:, self.names1.index("gravity")] *= cosine
                part[:, self.names1.index("gravity_cosine")] *= sine
        found = np.empty((n, self.size))
        found[:, 0] = 1.0
        if not self._losses:
            found[:, 1:] = -(motor + leg)
            return self._measured(Coefficients(found, np.zeros((n, 0)), np.zeros(n)), values)
        drive, back = values[:, self._losses[0]], values[:, self._losses[1]]
        excess, lambda2 = 0.5 * (drive - back), 0.5 * (drive + back)
        found[:, 1 : 1 + k1] = -(motor + leg) - excess[:, None] * leg
        behind = leg[:, self._both]
        found[:, 1 + k1 : 1 + k1 + n2] = -lambda2[:, None] * behind
        if self.rest:
            found[:, 1 + k1 + n2 :] = excess[:, None] * behind
        return self._measured(Coefficients(found, behind, lambda2), values)

    def _measured(self, joint: Coefficients, values: Array) -> Coefficients:
        """Turn what multiplies columns of the joint's torque into that of the measured one."""
        if self._gain < 0:
            return joint
        gain = values[:, self._gain]
        behind = range(1 + len(self.names1), joint.all.shape[1])
        joint.all[:, [*(1 + i for i in self._joints), *behind]] /= gain[:, None]
        return replace(joint, lambda2=joint.lambda2 / gain)

    def columns(self, o: Observation, begin: int, end: int) -> tuple[Array, Array]:
        """Unfiltered ``psi1`` ``(n1, n)`` and ``psi2`` ``(n2, n)`` of samples ``begin:end``."""
        psi1 = columns(self.chain, _piece(o, slice(begin, end)), self.names1)
        return psi1, psi1[self._both]

    def typical_size(self, observations: Sequence[Observation]) -> Array:
        """Root mean square of each column of ``psi2``, one where it is zero, ``(n2,)``."""
        total = np.zeros(len(self.names2))
        for o in observations:
            some = _piece(o, slice(None, None, max(1, o.q.size // _TRIED)))
            total += (columns(self.chain, some, self.names2) ** 2).mean(axis=1)
        rms = np.sqrt(total / len(observations))
        return np.where(np.isfinite(rms) & (rms > 0.0), rms, 1.0)


def linear_torque(chain: Joint, observations: Sequence[Observation]) -> LinearTorque | None:
    """Write the torque of a chain as linear, up to the direction of power.

    Returns
    -------
    LinearTorque or None
        ``None`` for a chain with several load losses or a Stribeck rise, or with a known mass at an
        unknown angle.
    """
    angled = "load.gravity_angle" in chain.names
    if torque_form(chain, times_gain=True) is None or (
        angled and any(o.inputs.known_load for o in observations)
    ):
        return None
    return LinearTorque(chain, observations)


def _piece(o: Observation, part: slice) -> Observation:
    return replace(o, q=o.q[part], qd=o.qd[part], qdd=o.qdd[part], stamps=o.stamps[part])
