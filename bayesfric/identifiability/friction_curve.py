"""What recordings cover; and friction over speed: median, 90 % band, where it is determined.

The joint runs at constant speed against a constant load. With ``T`` the true motor
torque (without its constant offset) and ``L`` the loss-free torque of the load, both at the
motor, friction is ``F = T - L``. What is recorded is ``T`` over ``drive.gain``, where that is one.

A recording determines ``Gamma/N``, the torque of the leg over the ratio, only up to the scaling of
leg parameters and ``alpha_1, alpha_2`` that changes no torque. ``(1 + mu_1) Gamma/N`` and ``(1 -
mu_2) Gamma/N``, the load at the motor while it drives and is driven, are determined, and so is
their mean, ``lambda_1 Gamma/N`` of eq. (13). Where the scale is open, ``L`` is this mean, so that
``F(speed, L)`` is the same along the ridge: an experiment that lifts and lowers the load at one
speed takes half the sum of the torques for load and half their difference for friction. Where
something fixes the scale (a known mass, a known leg parameter, ``mu_1 = mu_2``), ``L`` is
``Gamma/N``.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.torque import filtered_torque, load_at_outputs
from bayesfric.identifiability.local import WIDE, local_information
from bayesfric.inference.fitting import Fit
from bayesfric.mechanism import kernels
from bayesfric.mechanism.inverse import inverse_torque, load_reach, load_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import State
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.recordings.measurement import AT_ROOM
from bayesfric.recordings.signals import Signals
from bayesfric.results.reported import LEVEL

# Distance from outputs, over the recorded range of speed and load, that is covered.
NEAR = 0.08
# Outputs that must be near a place to cover it.
FEWEST = 3


@dataclass(frozen=True, eq=False)
class Curve:
    """Friction at ``N`` places, ``(N,)`` each."""

    speed: Array  # the motor's
    load: Array  # loss-free, see the module
    # `(3, N)`: low end of the central 90 % interval, median and high end, over the draws that have
    # a value; `nan` where fewer than half of them do
    ends: Array
    determined: Flags  # whether the data narrow what the prior has
    covered: Flags  # whether `FEWEST` outputs were near

    @property
    def median(self) -> Array:
        """The posterior's."""
        return np.asarray(self.ends[1])

    @property
    def shown(self) -> Flags:
        """Where there is a band to see."""
        return np.asarray(self.covered & np.isfinite(self.median))


def friction_curves(fit: Fit, levels: Sequence[float] = ()) -> list[Curve]:
    """Evaluate friction over speed, where recordings ran: without load, driven, and driving."""
    open_scale = has_open_scale(fit)
    median = fit.target.chain_values(fit.posterior.median[None])
    place = covered(fit.chain, fit.observations, median[0], open_scale)
    lossy = any(element.load_loss != "none" for element in fit.chain.elements)
    ways = [place[1][place[1] > 0.0], place[1][place[1] < 0.0]] if lossy else []
    loads = [float(np.quantile(np.abs(x), 0.9) * np.sign(x[0])) for x in ways if x.size]
    loads = [float(f"{x:.1g}") for x in loads]
    ends = np.abs(place[0]).max() * np.array([1.0, -1.0])
    forth, back = friction_torque(fit.chain, median, ends, 0.0 * ends, open_scale)[0]
    symmetric = math.isclose(forth, back, rel_tol=1e-9)
    curves, k = [], 2 if loads else 1
    for x in (0.0, *loads):
        at_load = np.abs(place[1] - x) <= _reach(place)[1] if loads else place[0] != 0.0
        if levels and not at_load.any():
            continue
        speed = _quantiles(place[0, at_load], levels, symmetric) if levels else _grid(place[0])
        load = np.full(speed.size, x)
        torque = partial(friction_torque, fit.chain, speed=speed, load=load, open_scale=open_scale)
        near_outputs = near(np.stack([speed, load])[:k], place[:k])
        curves.append(Curve(speed, load, *band(fit, torque), near_outputs))
    return curves


def _grid(recorded: Array, points: int = 121) -> Array:
    """Lay speeds over the recorded range, both ways if it has both."""
    low, high = float(recorded.min()), float(recorded.max())
    least = 1e-3 * max(-low, high)
    sides = [(low, -least)] if low < -least else []
    sides += [(least, high)] if high > least else []
    speed = np.concatenate([np.linspace(*ends, points // len(sides)) for ends in sides])
    # friction jumps at standstill, where it is not defined
    return np.insert(speed, points // 2, 0.0) if len(sides) > 1 else speed


def _quantiles(speed: Array, levels: Sequence[float], symmetric: bool) -> Array:
    """Take quantiles of how fast the motor ran, one way and then the other; nan where it did not.

    They are the same both ways where friction is.
    """
    ways = []
    for sign in (1.0, -1.0):
        speeds = sign * speed[sign * speed > 0.0]
        size = np.quantile(speeds if speeds.size and not symmetric else np.abs(speed), levels)
        ways.append(sign * np.where(size <= speeds.max(initial=0.0), size, np.nan))
    return np.concatenate(ways)


def has_open_scale(fit: Fit) -> bool:
    """Whether theory leaves a scale between leg and alpha open."""
    return local_information(fit.target, fit.posterior.median).from_theory > 0


def band(
    fit: Fit, curve: Callable[[Array], Array], draws: int = 1000, prior_draws: int = 500
) -> tuple[Array, Flags]:
    """Give ends and median ``(3, N)`` of a curve over draws, and where the data determine it.

    ``curve`` brings parameters ``(n, n_parameters)`` to the curve's points ``(n, N)``, ``nan``
    where a draw has no value. The data determine it where they narrow what the prior has. A
    quantile of so many draws has an error of a fortieth of the band's width.
    """
    with np.errstate(all="ignore"), warnings.catch_warnings():
        # points without a draw are nan
        warnings.simplefilter("ignore", RuntimeWarning)
        before = fit.posterior.prior_draws(prior_draws, 4)
        every = [curve(fit.chain_draws(draws)), curve(fit.target.chain_values(before))]
        drawn, before = (np.where(np.isfinite(x), x, np.nan) for x in every)
        ends = np.nanquantile(drawn, [0.5 - LEVEL / 2, 0.5, 0.5 + LEVEL / 2], axis=0)
        # between quartiles: what divides by 1 - mu_2 has no finite sd under many priors
        width, wide = (
            np.subtract(*np.nanquantile(x, [0.75, 0.25], axis=0)) for x in (drawn, before)
        )
    ends[:, np.isnan(drawn).mean(axis=0) > 0.5] = np.nan
    return ends, np.asarray(np.isfinite(ends[1]) & (width < WIDE * wide))


def friction_torque(
    chain: Joint, values: Array, speed: Array, load: Array, open_scale: bool
) -> Array:
    """Friction ``(n, N)`` of the whole joint at constant speed, at the motor, against the motion.

    ``speed`` ``(N,)`` is the motor's, without a value at zero; ``load`` ``(N,)`` is its loss-free
    torque of the load (``open_scale`` says which, see the module), positive where it resists the
    motion. At 20 degC, as a recording begins; at no load it is what the constant, viscous and
    quadratic ``total_drive.*`` of :func:`bayesfric.mechanism.derived.derive` sum up, times gain.
    """
    sign = np.sign(speed)
    elements, table, carried = chain.tables(values)
    # a load of the given weight alone, in the same kernel as everywhere
    table[:] = 0.0
    table[:, kernels.GAIN] = 1.0
    table[:, kernels.GRAVITY] = 1.0
    with np.errstate(divide="ignore"):
        table[:, kernels.FIRST_MOMENT] = 1.0 / load_reach(chain, values, open_scale=open_scale)
    # a torque at standstill is not friction
    rest = State(0.0, 0.0, 0.0, 0.0, 0.0)
    for k, term in enumerate(chain.carried):
        if term.row.column is not None and not term.row.shape and term.row.column(rest) != 0.0:
            carried[:, k, 0] = 0.0
    # the sine of the angle carries the load, which belongs to no position
    still = np.zeros_like(load)
    samples = chain.samples(still, speed / chain.ratio, still, AT_ROOM, still)
    samples = samples._replace(sin_q=np.ascontiguousarray(sign * load), cos_q=still)
    torque = kernels.inverse_many(elements, table, carried, samples)
    return np.asarray(np.where(sign == 0.0, np.nan, sign * torque - load))


def near(places: Array, recorded: Array) -> Flags:
    """Whether ``FEWEST`` of the outputs ``(k, M)`` are near each place ``(k, N)``: ``(N,)``."""
    reach = _reach(recorded)[:, None]
    apart = (np.abs(recorded - at[:, None]) <= reach for at in places.T)
    return np.array([np.all(close, axis=0).sum() >= FEWEST for close in apart])


def _reach(recorded: Array) -> Array:
    """Give the distance from outputs ``(k, M)`` that counts as near, ``(k,)``."""
    # nine tenths of the outputs, or one jerk would stretch what counts as near
    inner = np.subtract(*np.quantile(recorded, [0.95, 0.05], axis=1)) / 0.9
    return np.asarray(NEAR * np.where(inner > 0.0, inner, np.ptp(recorded, axis=1)))


def covered(
    chain: Joint, observations: Sequence[Signals], median: Array, open_scale: bool
) -> Array:
    """Give the motor's speed at all outputs and, at the chain parameters ``median``, their loads.

    ``(2, M)``; loads are loss-free, at the motor, and positive where they resist the motion.
    """
    reach = float(load_reach(chain, median[None], open_scale=open_scale)[0])
    speeds, loads = [], []
    for o in observations:
        speeds.append(chain.ratio * o.speed)
        loads.append(reach * load_at_outputs(chain, o, median) * np.sign(o.speed))
    return np.stack([np.concatenate(speeds), np.concatenate(loads)])


# What each recording covers: direction of power, range of position, acceleration


def coverage_of(
    chain: Joint, observations: Sequence[Signals], values: Array
) -> list[dict[str, Any]]:
    """Compute what every recording covers at ``values`` ``(n_parameters,)``."""
    return [
        {
            "name": o.name,
            "outputs": int(o.measured.size),
            # share of outputs in which the joint moves, and of those in which the load drives
            "moving": float(np.mean(o.qd[o.filter.centres] != 0.0)),
            "load_drives": back_driving(chain, [o], values),
            "turn": float(np.ptp(o.q[o.filter.centres])),  # range of the position, rad or m
            "steady": _steady(chain, o, values),
            "added_mass": o.inputs.added_mass,  # known mass on the load, kg
            "radius": o.inputs.radius,  # its distance from the axis, m
        }
        for o in observations
    ]


def back_driving(chain: Joint, observations: Sequence[Signals], values: Array) -> dict[str, float]:
    """Share of moving outputs in which the load drives each lossy element, at one vector."""
    shares = back_driving_shares(chain, observations, values[None])
    return {name: float(share[0]) for name, share in shares.items()}


def back_driving_shares(
    chain: Joint, observations: Sequence[Signals], values: Array
) -> dict[str, Array]:
    """Share of moving outputs in which the load drives each element with load-dependent friction.

    Of vectors ``(n, n_parameters)``: ``(n,)`` each.
    """
    shares = {}
    for i, element in enumerate(chain.elements):
        if element.load_loss == "none":
            continue
        back, moving = np.zeros(values.shape[0]), 0
        for o in observations:
            outputs = np.flatnonzero(o.speed)
            transmitted = _behind(chain, i, o, outputs, values)
            back += np.count_nonzero(transmitted * o.speed[outputs] < 0.0, axis=1)
            moving += outputs.size
        shares[element.name] = back / max(moving, 1)
    return shares


def _behind(chain: Joint, i: int, o: Signals, outputs: NDArray[np.int64], values: Array) -> Array:
    """Torque at the output of element ``i``, ``(n, len(outputs))``."""
    at = o.filter.centres[outputs]
    q, qd, qdd, time = o.q[at], o.qd[at], o.acceleration[outputs], o.stamps[at]
    if i + 1 == len(chain.elements):
        torques = (load_torque(chain, v, q, qdd, inputs=o.inputs, time=time) for v in values)
        return np.stack([*torques])
    rest = Joint(chain.elements[i + 1 :], chain.load)
    columns = [chain.names.index(name) for name in rest.names]
    return inverse_torque(rest, values[:, columns], q, qd, qdd, inputs=o.inputs, time=time)


def _steady(chain: Joint, o: Signals, values: Array) -> float:
    """Share of outputs in which inertia takes less than a twentieth of the torque."""
    steady = replace(o, qdd=np.zeros_like(o.qdd))
    torque = filtered_torque(chain, o, values[None])[0]
    steady_torque = filtered_torque(chain, steady, values[None])[0]
    return float(np.mean(np.abs(torque - steady_torque) < 0.05 * np.abs(torque)))
