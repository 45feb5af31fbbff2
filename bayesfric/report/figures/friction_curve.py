"""The joint's friction as the motor feels it, and where the recordings saw it.

The joint runs at constant speed against a constant load. With ``T`` the true motor
torque (without its constant offset) and ``L`` the loss-free torque of the load, both at the
motor, friction is ``F = T - L``. What is recorded is ``T`` over ``drive.gain``, where that is one.

``L`` is where care is due. A recording tells ``Gamma/N``, the torque of the leg over the
ratio, only up to the scaling of leg parameters and ``alpha_1, alpha_2`` that changes no
torque. ``(1 + mu_1) Gamma/N`` and ``(1 - mu_2) Gamma/N``, what the motor feels of the load
while it drives and while it is driven, are known all the same, and so is their mean,
``lambda_1 Gamma/N`` of eq. (13). Where the scale is open this mean therefore stands for the
load: ``F(speed, L)`` then is the same for all members of the ridge. It is what an
experiment finds that lifts and lowers the load at one speed, calls half the sum of the two
torques load and half their difference friction. Where something fixes the scale (a known
mass, a known parameter of the leg, ``mu_1 = mu_2``), ``L`` is ``Gamma/N`` itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from bayesfric.estimates.torque import load_at_outputs
from bayesfric.inference.fitting import Fit
from bayesfric.mechanism import kernels
from bayesfric.mechanism.inverse import load_reach
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import State
from bayesfric.recordings.inputs import AT_ROOM
from bayesfric.report.figures.curve_band import FEWEST, Flags
from bayesfric.report.figures.style import Array

# Of the recorded range of speed, and of load: outputs so near to a place cover it.
NEAR = 0.08


def friction_torque(
    chain: Joint, values: Array, speed: Array, load: Array, *, open_scale: bool
) -> Array:
    """Friction of the whole joint at constant speed, seen at the motor.

    ``speed`` ``(N,)`` is the motor's, not zero, where friction has no one value; ``load`` ``(N,)``
    is its loss-free torque of the load (``open_scale`` says which, see the module), positive where
    it resists the motion. Given as ``(n, N)``, positive against the motion, at 20 degC and as a
    recording begins; at no load it is what
    the constant, viscous and quadratic ``total_drive.*`` of
    :func:`bayesfric.mechanism.derived.derive` sum up, times ``drive.gain``.
    """
    sign = np.sign(speed)
    elements, table, carried = chain.tables(values)
    # a load that weighs what is asked for, and nothing else: the same kernel as everywhere
    table[:] = 0.0
    table[:, kernels.GAIN] = 1.0
    table[:, kernels.GRAVITY] = 1.0
    with np.errstate(divide="ignore"):
        table[:, kernels.FIRST_MOMENT] = 1.0 / load_reach(chain, values, open_scale=open_scale)
    # what pulls at rest, wherever it goes, is no friction
    rest = State(0.0, 0.0, 0.0, 0.0, 0.0)
    for k, term in enumerate(chain.carried):
        if term.row.column is not None and not term.row.shape and term.row.column(rest) != 0.0:
            carried[:, k, 0] = 0.0
    # the sine of the angle is put in place of one: the load is any, not that of a position
    still = np.zeros_like(load)
    # at constant speed the torque stands still too
    samples = chain.samples(still, speed / chain.ratio, still, AT_ROOM, still)
    samples = samples._replace(sin_q=np.ascontiguousarray(sign * load), cos_q=still)
    torque = kernels.inverse_many(elements, table, carried, samples)
    return np.asarray(sign * torque - load)


@dataclass(frozen=True, eq=False)
class Covered:
    """Where the recordings were."""

    speed: Array  # `(M,)` of the motor at every output, rad/s or m/s
    # `(M,)` loss-free torque of the load at the motor at the posterior median, its inertia
    # included; positive where it resists the motion
    load: Array

    def near(self, speed: Array, load: Array | None) -> Flags:
        """Tell which places ``(N,)`` have ``FEWEST`` outputs near; all loads count if ``None``."""
        mine, places = [self.speed], [speed]
        if load is not None:
            mine.append(self.load)
            places.append(load)
        spans = np.array([max(float(np.ptp(x)), 1e-300) for x in mine])
        # nine tenths of the outputs, or one jerk would stretch what counts as near
        inner = np.array([float(np.subtract(*np.quantile(x, [0.95, 0.05]))) for x in mine])
        spans = np.where(inner > 0.0, inner / 0.9, spans)
        tree = cKDTree(np.stack(mine, axis=1) / spans)
        distance, _ = tree.query(
            np.stack(places, axis=1) / spans, k=min(FEWEST, self.speed.size), p=np.inf
        )
        return np.asarray(np.reshape(distance, (speed.size, -1))[:, -1] <= NEAR)


def covered(fit: Fit, median: Array, *, open_scale: bool) -> Covered:
    """Collect speeds of all outputs, and their loads at the chain parameters ``median``."""
    reach = float(load_reach(fit.chain, median[None], open_scale=open_scale)[0])
    speeds, loads = [], []
    for o in fit.observations:
        gamma = load_at_outputs(fit.chain, o, median)
        speeds.append(fit.chain.ratio * o.speed)
        loads.append(reach * gamma * np.sign(o.speed))
    return Covered(np.concatenate(speeds), np.concatenate(loads))
